"""Whether scans turn as the robot turns: the question behind torn maps."""

from __future__ import annotations

import numpy as np

from slamsim.check.fault_groups import LIDAR_TIMES, MOUNTING, SIZES, SWEEPS
from slamsim.check.findings import SURE_SIGMAS, Curve, Finding, Measurement, Plot, Verdict
from slamsim.check.motion.alignment import align
from slamsim.check.motion.inputs import Inputs
from slamsim.check.motion.laser_steps import LaserSteps
from slamsim.check.question import FaultKind, Question, anywhere, judge, unanswered
from slamsim.check.questions.laser.gain import Gain, turn_gain
from slamsim.check.questions.laser.heading import heading_by_path
from slamsim.check.questions.laser.shape import LASER_ANGLE_STEP
from slamsim.recording.repairs.base import Repair

SAME_GAIN = 0.1
"""Gains this near to 1, 0, 2 or -1 are meant to be so; others are a matter of scale."""

SMALL_RATIO = 0.15
"""Scans that do not follow the robot still seem to turn a little, by what they mistake for it."""

STILL_GAIN, STILL_RATIO, MANY_TURNS_RAD = 0.15, 0.5, 12.0
"""Over some full turns this is enough: what follows the robot and is lost seems to turn more."""

SEEN_TURNS = 0.25
"""So small a share of the robot's turns must the scans be able to see."""

LEAST_TURNED_RAD = 1.0
"""Of the stream that is compared: with less, noise of the scans weighs as much as the turn."""
LARGEST_SIGMA = 0.04
"""Of a gain: with more, 1 and 1.1 cannot be told apart."""
FOLLOWS = 0.7
"""Correlation from which on a stream turns as the scans do, half of its variance."""
DEGREE = float(np.deg2rad(1.0))
ALIKE = 0.05
"""Two streams whose gains differ by less agree."""
LEAST_POINTS = 2
TURNING = "turning on the spot, some full turns to either side"

WORLD_FIXED = FaultKind(
    "laser_world_fixed",
    "the rays keep their directions in the world while the robot turns",
    (
        anywhere(
            *(*SIZES, *LIDAR_TIMES, *SWEEPS),
            *("laser_angle_step", "range_offset", "stamps_invented"),
            *("time_offset_wheels", "clock_drift", "odometry_unsigned"),
        ),
    ),
)
TURNED_TWICE = FaultKind(
    "laser_turned_twice",
    "the rays turn with the robot a second time",
    WORLD_FIXED.explains,
)
MIRRORED = FaultKind(
    "laser_mirrored",
    "the scan turns the wrong way: mirrored, left-handed or upside down",
    (anywhere(*MOUNTING, *SWEEPS, "gyro_sign", "wheels_swapped"),),
)
UPSIDE_DOWN = FaultKind(
    "laser_upside_down",
    "the laser hangs upside down, its frame does not say so",
    (anywhere(*MOUNTING, *SWEEPS, "laser_mirrored"),),
)
ROTATION = Question(
    "laser.rotation",
    "the scans turn as the robot does",
    (WORLD_FIXED, TURNED_TWICE, MIRRORED, UPSIDE_DOWN, LASER_ANGLE_STEP),
    limit=SAME_GAIN,
    unit="rad/rad",
    consequence="the map is torn wherever the robot turns",
    excitation_wanted=TURNING,
    repairs=("turn_with_robot", "negate_angles", "turn_frame", "scale_angles"),
)


def check_rotation(inputs: Inputs) -> Finding:
    """The gain of the scans' rotation against gyroscope and wheels.

    inputs: streams, the laser's steps as seen from above where its frame declares it to hang.
    """
    gains = rotation_gains(inputs)
    topic = inputs.steps.topic
    if inputs.gyro is None and inputs.wheels is None:
        words = "neither a gyroscope nor wheels are there to compare the scans' turns with"
        return unanswered(ROTATION, topic, words)
    telling = [gain for gain in gains if gain.turned_rad > LEAST_TURNED_RAD]
    if not telling:
        most = max((gain.turned_rad for gain in gains), default=0.0)
        words = f"the robot turned by {np.degrees(most):.0f} deg in all; what would tell: {TURNING}"
        return unanswered(ROTATION, topic, words)
    return _judged(telling, inputs)


def rotation_gains(inputs: Inputs) -> list[Gain]:
    """Against each of gyroscope and wheels that says enough."""
    yaw_rad = 0.0 if inputs.T_base_laser is None else float(inputs.T_base_laser[2])
    alignment = align(inputs.steps, inputs.gyro, inputs.wheels, yaw_rad)
    gains = [
        # An offset of which nothing is clear compares turns with what was driven at another time.
        turn_gain(inputs.steps, motion, column, shift if shift and shift.clear else None)
        for motion, column, shift in (
            (inputs.gyro, 0, alignment.lidar_gyro),
            (alignment.wheels, 1, alignment.lidar_wheels),
        )
        if motion is not None
    ]
    return [_in_radians(gain) for gain in gains if gain is not None]


def _in_radians(gain: Gain) -> Gain:
    """The gain of the scans against a stream in degrees, as if it were in radians."""
    if abs(gain.correlation) < FOLLOWS or abs(abs(gain.value) / DEGREE - 1.0) > SAME_GAIN:
        return gain
    return Gain(
        gain.topic,
        gain.value / DEGREE,
        gain.sigma / DEGREE,
        gain.correlation,
        gain.ratio / DEGREE,
        gain.turned_rad * DEGREE,
        gain.scans_rad_s,
        gain.other_rad_s * DEGREE,
    )


def _near(gain: Gain, whole: float) -> bool:
    """Steps that hardly turn, of a fast lidar of few beams, correlate badly for the noise of each:
    there it is how surely the gain is known that tells whether one follows the other."""
    follows = abs(gain.correlation) > FOLLOWS or SURE_SIGMAS * gain.sigma < SAME_GAIN
    return abs(gain.value - whole) < SAME_GAIN and follows


def _stands(gain: Gain, steps: LaserSteps) -> bool:
    """The scans do not turn while the other stream does."""
    if abs(gain.value) < SAME_GAIN and gain.ratio < SMALL_RATIO:
        return True
    variance = np.linalg.pinv(steps.information, hermitian=True)[:, 2, 2]
    unsure_rad_s = np.sqrt(variance) / ((steps.second_ns - steps.first_ns) * 1e-9)
    seen = float(np.median(unsure_rad_s)) < SEEN_TURNS * float(np.abs(gain.other_rad_s).mean())
    still = abs(gain.value) < STILL_GAIN and gain.ratio < STILL_RATIO
    return still and seen and gain.turned_rad > MANY_TURNS_RAD


def _judged(gains: list[Gain], inputs: Inputs) -> Finding:
    best = min(gains, key=lambda gain: abs(gain.value - 1.0))
    said = "; ".join(_said(gain) for gain in gains)
    healthy = [gain for gain in gains if _near(gain, 1.0)]
    if healthy:
        return _finding(inputs, healthy[0], f"the scans turn as the robot does: {said}")
    if all(_stands(gain, inputs.steps) for gain in gains):
        return _world_fixed(inputs, gains[0], said)
    if all(_near(gain, -1.0) for gain in gains):
        return _mirrored(inputs, gains[0], said)
    if all(_near(gain, 2.0) for gain in gains):
        return _turned_twice(inputs, gains[0], said)
    unsure = [
        gain for gain in gains if gain.sigma > LARGEST_SIGMA or abs(gain.correlation) < FOLLOWS
    ]
    apart = max(gain.value for gain in gains) - min(gain.value for gain in gains)
    if unsure or apart > ALIKE * abs(best.value) or len(gains) < LEAST_POINTS:
        words = f"{said}: they follow the scans too badly, or contradict each other, to judge"
        if not unsure and len(gains) < LEAST_POINTS:
            words = f"{said}: the scans or the other turn too far, and no third sensor says which"
        words += f"; what would tell: {TURNING}"
        return _finding(inputs, best, words, "inconclusive")
    words = f"scans turn {best.value:.4g} times as far as the robot: {said}"
    advice = f"Divide the angle between beams by {best.value:.5g}."
    repair = Repair("scale_angles", inputs.steps.topic, {"factor": 1.0 / best.value})
    return _finding(inputs, best, words, "fault", LASER_ANGLE_STEP, advice, repair)


def _said(gain: Gain) -> str:
    return f"gain {gain.value:.4g} ± {1.96 * gain.sigma:.2g} against {gain.topic}"


def _world_fixed(inputs: Inputs, gain: Gain, said: str) -> Finding:
    words = f"the scans do not turn while the robot does ({said}): rays are fixed to the world"
    advice = (
        "Cast or publish the rays in the laser's own frame, or turn each recorded scan by the "
        "robot's heading."
    )
    repair = Repair("turn_with_robot", inputs.steps.topic, _heading(inputs, gain.topic))
    return _finding(inputs, gain, words, "fault", WORLD_FIXED, advice, repair)


def _turned_twice(inputs: Inputs, gain: Gain, said: str) -> Finding:
    """A wrong angle between beams is none of it: scans are matched with the one at which they fit
    each other, and then turn as the robot does."""
    words = f"the scans turn twice as far as the robot ({said}): its heading is in the rays already"
    advice = "Add the robot's heading once, or turn each recorded scan back by it."
    repair = Repair(
        "turn_with_robot", inputs.steps.topic, {"heading_from": gain.topic, "turns": -1.0}
    )
    return _finding(inputs, gain, words, "fault", TURNED_TWICE, advice, repair)


def _heading(inputs: Inputs, topic: str) -> dict[str, float | str]:
    """Where the robot heads, by the stream of a topic and the path of the laser."""
    by_gyro = inputs.gyro is not None and inputs.gyro.topic == topic
    motion, column = (inputs.gyro, 0) if by_gyro else (inputs.wheels, 1)
    x_m, y_m, yaw_rad = (0.0, 0.0, 0.0) if inputs.T_base_laser is None else inputs.T_base_laser
    found = None
    if motion is not None:
        found = heading_by_path(inputs.steps, motion, column, np.array([x_m, y_m]))
    if found is None:
        return {"heading_from": topic}
    offset_rad = found.offset_rad + float(yaw_rad)
    return {"heading_from": topic, "drift_rad_s": found.drift_rad_s, "offset_rad": offset_rad}


def _mirrored(inputs: Inputs, gain: Gain, said: str) -> Finding:
    if inputs.upside_down:
        words = f"the scans turn against the robot ({said}): the frame hangs upside down, they not"
        advice = "Remove the roll of 180 degrees from the laser's frame."
        over = {"roll_rad": float(np.pi), "pitch_rad": 0.0, "yaw_rad": 0.0}
        repair = Repair("turn_frame", inputs.laser_frame, {**over})
        return _finding(inputs, gain, words, "fault", UPSIDE_DOWN, advice, repair)
    words = f"the scans turn against the robot ({said}): they are mirrored, or hang upside down"
    advice = (
        "Publish the beams counter-clockwise as seen from above (negate the angles), or give the "
        "laser's frame a roll of 180 degrees if it hangs upside down."
    )
    repair = Repair("negate_angles", inputs.steps.topic)
    return _finding(inputs, gain, words, "fault", MIRRORED, advice, repair)


def _finding(
    inputs: Inputs,
    gain: Gain,
    words: str,
    verdict: Verdict = "ok",
    fault: FaultKind | None = None,
    advice: str = "",
    *repairs: Repair,
) -> Finding:
    return judge(
        ROTATION,
        inputs.steps.topic,
        words,
        Measurement(gain.value, gain.sigma, "rad/rad"),
        verdict=verdict,
        fault=fault,
        advice=advice,
        repairs=repairs,
        plots=(_plot(gain),),
    )


def _plot(gain: Gain) -> Plot:
    ends = np.array([gain.other_rad_s.min(), gain.other_rad_s.max()])
    return Plot(
        title=f"Turn rate of the scans against {gain.topic}",
        x_label=f"turn rate by {gain.topic} (rad/s)",
        y_label="turn rate by the scans (rad/s)",
        curves=(
            Curve("steps from scan to scan", gain.other_rad_s, gain.scans_rad_s),
            Curve("healthy: gain 1", ends, ends, "line"),
            Curve(f"found: gain {gain.value:.3g}", ends, gain.value * ends, "line"),
        ),
    )
