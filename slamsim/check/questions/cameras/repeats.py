"""Does a camera repeat images while the robot moves: for a while, or each of them?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.survey import CameraSurvey
from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding, Measurement
from slamsim.check.motion.planar_track import planar_track, track_at
from slamsim.check.question import (
    FaultKind,
    Question,
    QuestionGroup,
    anywhere,
    judge,
    same_subject,
    unanswered,
)
from slamsim.core.components import runs_of
from slamsim.core.types import BoolArray, FloatArray, IntArray
from slamsim.guard.numbers import is_sound
from slamsim.recording import Recording
from slamsim.recording.repairs.base import Repair

MAX_FROZEN_S = 0.5
MAX_REPEATED = 0.05
"""Share of images that are bytes for bytes the one before while the robot moves."""
_MOVED = 2e-3
"""Metres, and radians: what stands a few metres away moves by a pixel of a common camera."""
_FEWEST_MOVING = 20
_DARK = 4.0
"""Of 255: a covered lens."""

_BY_MOTION = (
    *("camera_time_offset", "camera_mount", "camera_depth_scale", "camera_intrinsics"),
    "camera_rolling_shutter",
)
"""Told from images that are believed to be of their instants."""
CAMERA_FROZEN = FaultKind(
    "camera_frozen",
    "a camera repeats an image for a while",
    (same_subject("camera_duplicated"), anywhere(*_BY_MOTION)),
)
FROZEN = Question(
    "camera.frozen",
    "images do not stand still while the robot moves",
    (CAMERA_FROZEN,),
    limit=MAX_FROZEN_S,
    unit="s",
    consequence="visual odometry stops, and obstacles appear where none are any more",
    excitation_wanted="an odometry, and motion",
    limit_of_ok=False,
    repairs=("drop_repeated_images",),
)
DUPLICATED = Question(
    "camera.duplicates",
    "each image is a new one while the robot moves",
    (FaultKind("camera_duplicated", "a camera publishes images twice", (anywhere(*_BY_MOTION),)),),
    limit=MAX_REPEATED,
    consequence="motion between images seems to stop and to double, and rates are half of the told",
    excitation_wanted="an odometry, and motion for some twenty images",
    limit_of_ok=False,
    repairs=("drop_repeated_images",),
)


def check_repeats(evidence: RecordingEvidence) -> Iterator[Finding]:
    """Equal bytes of successive images, where an odometry says that the robot moved between."""
    for camera in evidence.recording.cameras:
        moved = moved_between(evidence.recording, camera.stamps_ns)
        if moved is None or moved.sum() < _FEWEST_MOVING:
            words = f"an odometry shows motion between fewer than {_FEWEST_MOVING} images of it"
            yield unanswered(FROZEN, camera.topic, words)
            yield unanswered(DUPLICATED, camera.topic, words)
        else:
            yield from _judged(camera, moved)


GROUP = QuestionGroup("camera images", 60, (FROZEN, DUPLICATED), check_repeats)


def moved_between(recording: Recording, stamps_ns: IntArray) -> BoolArray | None:
    """(n - 1,) whether any odometry moves between two stamps; None without odometry."""
    found: BoolArray | None = None
    for odometry in recording.odometries:
        known_ns, track = planar_track(
            odometry.stamps_ns, odometry.positions_m, odometry.quats_xyzw
        )
        if known_ns.size < 2 or not is_sound(track).all() or stamps_ns.size < 2:
            continue
        steps: FloatArray = np.diff(track_at(known_ns, track, stamps_ns), axis=0)
        moves = np.hypot(steps[:, 0], steps[:, 1]) + np.abs(steps[:, 2]) > _MOVED
        found = moves if found is None else found | moves
    return found


def _of_nothing(camera: CameraSurvey) -> NDArray[np.uint32]:
    """Digests of images that show nothing, which may be alike for long: without depth, or black."""
    without = np.isnan(camera.depths_m).any(axis=1)
    black = without if camera.kind == "depth" else camera.brightness < _DARK
    return np.unique(camera.digests[camera.sampled[black]])


def _judged(camera: CameraSurvey, moved: BoolArray) -> Iterator[Finding]:
    is_same = np.diff(camera.digests.astype(np.int64)) == 0
    same = np.asarray(is_same & moved & ~np.isin(camera.digests[1:], _of_nothing(camera)))
    times_s = (camera.stamps_ns - camera.stamps_ns[0]) * 1e-9
    spells = [(first, last + 1) for first, last in runs_of(same)]
    lasting = [(a, b) for a, b in spells if times_s[b] - times_s[a] > MAX_FROZEN_S]
    longest_s = max((float(times_s[b] - times_s[a]) for a, b in spells), default=0.0)
    begins = ", ".join(f"{times_s[a]:.1f}" for a, _ in lasting[:5])
    yield judge(
        FROZEN,
        camera.topic,
        {
            "ok": "images do not stand still while the robot moves",
            "fault": f"one image is repeated for up to {longest_s:.2f} s while the robot moves, "
            f"{len(lasting)} times in all, from {begins} s after the first image on",
        },
        Measurement(longest_s if lasting else 0.0, 0.0, "s"),
        repairs=[Repair("drop_repeated_images", camera.topic)],
        advice="Look for a driver or a bus that hangs and a node that publishes its last image.",
    )
    alone = same.copy()
    for a, b in lasting:
        alone[a:b] = False
    count = int(moved.sum())
    share = float(alone.sum()) / count
    sigma = float(np.sqrt(max(share * (1.0 - share), 1.0 / count) / count))
    yield judge(
        DUPLICATED,
        camera.topic,
        f"{share:.1%} of {count:,} images are the one before again while the robot moves",
        Measurement(share, sigma, ""),
        repairs=[Repair("drop_repeated_images", camera.topic)],
        advice="Look for two publishers on the topic, and for a node that fills a higher rate up.",
    )
