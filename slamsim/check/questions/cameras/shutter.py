"""Is the shutter of a camera the one that the recording says, a global one where it says none?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.cameras.survey import CameraSurvey
from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding, Measurement
from slamsim.check.motion.integrated import IntegratedMotion, integrated_gyro
from slamsim.check.question import FaultKind, Question, judge, unanswered
from slamsim.check.questions.cameras.place import (
    USUAL_DISTANCE_M,
    before_the_axle_m,
    turn_fit,
)
from slamsim.check.wording import signed_words
from slamsim.core.types import FloatArray
from slamsim.recording.repairs.base import Repair

MAX_READOUT_OFF_MS = 8.0
"""At 1 rad/s the last row is then half a degree beside where it is taken to be: 4 pixels of an
image of 640 that sees 69 degrees."""
_FLOOR_MS = 1.5
"""What the fit does not know of. Global shutters of simulated robots measured as 1 to 2 ms."""
_LEAST_SEEN = 0.5
"""Of a turn, by a camera behind the axle that looks ahead: of more than half of it nothing can be
told, for how far away things are is not known."""
_SWAY_S, _STEP_S = 2.0, 0.05
"""A tilt is told against what it was before and after: so long a turn lasts, and a gyroscope's bias
adds nothing."""
_FAST = 0.95
"""Share of images in which the robot turns more slowly than as "in its turns" is told."""


def check_shutter(evidence: RecordingEvidence) -> Iterator[Finding]:
    """Each topic of colour or grey images, against the gyroscope, or else the wheels."""
    for camera in evidence.recording.cameras:
        if camera.kind != "depth":
            yield _asked(evidence, camera)


SHUTTER = Question(
    "camera.shutter",
    "rows of images are exposed as long apart as is told, at once where nothing is told",
    (FaultKind("camera_rolling_shutter", "a camera's shutter rolls otherwise than is told"),),
    limit=MAX_READOUT_OFF_MS,
    unit="ms",
    consequence="what is upright leans in turns, and points are put beside their place",
    excitation_wanted="turns one way and the other for some ten seconds, in view of upright edges",
    ask=check_shutter,
    repairs=("set_readout",),
)


def _asked(evidence: RecordingEvidence, camera: CameraSurvey) -> Finding:
    fit, reason = turn_fit(evidence, camera)
    if fit is None or fit.readout_s is None:
        wanted = SHUTTER.excitation_wanted
        few = f"too few images show how upright edges lean; what would tell: {wanted}"
        return unanswered(SHUTTER, camera.topic, reason or few)
    assert camera.claim is not None
    claimed_s = camera.claim.readout_s
    T_base_camera = evidence.frames.between(evidence.base, camera.frame_id)
    by_lever = before_the_axle_m(T_base_camera) / USUAL_DISTANCE_M
    tall_rad = camera.claim.image_size[1] / float(camera.claim.model().focal_px[1])
    by_tilt_s = tall_rad * _tilt_per_turn_s(evidence, camera)
    seen_share = max(1.0 + by_lever, _LEAST_SEEN)
    readout_s = (fit.readout_s[0] - by_tilt_s) / seen_share
    off_s = readout_s - (claimed_s or 0.0)
    by_others_s = 0.5 * by_lever * readout_s / seen_share, 0.5 * by_tilt_s
    unsure_s = fit.readout_s[1], *by_others_s, 1e-3 * _FLOOR_MS
    fast_rad_s = float(np.quantile(np.abs(fit.turns_rad_s), _FAST))
    beside_px = abs(off_s) * fast_rad_s * float(camera.claim.model().focal_px[0])
    told = "nothing is told of its shutter"
    if claimed_s is not None:
        told = f"{1e3 * claimed_s:.1f} ms are told"
    told_by_fix = evidence.recording.format != "rosbag1"  # which has no custom data
    readout = signed_words(1e3 * readout_s, "ms", "from the top down", "from the foot up", 1)
    measured = f"its rows are exposed within {readout}, and {told}"
    return judge(
        SHUTTER,
        camera.topic,
        {
            "ok": measured,
            "inconclusive": measured,
            "fault": f"{measured}: in its turns ({fast_rad_s:.2f} rad/s) the last row lies "
            f"{beside_px:.1f} px beside where the first one has it",
        },
        Measurement(1e3 * off_s, 1e3 * float(np.linalg.norm(unsure_s)), "ms"),
        repairs=[Repair("set_readout", camera.topic, {"readout_s": readout_s})] * told_by_fix,
        advice="Tell programs the readout of the shutter, or use a camera with a global one.",
    )


def _tilt_per_turn_s(evidence: RecordingEvidence, camera: CameraSurvey) -> float:
    """By how much a camera tilts about where it looks, its left side up, per turn rate: as a robot
    on soft wheels or a person who carries it does, and images lean as by a shutter. 0 where no
    gyroscope tells.

    What goes with the heading, not with its rate, is a gyroscope that is mounted at a slant.
    """
    imu = next(iter(evidence.recording.imus), None)
    if imu is None or not imu.frame_ids:
        return 0.0
    T_base_imu = evidence.frames.between(evidence.base, imu.frame_ids[0])
    T_base_camera = evidence.frames.between(evidence.base, camera.frame_id)
    R_base_imu = np.eye(3) if T_base_imu is None else T_base_imu[:3, :3]
    ahead = np.array([1.0, 0.0]) if T_base_camera is None else T_base_camera[:2, 2]
    level = np.append(ahead / max(float(np.hypot(*ahead)), 1e-9), 0.0)
    tilt, turn = (integrated_gyro(imu, axis @ R_base_imu) for axis in (level, np.eye(3)[2]))
    if tilt is None or turn is None or turn.times_s[-1] < 4.0 * _SWAY_S:
        return 0.0
    at_s = np.arange(_SWAY_S, turn.times_s[-1] - _SWAY_S, _STEP_S)

    def beside(motion: IntegratedMotion) -> FloatArray:
        around = motion.at(at_s - _SWAY_S) + motion.at(at_s + _SWAY_S)
        return np.asarray((motion.at(at_s) - 0.5 * around)[:, 0])

    half_s = 0.5 * _STEP_S
    rates_rad_s = (turn.at(at_s + half_s) - turn.at(at_s - half_s))[:, 0] / _STEP_S
    A = np.column_stack([rates_rad_s, beside(turn), np.ones(at_s.size)])
    return float(np.linalg.lstsq(A, beside(tilt), rcond=1e-9)[0][0])
