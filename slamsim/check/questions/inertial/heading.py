"""Does the inertial unit look ahead as declared? Its accelerations against those of the odometry.

A robot that drives a curve feels its speed times its turn rate to the inside, and what it gains in
speed ahead: the two tell how the unit is turned about the vertical, which gravity does not.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Curve, Finding, Measurement, Plot
from slamsim.check.motion.clustered import clustered_fit
from slamsim.check.motion.integrated import IntegratedMotion, integrated_odometry
from slamsim.check.question import Question, QuestionGroup, judge, unanswered
from slamsim.check.questions.inertial.gravity import IMU_AXIS
from slamsim.check.wording import signed_words
from slamsim.core.types import BoolArray, FloatArray, IntArray
from slamsim.guard.numbers import is_sound
from slamsim.recording import RawImu
from slamsim.recording.repairs.base import Repair

MAX_OFF_DEG = 5.0
"""A tenth of each acceleration is felt along the other axis; units sit straight within 2."""
WINDOW_S = 0.4
"""Mean accelerations of so long: readings scatter less than the manoeuvres that are compared."""
LONGEST_S = 3600.0
BLOCK_S = 5.0
"""Ramps and soft tyres disturb neighbouring windows alike."""
MIN_BLOCKS = 6
LEAST_GAIN, MOST_GAIN = 0.7, 1.3
"""Of accelerations felt over those driven: others are in another unit, or of another robot."""
MOST_TILT_COS = float(np.cos(np.radians(20.0)))
"""A unit that is turned further feels gravity where its readings of the motion are looked for."""
CURVES = "curves to the left and right at a walking pace"

HEADING = Question(
    "imu.heading",
    "accelerations are felt along the axes of the base, ahead and to the left",
    (IMU_AXIS,),
    limit=MAX_OFF_DEG,
    unit="deg",
    consequence="a filter takes speeding up for a slide to the side",
    excitation_wanted=CURVES,
    repairs=("turn_imu",),
)


def check_heading(evidence: RecordingEvidence) -> Iterator[Finding]:
    """Each inertial unit against the first odometry with enough poses."""
    odometries = (integrated_odometry(one) for one in evidence.recording.odometries)
    driven = next((one for one in odometries if one is not None), None)
    for imu in evidence.recording.imus:
        frame = imu.frame_ids[0] if imu.frame_ids else ""
        T_base_imu = evidence.frames.between(evidence.base, frame)
        if driven is None or T_base_imu is None:
            words = "no odometry, or no transform of the unit's frame, to compare accelerations"
            yield unanswered(HEADING, imu.topic, words)
            continue
        yield _heading(imu, driven, T_base_imu[:3, :3])


GROUP = QuestionGroup("inertial unit", 52, (HEADING,), check_heading)


def _heading(imu: RawImu, driven: IntegratedMotion, R_base_imu: FloatArray) -> Finding:
    felt = imu.linear_acceleration_m_s2 @ R_base_imu.T
    sound = is_sound(felt)
    up = np.median(felt[sound], axis=0) if sound.any() else np.zeros(3)
    if not up[2] > MOST_TILT_COS * np.linalg.norm(up):
        return unanswered(HEADING, imu.topic, "gravity is not felt upright: that comes first")
    windows = _windows(imu, felt[:, :2], sound, driven)
    if windows is not None and not _turn_alike(imu, driven, R_base_imu):
        words = "gyroscope and odometry do not turn the same way: that comes first"
        return unanswered(HEADING, imu.topic, words)
    if windows is None:
        return unanswered(HEADING, imu.topic, f"too little driving; what would tell: {CURVES}")
    design, seen, block = windows
    found, covariance = clustered_fit(design, seen, block)
    cos, sin = found[:2]
    gain = float(np.hypot(cos, sin))
    slope = np.array([-sin, cos]) / gain**2
    sigma_deg = float(np.degrees(np.sqrt(slope @ covariance[:2, :2] @ slope)))
    if not (LEAST_GAIN < gain < MOST_GAIN and sigma_deg < 10.0 * MAX_OFF_DEG):
        words = f"accelerations do not follow those of the odometry; what would tell: {CURVES}"
        return unanswered(HEADING, imu.topic, words)
    off_deg = float(np.degrees(np.arctan2(sin, cos)))
    turned = signed_words(off_deg, "deg", "further to the right", "further to the left")
    ahead, aside = design[::2, 0], design[1::2, 0]
    curves = (Curve("ahead", ahead, seen[::2]), Curve("to the left", aside, seen[1::2]))
    return judge(
        HEADING,
        imu.topic,
        f"the unit looks {turned} than declared, by the accelerations of {block[-1] + 1:.0f} "
        f"pieces of {BLOCK_S:g} s",
        Measurement(off_deg, sigma_deg, "deg"),
        advice="Correct the yaw of the unit's transform, or its driver's axes.",
        repairs=(Repair("turn_imu", imu.topic, {"yaw_rad": -float(np.radians(off_deg))}),),
        fault_plots=(
            Plot("Accelerations felt and driven", "driven (m/s^2)", "felt (m/s^2)", curves),
        ),
    )


def _turn_alike(imu: RawImu, driven: IntegratedMotion, R_base_imu: FloatArray) -> bool:
    """Whether both turn to the same side: of an odometry that does not, curves are mirrored."""
    rates = (imu.angular_velocity_rad_s @ R_base_imu.T)[:, 2]
    times_s: FloatArray = (imu.stamps_ns - driven.origin_ns).astype(np.float64) * 1e-9
    turned = driven.at(times_s)[:, 1]
    return bool(np.nansum(rates[1:] * np.diff(turned)) > 0.0)


def _windows(
    imu: RawImu, felt: FloatArray, sound: BoolArray, driven: IntegratedMotion
) -> tuple[FloatArray, FloatArray, IntArray] | None:
    """(2k, 6) design, (2k,) mean accelerations ahead and to the left in turn, (2k,) block of each;
    None of fewer than ``MIN_BLOCKS`` blocks.

    Unknown are cosine and sine of the unit's yaw, its place in the base (2,) and its bias (2,).
    """
    begin_ns = max(int(imu.stamps_ns.min()), driven.origin_ns)
    end_ns = min(int(imu.stamps_ns.max()), int(driven.stamps_ns[-1]))
    if not MIN_BLOCKS * BLOCK_S <= (end_ns - begin_ns) * 1e-9 <= LONGEST_S:
        return None
    edges_s = np.arange(0.0, (end_ns - begin_ns) * 1e-9, WINDOW_S)
    at_s = np.asarray(edges_s + (begin_ns - driven.origin_ns) * 1e-9, dtype=np.float64)
    before, after = driven.at(at_s - 0.25 * WINDOW_S), driven.at(at_s + 0.25 * WINDOW_S)
    path, turn = ((after - before) / (0.5 * WINDOW_S)).T
    speed, rate = ((driven.at(at_s[1:]) - driven.at(at_s[:-1])) / WINDOW_S).T
    tangential, angular = np.diff(path) / WINDOW_S, np.diff(turn) / WINDOW_S
    place = np.searchsorted(edges_s, (imu.stamps_ns - begin_ns) * 1e-9) - 1
    inside = sound & (place >= 0) & (place < edges_s.size - 1)
    count = np.bincount(place[inside], minlength=edges_s.size - 1)
    mean = (
        np.column_stack(
            [np.bincount(place[inside], column[inside], edges_s.size - 1) for column in felt.T]
        )
        / np.maximum(count, 1)[:, None]
    )
    known = (count > 0) & driven.covers(at_s[:-1], at_s[1:])
    zero, one = np.zeros(speed.size), np.ones(speed.size)
    inward = speed * rate
    rows = np.stack(
        [
            np.column_stack([tangential, -inward, -(rate**2), -angular, one, zero]),
            np.column_stack([inward, tangential, angular, -(rate**2), zero, one]),
        ],
        axis=1,
    )[known]
    block = np.repeat(np.unique(edges_s[:-1][known] // BLOCK_S, return_inverse=True)[1], 2)
    if not block.size or block[-1] + 1 < MIN_BLOCKS:
        return None
    return np.asarray(rows.reshape(-1, 6)), np.asarray(mean[known].reshape(-1)), block
