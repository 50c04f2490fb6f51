"""Verdicts on UMBmark: claims of the study, theory, and targets."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

from slamsim.config.robot import RobotConfig, VariationConfig
from slamsim.scenarios.base import Row, Verdict
from slamsim.scenarios.rows import number
from slamsim.scenarios.scripted import IDENTIFIED, SQUARE_SIDE_M, SQUARES, UNITY_CORNERS_DEG
from slamsim.scenarios.umbmark.method import CorrectionResult, DrivenSquares, WheelCorrection

CLOSE_M, LEAST_SPREAD_M, MOST_SPREAD_M = 0.25, 1.0, 2.0
"""The study gives the largest error of its real robot (1.06 m) and the spread (1.8 m) of so few
runs that they are known no better."""
CORNER_WITHIN_DEG = 5.0
"""The study gives corners in tens of degrees."""
LEAST_IMPROVEMENT = 10.0
"""An order of magnitude, as Borenstein and Feng (1996) report."""
SIGMAS = 3.0
"""One normal number in 370 is farther off."""


def robot_verdicts(robots: Sequence[DrivenSquares], main: RobotConfig) -> list[Verdict]:
    """Of robots in squares as large as those of the study. main: the robot of the scenario."""
    verdicts = list[Verdict]()
    for tried in robots:
        if tried.side_m != SQUARE_SIDE_M:
            continue
        if tried.robot == IDENTIFIED:
            verdicts += _targets(tried)
        elif tried.robot == main.name and _is_as_believed(main):
            verdicts.append(_without_faults(tried))
    return verdicts


def _is_as_believed(robot: RobotConfig) -> bool:
    wheels = robot.drive_wheels
    scales = (wheels.radius_ratio, wheels.radius_scale, wheels.track_scale)
    return scales == (1.0, 1.0, 1.0) and robot.variation == VariationConfig()


def _targets(tried: DrivenSquares) -> list[Verdict]:
    real = SQUARES["reality"]
    off_m = abs(tried.largest_m - real.largest_error_m)
    each = ", ".join(f"{found.largest_m():.2f}" for found in tried.found)
    spreads = ", ".join(f"{found.spread_m():.2f}" for found in tried.found)
    return [
        Verdict(
            f"E_max of the identified robot is within {CLOSE_M:g} m of the real 1.06 m (Unity is "
            "0.50 m off, Gazebo 1.04 m)",
            "target",
            off_m <= CLOSE_M,
            f"{tried.largest_m:.2f} m, {off_m:.2f} m off: the mean of sets of runs that each came "
            f"to {each} m",
        ),
        Verdict(
            "Its end errors spread over 1 to 2 m, those of the real robot over 1.8 m",
            "target",
            LEAST_SPREAD_M <= tried.spread_m <= MOST_SPREAD_M,
            f"{tried.spread_m:.2f} m: the mean of {spreads} m",
        ),
        Verdict(
            "Its corners turn by about 70 degrees where 90 are commanded",
            "target",
            abs(tried.corner_deg - cast(float, real.corner_deg)) <= CORNER_WITHIN_DEG,
            f"{tried.corner_deg:.1f} degrees; odometry sees {tried.odometry_corner_deg:.1f}",
        ),
    ]


def _without_faults(tried: DrivenSquares) -> Verdict:
    most_m = SQUARES["gazebo"].largest_error_m
    return Verdict(
        f"In Gazebo odometry is off by {most_m:g} m at most; so it is here for {tried.robot}, "
        "whose wheels are as its driver believes",
        "study",
        tried.largest_m <= most_m,
        f"{tried.largest_m:.4f} m",
    )


def calibration_verdicts(known: Sequence[CorrectionResult]) -> list[Verdict]:
    """Of robots whose faults are known."""
    verdicts = []
    for one in known:
        true, found = _ratios(one.true), _ratios(one.fitted)
        sigmas = one.fitted.sigmas or (0.0, 0.0)
        within = [abs(f - t) <= SIGMAS * s for f, t, s in zip(found, true, sigmas, strict=True)]
        before_m, after_m = one.before.largest_m(), one.after.largest_m()
        verdicts += [
            Verdict(
                f"Calibration makes the systematic error at least {LEAST_IMPROVEMENT:g} times "
                "smaller on fresh runs",
                "target",
                one.improvement >= LEAST_IMPROVEMENT,
                f"E_max {before_m:.3f} m becomes {after_m:.3f} m, {one.improvement:.0f} times "
                f"smaller; chance alone leaves about {one.chance_m:.3f} m",
            ),
            Verdict(
                "Least squares finds wheel diameter ratio and track of a robot of known faults",
                "theory",
                all(within),
                f"E_d {found[0]:.4f} ± {sigmas[0]:.4f} (true {true[0]:g}), "
                f"E_b {found[1]:.4f} ± {sigmas[1]:.4f} (true {true[1]:g})",
            ),
        ]
    return verdicts


def _ratios(calibration: WheelCorrection | None) -> tuple[float, float]:
    assert calibration is not None
    return calibration.diameter_ratio, calibration.track_ratio


def friction_verdict(corners: Sequence[Row]) -> Verdict:
    """The study's corners that shrink with the friction of the tyres."""
    told = ", ".join(
        f"{number(row, 'corner_deg'):.1f} degrees at {row['friction']:g} with supports "
        f"{'dragged' if row['dragged'] else 'rolling'}"
        for row in corners
    )
    alike = [
        abs(number(row, "corner_deg") - UNITY_CORNERS_DEG[friction]) <= CORNER_WITHIN_DEG
        for row in corners
        if (friction := number(row, "friction")) in UNITY_CORNERS_DEG and not row["dragged"]
    ]
    statement = "With friction 0.6 corners turn about 30 degrees instead of 90, with 1.4 about 70"
    if not alike:
        return Verdict(statement, "study", None, told or "no corner was turned")
    return Verdict(
        statement,
        "study",
        all(alike),
        f"{told}. By Coulomb's law a tyre that is not overloaded rolls whatever its friction, and "
        "dragged supports resist in the same proportion as tyres hold: what the study saw must "
        "come from solver or motor",
    )
