"""Detects several publishers on one topic or frame, which corrupts the data of both."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

import numpy as np

from slamsim.check.evidence import RecordingEvidence
from slamsim.check.fault_groups import BY_SCANS, MOUNTING, SIZES, STAMPS
from slamsim.check.findings import Finding, Measurement
from slamsim.check.question import (
    FaultKind,
    Question,
    QuestionGroup,
    anywhere,
    judge,
    lidar_stamps,
    same_subject,
)
from slamsim.core.geometry import between, yaw_from_xyzw
from slamsim.core.types import BoolArray, Float32Array, FloatArray
from slamsim.recording import RawImu, RawOdometry, RawScans, RawStream, TransformEdge

TRIPLES = 200
"""So many scans are compared with their two neighbours."""
MIN_TRIPLES, MIN_BEAMS = 20, 20
ODD_TIMES = 3.0
ODD_M, ODD_POSE_M = 0.05, 0.02
"""A message is the odd one out if it is off both neighbours by this and by so many times what they
are off each other: whatever moves is nearer to the last message than to the one before."""
MAX_ODD_SHARE = 0.1
COPY_SHARE = 0.5
"""Two topics that agree in more of their readings are one sensor, raw and filtered."""
_AGREE_M, _AGREE_RAD_S, _AGREE_SHARE = 0.1, 0.1, 0.05
"""Readings of one sensor, raw and filtered, differ by less: 10 cm and 5 % of a range, 0.1 rad/s."""
_COMPARED = 50
_LEVER_M = 0.2
"""What a turn counts as path: that of a wheel about the middle of a small robot."""
_OTHER_COUNT = 0.1
"""Share by which numbers of beams of two lidars differ at least."""

Stream = TypeVar("Stream", bound=RawStream)


PUBLISHERS = Question(
    "topic.publishers",
    "each topic, and each transform of the base, has one publisher",
    (
        FaultKind(
            "topic_shared",
            "two publishers share a topic",
            (
                same_subject(
                    *(*STAMPS, "scans_overlap", "scan_time"),
                    *("odometry_jump", "odometry_contradicts_wheels", "odometry_frozen"),
                ),
                anywhere("tf_contradicts_odometry", "odometries_contradict", *SIZES),
                lidar_stamps(*BY_SCANS, "time_offset_imu", "time_offset_wheels"),
            ),
        ),
    ),
    limit=100.0 * MAX_ODD_SHARE,
    unit="%",
    consequence="a SLAM takes two sensors for one that jumps to and fro",
)
FRAMES = Question(
    "topic.frames",
    "each sensor has a frame of its own",
    (FaultKind("frame_on_two_topics", "two sensors name one frame", (anywhere(*MOUNTING),)),),
    consequence="one of the two sensors is placed where the other one sits",
)


def check_publishers(evidence: RecordingEvidence) -> list[Finding]:
    """Each topic and each transform above the base with one publisher, each sensor's frame on one
    topic."""
    recording = evidence.recording
    streams: list[RawStream] = [*recording.scans, *recording.imus, *recording.odometries]
    return [
        *map(_topic, streams),
        *map(_transform, evidence.frames.moving_above([evidence.base])),
        *_frames(recording.scans, _same_scans),
        *_frames(recording.imus, _same_turns),
    ]


GROUP = QuestionGroup("publishers", 30, (PUBLISHERS, FRAMES), check_publishers)


def _topic(stream: RawStream) -> Finding:
    """One frame, and messages that follow from each other."""
    names = max(stream.frame_ids, getattr(stream, "child_frame_ids", ()), key=len)
    odd = np.zeros(0, dtype=np.bool_)
    if isinstance(stream, RawScans):
        odd = _odd_scans(stream)
    elif isinstance(stream, RawOdometry):
        odd = _odd_poses(stream)
    if len(names) <= 1:
        return _following(stream.topic, odd)
    words = f"its messages name {len(names)} frames in turn: {', '.join(names[:5])}"
    return _judged(stream.topic, 1.0, words)


def _transform(edge: TransformEdge) -> Finding:
    """Of a driver and a filter that both say where the base is one is odd."""
    return _following(f"{edge.topic} {edge.name}", _odd_poses(edge))


def _following(subject: str, odd: BoolArray) -> Finding:
    share = float(odd.mean()) if odd.size >= MIN_TRIPLES else 0.0
    words = f"{100.0 * share:.0f} % of its messages are unlike the ones before and after, which are"
    return _judged(subject, share, f"{words} alike")


def _judged(subject: str, share: float, fault: str) -> Finding:
    return judge(
        PUBLISHERS,
        subject,
        {"ok": "its messages name one frame and follow from each other", "fault": fault},
        Measurement(100.0 * share, 0.0, "%"),
        advice="Give each publisher a topic of its own: remap one of them, or end the node that "
        "was started twice.",
    )


def _odd_scans(scans: RawScans) -> BoolArray:
    """(k,) whether the middle one of three scans is unlike the others, where they can be told."""
    places = (
        np.unique(np.linspace(0, len(scans) - 3, TRIPLES).astype(int)) if len(scans) > 2 else ()
    )
    found = (
        _odd_one_out([np.asarray(scans.ranges_m[int(i) + k]) for k in range(3)]) for i in places
    )
    return np.array([odd for odd in found if odd is not None], dtype=np.bool_)


def _odd_one_out(rows: list[Float32Array]) -> bool | None:
    first, middle, last = (np.asarray(row, dtype=np.float64) for row in rows)
    if abs(first.size - last.size) < _OTHER_COUNT * first.size < abs(first.size - middle.size):
        return True
    if not first.size == middle.size == last.size:
        return None
    seen = np.isfinite(first) & np.isfinite(middle) & np.isfinite(last)
    if int(seen.sum()) < MIN_BEAMS:
        return None
    first, middle, last = first[seen], middle[seen], last[seen]
    pairs = ((first, middle), (middle, last), (first, last))
    off = [float(np.median(np.abs(one - other))) for one, other in pairs]
    return min(off[0], off[1]) > ODD_TIMES * off[2] + ODD_M


def _odd_poses(stream: RawOdometry | TransformEdge) -> BoolArray:
    """(n - 2,) of the poses that are finite."""
    poses = np.column_stack([stream.positions_m[:, :2], yaw_from_xyzw(stream.quats_xyzw)])
    poses = poses[np.isfinite(poses).all(axis=1)]
    near, far = _lengths(poses[:-1], poses[1:]), _lengths(poses[:-2], poses[2:])
    return np.asarray(np.minimum(near[:-1], near[1:]) > ODD_TIMES * far + ODD_POSE_M)


def _lengths(first: FloatArray, second: FloatArray) -> FloatArray:
    moved = between(first, second)
    return np.asarray(np.hypot(np.hypot(moved[:, 0], moved[:, 1]), _LEVER_M * moved[:, 2]))


def _frames(streams: Sequence[Stream], same: Callable[[Stream, Stream], bool]) -> Iterator[Finding]:
    """Each sensor of a kind beside the first that names its frame: a copy, or one is wrong."""
    first: dict[str, Stream] = {}
    for other in streams:
        named = [frame for frame in other.frame_ids if frame]
        one = next((first[frame] for frame in named if frame in first), None)
        first = {**dict.fromkeys(named, other), **first}
        if one is None:
            continue
        subject = f"{one.topic} and {other.topic}"
        words = f"both name {', '.join(sorted(set(one.frame_ids) & set(named)))}"
        copied = same(one, other)
        yield judge(
            FRAMES,
            subject,
            f"{words} and measure the same: one sensor, published twice"
            if copied
            else f"{words} and measure different things",
            verdict="ok" if copied else "fault",
            advice="Give every sensor a frame of its own, with a transform that says where it "
            "sits.",
        )


def _same_scans(one: RawScans, other: RawScans) -> bool:
    """Whether most beams of one direction and nearly one instant agree."""
    if not len(one) or not len(other):
        return True
    shares = []
    for i in np.unique(np.linspace(0, len(one) - 1, _COMPARED).astype(int)).tolist():
        j = int(np.argmin(np.abs(other.stamps_ns - one.stamps_ns[i])))
        shares.append(_agreeing(_polar(one, i), _polar(other, j)))
    known = [share for share in shares if np.isfinite(share)]
    return not known or float(np.median(known)) > COPY_SHARE


def _polar(scans: RawScans, scan: int) -> tuple[FloatArray, FloatArray]:
    """Directions, ascending, and ranges of a scan."""
    layout = scans.layout(scan)
    ranges = np.asarray(scans.ranges_m[scan]).astype(np.float64)
    angles = layout.angle_min_rad + layout.angle_step_rad * np.arange(ranges.size)
    order = np.argsort(angles)
    return np.asarray(angles[order]), np.asarray(ranges[order])


def _agreeing(one: tuple[FloatArray, FloatArray], other: tuple[FloatArray, FloatArray]) -> float:
    """Share of the beams with a return that the nearest beam of the other scan confirms; nan
    without any."""
    (angles, ranges), (others, theirs) = one, other
    if not angles.size or not others.size:
        return float("nan")
    place = np.clip(np.searchsorted(others, angles), 0, others.size - 1)
    step = abs(float(np.median(np.diff(others)))) if others.size > 1 else np.inf
    seen = np.isfinite(ranges) & np.isfinite(theirs[place])
    seen &= np.abs(others[place] - angles) <= step
    if int(seen.sum()) < MIN_BEAMS:
        return float("nan")
    off = np.abs(ranges[seen] - theirs[place][seen])
    return float(np.mean(off < _AGREE_M + _AGREE_SHARE * ranges[seen]))


def _same_turns(one: RawImu, other: RawImu) -> bool:
    """Whether two gyroscopes turn alike, as raw and filtered readings of one do."""
    start, end = (f(one.stamps_ns[at], other.stamps_ns[at]) for f, at in ((max, 0), (min, -1)))
    at_ns = one.stamps_ns[(one.stamps_ns >= start) & (one.stamps_ns <= end)]
    if at_ns.size < MIN_TRIPLES:
        return True
    rates = [np.column_stack([np.interp(at_ns, imu.stamps_ns, rate)
             for rate in imu.angular_velocity_rad_s.T]) for imu in (one, other)]  # fmt: skip
    off = float(np.nanmedian(np.abs(rates[0] - rates[1]).max(axis=1)))
    return off < _AGREE_RAD_S
