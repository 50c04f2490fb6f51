"""What drives up slopes say."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slamsim.config.scenarios.robots import RampConfig
from slamsim.scenarios.base import Chart, Findings, Outcome, ResultTable, Series, Value, Verdict
from slamsim.scenarios.rows import column, having, number, trend

STUDY_GAZEBO_SHARE = 0.06
"""Of the way by which Gazebo's robot falls short between the flattest and the steepest slope."""
STUDY_SLIDING_DEG = 30.0
"""Unity's robot slides sideways from about there on."""
SLIDING_NEAR_DEG = 5.0
"""As far apart as the study's slopes are up to there."""
SIDEWAYS_SHARE = 0.02
"""A robot that leaves its line by less than this share of the way does not slide sideways."""
CAUGHT_SHARE = 0.1
"""A robot that comes less far than this share of the way has not climbed."""
CLEAR_SHARE = 0.08
"""Nearer than this to the limit of traction, statics does not tell who wins."""

_SUMMARY = (
    "The robot starts on the ramp and drives up. Motors that take any speed at once do not feel "
    "the slope; motors of limited stiffness come less far; and where the weight has moved to the "
    "supports, the tyres lose their hold, sideways too. Held by a hand, the wheels lift the front."
)


def ramp_found(config: RampConfig, outcomes: Sequence[Outcome]) -> Findings:
    """outcomes: drives, and runs in which the robot is held."""
    climbs, held = having(outcomes, held=False), having(outcomes, held=True)
    return Findings(
        summary=f"{_SUMMARY}{_told(config, climbs)}",
        numbers=_numbers(config, climbs),
        verdicts=(
            *_blindness(config, climbs),
            *_shortened(config, climbs),
            *_sliding(config, climbs),
            *_tipping(config, held),
            _traction(config, climbs),
        ),
        tables=(_climb_table(climbs), *([_held_table(held)] if held else [])),
        charts=(
            _curves(config, climbs, "travel_m", "Way up the slope", "travel [m]"),
            _curves(config, climbs, "sideways_m", "Motion sideways", "farthest from the line [m]"),
        ),
    )


def _told(config: RampConfig, climbs: Sequence[Outcome]) -> str:
    """In numbers, for motors that come less far and still climb."""
    ways = [
        f"{name} {number(up[0].values, 'travel_m'):.2f} m at {up[0].values['slope_deg']:g}° and "
        f"{number(up[-1].values, 'travel_m'):.2f} m at {up[-1].values['slope_deg']:g}°"
        for name in config.climbs
        if (up := _climbed(config, having(climbs, motor=name)))
    ]
    return f" Of {_way_m(config):.2f} m commanded: {'; '.join(ways)}." if ways else ""


def _way_m(config: RampConfig) -> float:
    return config.speed_m_s * config.duration_s


def _blindness(config: RampConfig, climbs: Sequence[Outcome]) -> list[Verdict]:
    name = next(iter(config.climbs))
    runs = having(climbs, motor=name)
    if len(runs) < 2:
        return []
    floor = f"on a floor of friction {config.climbs[name].floor_friction:g}"
    travel_m, sideways_m = column(runs, "travel_m"), column(runs, "sideways_m")
    lost = float(travel_m.max() - travel_m.min()) / _way_m(config)
    return [
        Verdict(
            f"{name.capitalize()} motors are as blind to the slope as Gazebo (at most 6 % of "
            "the way between 5° and 36°)",
            "study",
            lost <= STUDY_GAZEBO_SHARE,
            f"{100 * lost:.1f} %: {travel_m.max():.3f} to {travel_m.min():.3f} m, {floor}",
        ),
        Verdict(
            f"{name.capitalize()} motors: no motion sideways, as in Gazebo",
            "study",
            bool(sideways_m.max() < SIDEWAYS_SHARE * _way_m(config)),
            f"at most {100 * sideways_m.max():.0f} cm, {floor}",
        ),
    ]


def _limited(config: RampConfig, climbs: Sequence[Outcome]) -> dict[str, list[Outcome]]:
    """The runs of all motors but the first, by name."""
    return {name: having(climbs, motor=name) for name in list(config.climbs)[1:]}


def _climbed(config: RampConfig, runs: Sequence[Outcome]) -> list[Outcome]:
    least_m = CAUGHT_SHARE * _way_m(config)
    return [one for one in runs if number(one.values, "travel_m") > least_m]


def _shortened(config: RampConfig, climbs: Sequence[Outcome]) -> list[Verdict]:
    verdicts = []
    for name, runs in _limited(config, climbs).items():
        found = trend(list(column(runs, "slope_deg")), list(column(runs, "travel_m")))
        up = _climbed(config, runs)
        lost_m = number(up[0].values, "travel_m") - number(up[-1].values, "travel_m") if up else 0.0
        verdicts.append(
            Verdict(
                f"With {name} motors the robot comes less far on steeper slopes",
                "study",
                None if found is None else found.falls(),
                "too few runs"
                if found is None or not up
                else f"{found}; {100 * lost_m:.0f} cm less at {up[-1].values['slope_deg']:g}° than "
                f"at {up[0].values['slope_deg']:g}°",
            )
        )
    return verdicts


def _sliding(config: RampConfig, climbs: Sequence[Outcome]) -> list[Verdict]:
    verdicts = []
    for name, runs in _limited(config, climbs).items():
        slope_deg, aside_m = column(runs, "slope_deg"), column(runs, "sideways_m")
        slides = aside_m > SIDEWAYS_SHARE * _way_m(config)
        first = float(slope_deg[slides].min()) if slides.any() else None
        steep_enough = bool((slope_deg > STUDY_SLIDING_DEG + SLIDING_NEAR_DEG).any())
        holds = first is not None and abs(first - STUDY_SLIDING_DEG) <= SLIDING_NEAR_DEG
        verdicts.append(
            Verdict(
                f"With {name} motors the robot slides sideways from about "
                f"{STUDY_SLIDING_DEG:.0f}° on",
                "study",
                holds if steep_enough or first is not None else None,
                "it never does"
                if first is None
                else f"from {first:g}° on, by up to {100 * aside_m.max():.0f} cm",
            )
        )
    return verdicts


def _tipping(config: RampConfig, held: Sequence[Outcome]) -> list[Verdict]:
    sprung, rigid = having(held, springs=True), having(held, springs=False)
    if config.hand is None or not (sprung and rigid):
        return []
    load = f"with {config.hand.load_kg:g} kg on it"
    return [
        Verdict(
            "Held on a steep ramp, a robot on springs tips over backwards",
            "reality",
            bool(_over(sprung)),
            f"{load}: {_risen(sprung)}",
        ),
        Verdict(
            "Without springs, as the study's model is, it does not",
            "study",
            not _over(rigid),
            f"{load}: {_risen(rigid)}",
        ),
    ]


def _over(runs: Sequence[Outcome]) -> list[Outcome]:
    return having(runs, ended="tipped over")


def _risen(runs: Sequence[Outcome]) -> str:
    return ", ".join(
        f"{one.values['slope_deg']:g}°: "
        + ("over" if one in _over(runs) else f"{abs(number(one.values, 'pitch_deg')):.0f}° up")
        for one in runs
    )


def _traction(config: RampConfig, climbs: Sequence[Outcome]) -> Verdict:
    """A robot with enough grip climbs, one without does not."""
    up = {id(one) for one in _climbed(config, climbs)}
    clear = [one for one in climbs if abs(_reserve(one)) > CLEAR_SHARE]
    wrong = [one for one in clear if (_reserve(one) > 0.0) != (id(one) in up)]
    told = ", ".join(f"{one.values['motor']} at {one.values['slope_deg']:g}°" for one in wrong)
    return Verdict(
        "The robot climbs where friction times the load on its tyres exceeds its weight along "
        "the slope, and nowhere else",
        "theory",
        not wrong if clear else None,
        f"{len(clear) - len(wrong)} of {len(clear)} runs" + (f"; not {told}" if told else ""),
    )


def _reserve(one: Outcome) -> float:
    """Share by which the hold of the tyres exceeds what is needed."""
    needed_n = number(one.values, "push_needed_n")
    if needed_n == 0.0:
        return np.inf
    return number(one.values, "push_available_n") / needed_n - 1.0


def _numbers(config: RampConfig, climbs: Sequence[Outcome]) -> dict[str, Value]:
    numbers: dict[str, Value] = {}
    for name in config.climbs:
        runs = having(climbs, motor=name)
        up = _climbed(config, runs)
        numbers[f"{name}_travel_m"] = number(up[0].values, "travel_m") if up else None
        numbers[f"{name}_steepest_climbed_deg"] = (
            max(number(one.values, "slope_deg") for one in up) if up else None
        )
        numbers[f"{name}_sideways_m"] = float(column(runs, "sideways_m").max()) if runs else None
    return numbers


def _climb_table(climbs: Sequence[Outcome]) -> ResultTable:
    rows = tuple(
        (
            str(row["motor"]),
            f"{row['slope_deg']:g}",
            f"{row['travel_m']:.3f}",
            f"{1e3 * number(row, 'sideways_m'):.0f}",
            f"{row['yaw_deg']:.1f}",
            f"{row['pitch_deg']:.1f}",
            f"{row['push_needed_n']:.1f}",
            f"{row['push_available_n']:.1f}",
        )
        for row in (one.values for one in climbs)
    )
    header = (
        "motors",
        "slope [°]",
        "travel [m]",
        "sideways [mm]",
        "heading [°]",
        "pitch [°]",
        "push needed [N]",
        "hold of the tyres [N]",
    )
    note = "Pitch is against the ramp; negative where the springs let the back sink."
    return ResultTable("Drives up the slope", header, rows, note)


def _held_table(held: Sequence[Outcome]) -> ResultTable:
    rows = tuple(
        (
            "springs" if row["springs"] else "rigid",
            f"{row['slope_deg']:g}",
            f"{-number(row, 'pitch_deg'):.1f}",
            f"{row['ended']} after {row['ended_after_s']:.1f} s" if row["ended"] else "stands",
        )
        for row in (one.values for one in held)
    )
    return ResultTable("Held by a hand", ("wheels", "slope [°]", "front rises by [°]", "end"), rows)


def _curves(
    config: RampConfig, climbs: Sequence[Outcome], key: str, title: str, label: str
) -> Chart:
    curves = [
        Series(
            f"{name} motors",
            "slamsim",
            column(runs, "slope_deg"),
            column(runs, key),
            "line+points",
            dashed=name == next(iter(config.climbs)),
        )
        for name in config.climbs
        if (runs := having(climbs, motor=name))
    ]
    slopes = np.array([min(config.slopes_deg), max(config.slopes_deg)])
    way_m = _way_m(config)
    beside: list[Series] = []
    if key == "travel_m":
        short = np.array([way_m, way_m * (1.0 - STUDY_GAZEBO_SHARE)])
        beside = [
            Series("commanded", "theory", slopes, np.array([way_m, way_m]), dashed=True),
            Series("Gazebo, 6 % less", "gazebo", slopes, short),
        ]
    return Chart(title, "slope [°]", label, (*curves, *beside))
