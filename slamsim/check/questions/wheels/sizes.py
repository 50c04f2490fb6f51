"""Wheels against scans: radius, track, and swapped or reversed wiring."""

from __future__ import annotations

import numpy as np

from slamsim.check.calibration.explanation import LIMITS, Explanation, Size
from slamsim.check.calibration.joint import Calibration
from slamsim.check.evidence import of_sizes
from slamsim.check.findings import Finding, Measurement
from slamsim.check.motion.integrated import IntegratedMotion
from slamsim.check.question import FaultKind, Question, QuestionGroup, anywhere, judge, unanswered
from slamsim.check.questions.wheels.counters import TICKS_FROZEN
from slamsim.check.wording import signed_words
from slamsim.recording.repairs.base import Repair

UNEQUAL_LIMIT = 0.0025
"""Careful calibration leaves 0.2 % between the wheels (Borenstein & Feng 1996)."""

STRAIGHT_LIMIT_DEG_M = 0.5
"""That on a robot whose wheels are 0.3 m apart: narrower ones are rare."""

_SIZES: tuple[Size, Size] = ("radius", "track")
DRIVING = "ten metres of straight driving"
TURNING = "a few full turns on the spot"


SWAPPED = FaultKind(
    "wheels_swapped",
    "left and right wheel are exchanged",
    (anywhere("odometry_contradicts_wheels", "wheel_slip", "wheel_track", "imu_axis"),),
)
REVERSED = FaultKind(
    "wheel_reversed",
    "one wheel counts backward",
    (
        anywhere(
            *("odometry_contradicts_wheels", "wheel_slip", "wheel_track", "wheel_radius"),
            "imu_axis",
        ),
    ),
)
WHEEL_RADIUS = FaultKind("wheel_radius", "the wheels are larger or smaller than declared")
WIRING = Question(
    "wheels.wiring",
    "both wheels count forward, left on the left",
    (SWAPPED, REVERSED, TICKS_FROZEN),
    consequence="the odometry turns the wrong way, or turns when the robot goes straight",
    excitation_wanted=TURNING,
    repairs=("swap_wheels", "reverse_wheel", "scale_odometry"),
)
RADIUS = Question(
    "wheels.radius",
    "the wheels are as large as declared",
    (WHEEL_RADIUS,),
    limit=100.0 * LIMITS["radius"],
    unit="%",
    consequence="the odometry goes too far by this share of the path",
    excitation_wanted=DRIVING,
    repairs=("scale_wheels", "scale_odometry"),
)
UNEQUAL = Question(
    "wheels.unequal",
    "both wheels are equally large",
    (WHEEL_RADIUS,),
    limit=100.0 * UNEQUAL_LIMIT,
    unit="%",
    consequence="the odometry makes a curve of a straight drive",
    excitation_wanted=DRIVING,
    repairs=("scale_wheels", "scale_odometry"),
)
STRAIGHT = Question(
    "odometry.straight",
    "the robot goes straight where the odometry does",
    (WHEEL_RADIUS,),
    limit=STRAIGHT_LIMIT_DEG_M,
    unit="deg/m",
    consequence="the odometry makes a curve of a straight drive",
    excitation_wanted=DRIVING,
    repairs=("scale_odometry",),
)
TRACK = Question(
    "wheels.track",
    "the wheels are as far apart as declared",
    (FaultKind("wheel_track", "the wheels stand wider or closer than declared"),),
    limit=100.0 * LIMITS["track"],
    unit="%",
    consequence="the odometry turns too far by this share of every turn",
    excitation_wanted=TURNING,
    repairs=("scale_wheels", "scale_odometry"),
)


_ONE_WHEEL = {
    "dead": (
        TICKS_FROZEN,
        "never counts: the odometry never leaves one circle, while the robot does",
    ),
    "reversed": (REVERSED, "counts backward: what the odometry calls a path is a turn"),
}
"""What poses show of one wheel that is unlike the other."""


def check_wheels(calibration: Calibration, explained: Explanation) -> list[Finding]:
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
        _size(RADIUS, wheels, explained, "radius"),
        _unequal(calibration, wheels, explained),
        _size(TRACK, wheels, explained, "track"),
    ]


GROUP = QuestionGroup(
    "motion",
    160,
    (WIRING, RADIUS, UNEQUAL, STRAIGHT, TRACK),
    of_sizes(check_wheels),
    thorough=True,
)


def _wiring(calibration: Calibration, wheels: IntegratedMotion) -> list[Finding]:
    wiring = calibration.alignment.wiring
    if not wheels.wired:
        return _turning(calibration, wheels)
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


def _turning(calibration: Calibration, wheels: IntegratedMotion) -> list[Finding]:
    """Of poses only the direction of turns can be told, and one wheel that is unlike the other."""
    side, _, wrong = calibration.alignment.wiring.partition(" ")
    if wrong in _ONE_WHEEL:
        fault, words = _ONE_WHEEL[wrong]
        return [
            judge(
                *(WIRING, wheels.topic, f"the {side} wheel {words}"),
                verdict="fault",
                fault=fault,
                advice="Look at that wheel's encoder, its cable and its sign in the driver.",
            )
        ]
    if not calibration.follows("wheel") or calibration.value("turn_gain") > 0.0:
        return []
    return [
        judge(
            WIRING,
            wheels.topic,
            "the odometry turns right where the robot turns left",
            verdict="fault",
            fault=SWAPPED,
            advice="Exchange the two wheels in the driver, or change the sign of its turns.",
            repairs=(
                Repair("scale_odometry", wheels.topic, {"path_factor": 1.0, "turn_factor": -1.0}),
            ),
        )
    ]


def _size(
    question: Question, wheels: IntegratedMotion, explained: Explanation, size: Size
) -> Finding:
    too_large = explained.too_large[size]
    if too_large is None:
        words = "nothing tells it apart from another size that is wrong"
        return unanswered(question, wheels.topic, words)
    more, less = ("large", "small") if question is RADIUS else ("far apart", "close together")
    off = signed_words(too_large.value, "%", f"too {more}", f"too {less}")
    return judge(
        question,
        wheels.topic,
        f"the wheels are believed {off}",
        too_large,
        advice=_advice(explained),
        repairs=(_repair(wheels, explained),),
    )


def _unequal(calibration: Calibration, wheels: IntegratedMotion, explained: Explanation) -> Finding:
    """The curve that wheels make of a straight drive, as far as their driver does not know."""
    curvature_rad_m = calibration.value("curvature_rad_m") / calibration.value("path_gain")
    sigma_rad_m = calibration.sigma("curvature_rad_m") / abs(calibration.value("path_gain"))
    if not wheels.wired:
        curved = Measurement(
            float(np.degrees(curvature_rad_m)), float(np.degrees(sigma_rad_m)), "deg/m"
        )
        side = "left" if curved.value > 0.0 else "right"
        return judge(
            STRAIGHT,
            wheels.topic,
            f"where the odometry goes straight the robot turns {side} by {abs(curved.value):.2g} "
            "deg/m",
            curved,
            advice="Measure both wheels: one is larger than the other.",
            repairs=(_repair(wheels, explained, calibration.value("curvature_rad_m")),),
        )
    larger = Measurement(
        100.0 * wheels.track_m * curvature_rad_m, 100.0 * wheels.track_m * sigma_rad_m, "%"
    )
    which = "right" if larger.value > 0.0 else "left"
    return judge(
        UNEQUAL,
        wheels.topic,
        f"the {which} wheel is {abs(larger.value):.2g} % larger than the other",
        larger,
        advice="Measure both wheels: a driver that knows one radius cannot correct it.",
        repairs=(_repair(wheels, explained),),
    )


def _factors(explained: Explanation) -> tuple[float, float]:
    """What to multiply the radius of the wheels by, and their track: 1 where they are right."""
    radius, track = (
        1.0 / (1.0 + found.value / 100.0) if found and size in explained.wrong else 1.0
        for size, found in ((one, explained.too_large[one]) for one in _SIZES)
    )
    return radius, track


def _advice(explained: Explanation) -> str:
    radius, track = _factors(explained)
    return f"Multiply the radius of the wheels by {radius:.5f} and the track by {track:.5f}."


def _repair(
    wheels: IntegratedMotion, explained: Explanation, curvature_rad_m: float = 0.0
) -> Repair:
    radius, track = _factors(explained)
    if wheels.wired:
        sizes: dict[str, float | str] = {"radius_factor": radius, "track_factor": track}
        return Repair("scale_wheels", wheels.topic, sizes)
    factors: dict[str, float | str] = {"path_factor": radius, "turn_factor": radius / track}
    if curvature_rad_m:
        factors["curvature_rad_m"] = curvature_rad_m
    return Repair("scale_odometry", wheels.topic, factors)
