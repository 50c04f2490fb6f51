"""From a recording as written to a ``Log`` for SLAM: sorted, converted, with warnings."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

import numpy as np

from slamsim.core.types import (
    BoolArray,
    EncoderStream,
    FloatArray,
    ImuStream,
    IntArray,
    Log,
    PlanarTrajectory,
    ScanSource,
)
from slamsim.guard.errors import InputRefused, OverrideRefused
from slamsim.recording import (
    RawImu,
    RawOdometry,
    RawScans,
    RawStream,
    RawTicks,
    RecordedTopic,
    Recording,
    TransformEdge,
)
from slamsim.recording.choice import (
    choices,
    in_words,
    lidars_beside,
    ranked,
    topics_of,
    without_scans,
)
from slamsim.recording.cleaning.lidars import OtherLidars, scan_times
from slamsim.recording.cleaning.rising_stamps import Times, epoch_of
from slamsim.recording.cleaning.scans import RecordedScans, ScanSurvey
from slamsim.recording.cleaning.streams import (
    chain_of,
    encoders_of,
    imu_of,
    in_base,
    odometry_of,
    planar_poses,
)
from slamsim.recording.frames import (
    ODOM_FRAME,
    FrameTree,
    base_frame_of,
    imu_mounting_of,
    laser_mounting_of,
    likely_base,
    odometry_chain,
)

_LEAST_OFFSET_M = 1e-3
"""Below, the axle of the wheels is at the base for any odometry."""

_Raw = TypeVar("_Raw", bound=RawStream)


def clean(recording: Recording, source: Path) -> Log:
    """The log in a recording. source: named in errors.

    Raises InputRefused without usable scans, for a damaged message on a topic that is needed, and
    for scans and odometry without a common time.
    """
    return _Cleaning(recording, source).log()


class WithoutScans(InputRefused):
    """A recording in which no lidar was recorded."""


def clean_motion(recording: Recording, source: Path) -> Log:
    """The same without scans: what a recording says of wheels and gyroscope, and nothing else.

    Raises InputRefused for a damaged message on a topic that is needed.
    """
    return _Cleaning(recording, source).motion()


class _Cleaning:
    """A recording being cleaned. warnings: what was odd so far, and what was done about it."""

    def __init__(self, recording: Recording, source: Path) -> None:
        self._recording, self._source = recording, source
        self._topics = topics_of(recording)
        self._wheels_elsewhere = False
        self.warnings: list[str] = []

    def log(self) -> Log:
        recording = self._recording
        raw, carried = self._scans()
        self.warnings += recording.anomalies
        survey = ScanSurvey(raw)
        times = scan_times(raw, survey, self._source, carried)
        rows, first_ns = survey.rows[times.order], int(times.stamps_ns[0])
        tree = FrameTree()
        tree.add(self._transforms(is_static=True))
        moved, self.warnings = self.warnings, []
        odometry, base_frame = self._odometry(tree, raw.frame_ids[0], carried, rows, times)
        if odometry is not None and recording.base_frame not in ("", base_frame):
            odometry = in_base(odometry, self._offset(tree, base_frame))
        base_frame = recording.base_frame or base_frame
        moved, self.warnings = self.warnings, moved
        limit, told = survey.limit(times, odometry)
        odd = survey.warnings(times, has_beam_times=raw.in_order and recording.format != "carmen")
        kept, stuck = survey.moving_on(times, odometry)
        self.warnings += [f"{raw.topic}: {words}" for words in (*odd, *stuck)] + moved
        taken_for = [f"{raw.topic}: {words}" for words in told]
        encoders, imu = self._encoders(), self._imu()
        if odometry is not None:
            self._require_overlap(odometry, times.stamps_ns, encoders is not None)
        laser_frame, warnings = raw.frame_ids[0], self.warnings
        T_base_laser = laser_mounting_of(tree, base_frame, laser_frame, warnings)
        scans = RecordedScans(raw, rows[kept], times.stamps_ns[kept], limit)
        return Log(
            name=recording.name,
            epoch="simulation" if recording.epoch == "simulation" else epoch_of(first_ns),
            scans=self._with_others(scans, raw, tree, base_frame, odometry),
            odometry=odometry,
            imu=imu,
            encoders=encoders,
            T_base_laser=T_base_laser,
            T_base_imu=None if imu is None else imu_mounting_of(tree, base_frame, imu, warnings),
            sources=in_words(choices(recording)),
            warnings=(*warnings, *taken_for),
            recorded_scans=len(raw),
        )

    def motion(self) -> Log:
        """Of wheels and gyroscope alone."""
        recording, raw = self._recording, self._first(RawOdometry)
        tree = FrameTree()
        tree.add(self._transforms(is_static=True))
        odometry, odd = (None, []) if raw is None else odometry_of(raw)
        base_frame = base_frame_of(recording)
        moved = "" if raw is None else raw.child_frame_ids[0]
        if odometry is not None and moved and recording.base_frame not in ("", moved):
            odometry = in_base(odometry, self._offset(tree, moved))
        encoders, imu, warnings = self._encoders(), self._imu(), [*odd, *self.warnings]
        return Log(
            name=recording.name,
            epoch="simulation" if recording.epoch == "simulation" else "unix",
            scans=(),
            odometry=odometry,
            imu=imu,
            encoders=encoders,
            T_base_laser=np.eye(4),
            T_base_imu=None if imu is None else imu_mounting_of(tree, base_frame, imu, warnings),
            sources=in_words(choices(recording)),
            warnings=(*recording.anomalies, *warnings),
        )

    def _stream(self, kind: type[_Raw], topic: RecordedTopic) -> _Raw:
        """Raises InputRefused if any of its messages cannot be decoded."""
        if topic.damage:
            raise InputRefused(self._source, topic.damage, f"topic {topic.topic}")
        return next(each for each in self._recording.of(kind) if each.topic == topic.topic)

    def _first(self, kind: type[_Raw]) -> _Raw | None:
        """The stream of a kind that is read."""
        topics = ranked(self._recording, kind)
        return self._stream(kind, topics[0]) if topics else None

    def _scans(self) -> tuple[RawScans, RawOdometry | None]:
        """(the scans that are read, the odometry in the same messages)."""
        topics = ranked(self._recording, RawScans)
        if not topics:
            is_carmen = self._recording.format == "carmen"
            kinds = {t.topic if is_carmen else t.type_name for t in self._topics if t.messages}
            there = ", ".join(kind[:60] for kind in sorted(kinds)[:9]) or "no message at all"
            needed = "a FLASER or ROBOTLASER1 line" if is_carmen else RawScans.schema.type_name
            reason = f"a log without scans: {needed} is needed, there is {there}"
            shown = "; `slamsim info` shows what it holds"
            raise WithoutScans(self._source, reason + without_scans(self._topics) + shown)
        carried = {each.topic: each for each in self._recording.odometries}
        raw = self._stream(RawScans, topics[0])
        return raw, carried.get(raw.topic)

    def _with_others(
        self,
        scans: RecordedScans,
        first: RawScans,
        tree: FrameTree,
        base_frame: str,
        odometry: PlanarTrajectory | None,
    ) -> ScanSource:
        """The scans, each with those of all other lidars whose place on the robot is known."""
        topics = lidars_beside(self._recording)
        if not topics:
            return scans
        others = OtherLidars(first, scans, tree, base_frame, odometry)
        for topic in topics:
            if topic.damage:
                others.told.append(f"the scans of {topic.topic} are not used: {topic.damage}")
            else:
                others.add(self._stream(RawScans, topic), self._source)
        self.warnings += others.told
        return others.together()

    def _transforms(self, *, is_static: bool) -> list[TransformEdge]:
        edges = [e for e in self._recording.transforms if e.is_static == is_static]
        for topic in self._topics:
            static_topic = topic.topic.endswith("tf_static")
            if topic.damage and "TFMessage" in topic.type_name and static_topic == is_static:
                raise InputRefused(self._source, topic.damage, f"topic {topic.topic}")
        return edges

    def _odometry(
        self,
        tree: FrameTree,
        laser_frame: str,
        carried: RawOdometry | None,
        rows: IntArray,
        times: Times,
    ) -> tuple[PlanarTrajectory | None, str]:
        """(T_odom_base, the frame it moves); /tf completes the tree where that is needed."""
        raw = self._first(RawOdometry) if carried is None else carried
        path: PlanarTrajectory | None = None
        base_frame = ""
        if raw is not None:
            if carried is None:
                path, odd = odometry_of(raw)
                self.warnings += odd
            else:
                path = _carried_path(carried, rows, times, self._others())
            base_frame = raw.child_frame_ids[0] or self._recording.base_frame or likely_base(tree)
            if tree.between(base_frame, laser_frame) is None:
                tree.add(self._transforms(is_static=False))
        if path is None or len(path) == 0:
            tree.add(self._transforms(is_static=False))
            edges = odometry_chain(tree, laser_frame)
            base_frame = edges[-1][1] if edges else base_frame or likely_base(tree)
            found = chain_of(self._recording.transforms, edges)
            path = None if found is None else found.planar()
            if raw is not None and path is not None:
                self.warnings.append(f"{raw.topic}: no usable pose; the transforms give odometry")
        if path is None or len(path) == 0:
            self.warnings.append(
                f"a log without odometry: neither {RawOdometry.schema.type_name} nor transforms "
                f"from {ODOM_FRAME!r} to the robot"
            )
            return None, base_frame
        return path, base_frame

    def _offset(self, tree: FrameTree, moved: str) -> FloatArray:
        """4 x 4, from the frame that odometry moves to the base that the user names."""
        base = self._recording.base_frame
        if tree.between(moved, base) is None:
            tree.add(self._transforms(is_static=False))
        T_moved_base = tree.between(moved, base)
        if T_moved_base is None:
            reason = (
                f"no fixed transforms of {self._source} join it to {moved}, the odometry's frame"
            )
            raise OverrideRefused(f"--base-frame {base}", reason)
        self._wheels_elsewhere = bool(np.hypot(*T_moved_base[:2, 3]) > _LEAST_OFFSET_M)
        return T_moved_base

    def _others(self) -> RawOdometry | None:
        """Odometry beside that of the scans, which no check looks at."""
        streams = (each.stream for each in self._recording.unread)
        return next((each for each in streams if isinstance(each, RawOdometry)), None)

    def _encoders(self) -> EncoderStream | None:
        raw = self._first(RawTicks)
        if raw is not None and self._wheels_elsewhere:
            self.warnings.append(f"{raw.topic}: the wheels are not at the base frame: left out")
            raw = None
        encoders, odd = (None, []) if raw is None else encoders_of(raw)
        self.warnings += odd
        return encoders

    def _imu(self) -> ImuStream | None:
        raw = self._first(RawImu)
        imu, odd = (None, []) if raw is None else imu_of(raw)
        self.warnings += odd
        if raw is not None and imu is not None and not imu.angular_velocity_rad_s.any():
            # No gyroscope reads that; accelerometers alone are published with it.
            self.warnings.append(f"{raw.topic}: all its turn rates are exactly 0: left out")
            imu = None
        return imu

    def _require_overlap(
        self, odometry: PlanarTrajectory, scan_stamps_ns: IntArray, has_encoders: bool
    ) -> None:
        """Recorders begin and end within a scan: one at each end without odometry is usual."""
        first_ns, last_ns = int(scan_stamps_ns[0]), int(scan_stamps_ns[-1])
        start_ns, end_ns = int(odometry.stamps_ns[0]), int(odometry.stamps_ns[-1])
        spans = f"scans {first_ns}..{last_ns} ns, odometry {start_ns}..{end_ns} ns"
        if last_ns < start_ns or first_ns > end_ns:
            if not has_encoders:
                raise InputRefused(
                    self._source,
                    f"no common time: {spans}; a clock is off, which `slamsim fix` may put right",
                )
            self.warnings.append(f"scans and odometry have no common time: {spans}")
            return
        before, after = (scan_stamps_ns < start_ns).sum(), (scan_stamps_ns > end_ns).sum()
        if max(before, after) > 1:
            self.warnings.append(
                f"odometry does not cover all scans: {before} of {len(scan_stamps_ns)} are before"
                f" its beginning, {after} after its end"
            )


def _carried_path(
    carried: RawOdometry, rows: IntArray, times: Times, others: RawOdometry | None
) -> PlanarTrajectory:
    """Each scan's own pose, and those of another odometry before the first and after the last.

    Between the scans these are left out: CARMEN's are stamped by another process, up to a tenth
    of a second off against the pose of the laser line (aces), so merging both makes the path jump
    to and fro.
    """
    stamps_ns, poses = times.stamps_ns, planar_poses(carried, rows)
    if others is not None and not times.made_anew:
        outside: BoolArray = (others.stamps_ns < stamps_ns[0]) | (others.stamps_ns > stamps_ns[-1])
        stamps_ns = np.concatenate([stamps_ns, others.stamps_ns[outside]])
        poses = np.concatenate([poses, planar_poses(others, np.flatnonzero(outside))])
    stamps_ns, first = np.unique(stamps_ns, return_index=True)
    return PlanarTrajectory(stamps_ns, poses[first])
