"""Wheels against scans: radius, track, and swapped or reversed wiring."""

from __future__ import annotations

import numpy as np

from slamsim.check.calibration.joint import Calibration
from slamsim.check.calibration.majority import Majority, majority
from slamsim.check.evidence import of_calibration
from slamsim.check.findings import Finding, Measurement
from slamsim.check.motion.integrated import IntegratedMotion
from slamsim.check.question import FaultKind, Question, QuestionGroup, anywhere, judge, unanswered
from slamsim.recording.repairs.base import Repair

RADIUS_LIMIT, TRACK_LIMIT = 0.01, 0.02
"""Careful calibration leaves 0.2 % and 0.5 % (Borenstein & Feng 1996); tape measures less."""

POSES_TIMES = 6.0
"""So many times wider are limits where poses come instead of counters: rarely, late, smoothed."""

RADIUS_HARM, TRACK_HARM = 0.03, 0.06
DRIVING = "ten metres of straight driving"
TURNING = "a few full turns on the spot"


SWAPPED = FaultKind(
    "wheels_swapped",
    "left and right wheel are exchanged",
    (anywhere("odometry_contradicts_wheels", "wheel_slip", "wheel_track"),),
)
REVERSED = FaultKind(
    "wheel_reversed",
    "one wheel counts backward",
    (anywhere("odometry_contradicts_wheels", "wheel_slip", "wheel_track", "wheel_radius"),),
)
WHEEL_RADIUS = FaultKind("wheel_radius", "the wheels are larger or smaller than declared")
WIRING = Question(
    "wheels.wiring",
    "both wheels count forward, left on the left",
    (SWAPPED, REVERSED),
    consequence="the odometry turns the wrong way, or turns when the robot goes straight",
    excitation_wanted=TURNING,
    repairs=("swap_wheels", "reverse_wheel"),
)
RADIUS = Question(
    "wheels.radius",
    "the wheels are as large as declared",
    (WHEEL_RADIUS,),
    limit=100.0 * RADIUS_LIMIT,
    unit="%",
    consequence="the odometry goes too far by this share of the path",
    excitation_wanted=DRIVING,
    repairs=("scale_wheels", "scale_odometry"),
)
UNEQUAL = Question(
    "wheels.unequal",
    "both wheels are equally large",
    (WHEEL_RADIUS,),
    limit=100.0 * RADIUS_LIMIT,
    unit="%",
    consequence="the odometry makes a curve of a straight drive",
    excitation_wanted=DRIVING,
    repairs=("scale_wheels", "scale_odometry"),
)
TRACK = Question(
    "wheels.track",
    "the wheels are as far apart as declared",
    (FaultKind("wheel_track", "the wheels stand wider or closer than declared"),),
    limit=100.0 * TRACK_LIMIT,
    unit="%",
    consequence="the odometry turns too far by this share of every turn",
    excitation_wanted=TURNING,
    repairs=("scale_wheels", "scale_odometry"),
)


def check_wheels(calibration: Calibration) -> list[Finding]:
    """Wiring first; sizes of the wheels as they are really wired."""
    wheels = calibration.model.wheels
    if wheels is None:
        return []
    if not calibration.scans_count or not calibration.comparable:
        words = "without scans that follow them nothing tells how far the wheels really go"
        return [
            *_wiring(calibration, wheels),
            unanswered(RADIUS, wheels.topic, words),
            unanswered(TRACK, wheels.topic, words),
        ]
    return [
        *_wiring(calibration, wheels),
        _radius(calibration, wheels),
        *_unequal(calibration, wheels),
        _track(calibration, wheels, majority(calibration)),
    ]


GROUP = QuestionGroup(
    "motion",
    160,
    (WIRING, RADIUS, UNEQUAL, TRACK),
    of_calibration(check_wheels),
    thorough=True,
)


def _wiring(calibration: Calibration, wheels: IntegratedMotion) -> list[Finding]:
    wiring = calibration.alignment.wiring
    if not wheels.wired:
        return []
    if wiring == "as declared":
        if not any(calibration.follows(pair) for pair in ("wheel", "gyro_wheel")):
            words = "nothing that the robot did shows how they are wired"
            return [unanswered(WIRING, wheels.topic, words)]
        words = "both wheels count forward, left on the left"
        return [judge(WIRING, wheels.topic, words, verdict="ok")]
    if wiring == "swapped":
        words = (
            "the wheels turn the robot the other way than it turns: left and right are exchanged"
        )
        fault, advice = SWAPPED, "Exchange the two counters."
        repair = Repair("swap_wheels", wheels.topic)
    else:
        which = wiring.split()[0]
        words = f"the {which} wheel counts backward: what it calls a path is a turn"
        fault, advice = REVERSED, "Change the sign of its counts."
        repair = Repair("reverse_wheel", wheels.topic, {"wheel": which})
    return [
        judge(
            *(WIRING, wheels.topic, words),
            verdict="fault",
            fault=fault,
            advice=advice,
            repairs=(repair,),
        )
    ]


def _radius(calibration: Calibration, wheels: IntegratedMotion) -> Finding:
    gain, sigma = calibration.value("path_gain"), calibration.sigma("path_gain")
    large = 100.0 * (1.0 / gain - 1.0)
    return judge(
        RADIUS,
        wheels.topic,
        f"the wheels are believed {large:+.3g} % too large",
        Measurement(large, 100.0 * sigma / gain**2, "%"),
        limit=100.0 * _limit(wheels, RADIUS_LIMIT),
        harm=100.0 * RADIUS_HARM,
        advice=_advice(calibration, wheels),
        repairs=(_repair(calibration, wheels),),
    )


def _limit(wheels: IntegratedMotion, limit: float) -> float:
    return limit if wheels.wired else POSES_TIMES * limit


def _unequal(calibration: Calibration, wheels: IntegratedMotion) -> list[Finding]:
    """The right wheel's true radius over the left one's, as far as their driver does not know."""
    if not wheels.wired:
        return []
    per_curvature = 100.0 * wheels.track_m / calibration.value("path_gain")
    larger = per_curvature * calibration.value("curvature_rad_m")
    sigma = abs(per_curvature) * calibration.sigma("curvature_rad_m")
    return [
        judge(
            UNEQUAL,
            wheels.topic,
            f"the right wheel is {larger:+.2g} % larger than the left one",
            Measurement(larger, sigma, "%"),
            harm=100.0 * RADIUS_HARM,
            advice=_advice(calibration, wheels),
            repairs=(_repair(calibration, wheels),),
        )
    ]


def _track(calibration: Calibration, wheels: IntegratedMotion, turns: Majority) -> Finding:
    path, turn = calibration.value("path_gain"), turns.turn_gain
    relative = np.hypot(
        calibration.sigma("path_gain") / path, calibration.sigma("turn_gain") / turn
    )
    ratio = turn / path
    return judge(
        TRACK,
        wheels.topic,
        f"the wheels are believed {100.0 * (ratio - 1.0):+.3g} % too far apart",
        Measurement(100.0 * (ratio - 1.0), 100.0 * float(relative) * abs(ratio), "%"),
        limit=100.0 * _limit(wheels, TRACK_LIMIT),
        harm=100.0 * TRACK_HARM,
        advice=_advice(calibration, wheels),
        repairs=(_repair(calibration, wheels),),
    )


def _true_wheels(calibration: Calibration, wheels: IntegratedMotion) -> tuple[float, float, float]:
    """What to multiply the left and the right radius by, and the track."""
    path, turn = calibration.value("path_gain"), calibration.value("turn_gain")
    half = 0.5 * calibration.value("curvature_rad_m") * wheels.track_m
    return path - half, path + half, path / turn


def _advice(calibration: Calibration, wheels: IntegratedMotion) -> str:
    left, right, track = _true_wheels(calibration, wheels)
    return (
        f"Multiply the radius of the left wheel by {left:.5f}, of the right by {right:.5f}, "
        f"and the track by {track:.5f}."
    )


def _repair(calibration: Calibration, wheels: IntegratedMotion) -> Repair:
    left, right, track = _true_wheels(calibration, wheels)
    if wheels.wired:
        sizes = {"radius_factor": 0.5 * (left + right), "track_factor": track}
        return Repair("scale_wheels", wheels.topic, dict(sizes))
    path, turn = calibration.value("path_gain"), calibration.value("turn_gain")
    return Repair("scale_odometry", wheels.topic, {"path_factor": path, "turn_factor": turn})
