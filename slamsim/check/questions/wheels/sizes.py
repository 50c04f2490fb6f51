"""Wheels against scans: their radius, their track, and whether they are wired as declared."""

from __future__ import annotations

import numpy as np

from slamsim.check.calibration.joint import Calibration
from slamsim.check.calibration.majority import Vote
from slamsim.check.findings import Estimate, Finding, Mend
from slamsim.check.judge import Answer, Question, judged
from slamsim.check.motion.integrated import Course

RADIUS_LIMIT, TRACK_LIMIT = 0.01, 0.02
"""Careful calibration leaves 0.2 % and 0.5 % (Borenstein & Feng 1996); tape measures less."""

POSES_TIMES = 6.0
"""Poses that a driver has made of its wheels come rarely, late and smoothed: so much coarser."""

RADIUS_HARM, TRACK_HARM = 0.03, 0.06
DRIVING = "ten metres of straight driving"
TURNING = "a few full turns on the spot"


def check_wheels(calibration: Calibration, vote: Vote) -> list[Finding]:
    """Wiring first; sizes of the wheels as they are really wired."""
    wheels = calibration.model.wheels
    if wheels is None:
        return []
    if not calibration.scans_count or not calibration.comparable:
        words = "without scans that follow them nothing tells how far the wheels really go"
        return [
            *_wiring(calibration),
            Finding("wheels.radius", wheels.topic, "cannot tell", words),
            Finding("wheels.track", wheels.topic, "cannot tell", words),
        ]
    return [
        *_wiring(calibration),
        _radius(calibration),
        *_unequal(calibration),
        _track(calibration, vote),
    ]


def _wiring(calibration: Calibration) -> list[Finding]:
    wheels, wiring = calibration.model.wheels, calibration.alignment.wiring
    if wheels is None or not wheels.wired:
        return []
    if wiring == "as declared":
        words = "both wheels count forward, left on the left"
        told = any(calibration.follows(pair) for pair in ("wheel", "gyro_wheel"))
        verdict_words = words if told else "nothing that the robot did shows how they are wired"
        return [
            Finding("wheels.wiring", wheels.topic, "ok" if told else "cannot tell", verdict_words)
        ]
    swapped = wiring == "swapped"
    which = wiring.split()[0]
    mend = (
        Mend("swap_wheels", wheels.topic)
        if swapped
        else Mend("reverse_wheel", wheels.topic, {"wheel": which})
    )
    words = (
        "the wheels turn the robot the other way than it turns: left and right are exchanged"
        if swapped
        else f"the {which} wheel counts backward: what it calls a path is a turn"
    )
    fault = "wheels_swapped" if swapped else "wheel_reversed"
    advice = "Exchange the two counters." if swapped else "Change the sign of its counts."
    return [
        Finding("wheels.wiring", wheels.topic, "bad", words, fault, advice, mends=(mend,)),
    ]


def _radius(calibration: Calibration) -> Finding:
    wheels = calibration.model.wheels
    assert wheels is not None
    gain, sigma = calibration.value("path_gain"), calibration.sigma("path_gain")
    large = 100.0 * (1.0 / gain - 1.0)
    return judged(
        Question(
            *("wheels.radius", wheels.topic, "wheel_radius"),
            *(100.0 * _limit(wheels, RADIUS_LIMIT), 100.0 * RADIUS_HARM, DRIVING),
        ),
        Estimate(large, 100.0 * sigma / gain**2, "%"),
        Answer(
            f"the wheels are believed {large:+.3g} % too large",
            *(_advice(calibration), (_mend(calibration),)),
        ),
    )


def _limit(wheels: Course, limit: float) -> float:
    return limit if wheels.wired else POSES_TIMES * limit


def _unequal(calibration: Calibration) -> list[Finding]:
    """The right wheel's true radius over the left one's, as far as their driver does not know."""
    wheels = calibration.model.wheels
    if wheels is None or not wheels.wired:
        return []
    per_curvature = 100.0 * wheels.track_m / calibration.value("path_gain")
    larger = per_curvature * calibration.value("curvature_rad_m")
    sigma = abs(per_curvature) * calibration.sigma("curvature_rad_m")
    finding = judged(
        Question(
            *("wheels.unequal", wheels.topic, "wheel_radius"),
            *(100.0 * RADIUS_LIMIT, 100.0 * RADIUS_HARM, DRIVING),
        ),
        Estimate(larger, sigma, "%"),
        Answer(
            f"the right wheel is {larger:+.2g} % larger than the left one",
            *(_advice(calibration), (_mend(calibration),)),
        ),
    )
    return [finding]


def _track(calibration: Calibration, vote: Vote) -> Finding:
    wheels = calibration.model.wheels
    assert wheels is not None
    path, turn = calibration.value("path_gain"), vote.turn_gain
    relative = np.hypot(
        calibration.sigma("path_gain") / path, calibration.sigma("turn_gain") / turn
    )
    ratio = turn / path
    words = f"the wheels are believed {100.0 * (ratio - 1.0):+.3g} % too far apart"
    return judged(
        Question(
            *("wheels.track", wheels.topic, "wheel_track"),
            *(100.0 * _limit(wheels, TRACK_LIMIT), 100.0 * TRACK_HARM, TURNING),
        ),
        Estimate(100.0 * (ratio - 1.0), 100.0 * float(relative) * abs(ratio), "%"),
        Answer(words, _advice(calibration), (_mend(calibration),)),
    )


def true_wheels(calibration: Calibration) -> tuple[float, float, float]:
    """What to multiply the left and the right radius by, and the track."""
    wheels = calibration.model.wheels
    track_m = 0.0 if wheels is None else wheels.track_m
    path, turn = calibration.value("path_gain"), calibration.value("turn_gain")
    half = 0.5 * calibration.value("curvature_rad_m") * track_m
    return path - half, path + half, path / turn


def _advice(calibration: Calibration) -> str:
    left, right, track = true_wheels(calibration)
    return (
        f"Multiply the radius of the left wheel by {left:.5f}, of the right by {right:.5f}, "
        f"and the track by {track:.5f}."
    )


def _mend(calibration: Calibration) -> Mend:
    wheels = calibration.model.wheels
    assert wheels is not None
    left, right, track = true_wheels(calibration)
    if wheels.wired:
        sizes = {"radius_factor": 0.5 * (left + right), "track_factor": track}
        return Mend("scale_wheels", wheels.topic, dict(sizes))
    path, turn = calibration.value("path_gain"), calibration.value("turn_gain")
    return Mend("scale_odometry", wheels.topic, {"path_factor": path, "turn_factor": turn})
