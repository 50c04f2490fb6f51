"""What runs with one wheel on a slippery floor say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from slamsim.config.scenarios.robots import MuSplitConfig
from slamsim.scenarios.base import Chart, Findings, Outcome, ResultTable, Series, Verdict
from slamsim.scenarios.rows import column, having, number, trend

STUDY_LIMIT, STUDY_NOTABLE = 0.40, 0.35
STUDY_END_M = (1.96, -0.04)
"""Forward and to the left, with STUDY_LIMIT under the right wheel."""
STUDY_UNITY_TURN_DEG, STUDY_GAZEBO_TURN_DEG = 120.0, 90.0
"""Of the direction of motion where the right wheel finds no hold; Gazebo: slightly under that."""
TURN_NEAR_DEG = 15.0
"""The study tells of about 120 and of slightly under 90."""
END_TOLERANCE_M = 0.05
"""The study tells of a place near it, to the centimetre."""
STRAIGHT_DEG = 0.1
"""Over 2 m this is 3.5 mm aside, which no picture would show."""
THEORY_TOLERANCE = 0.05
"""The closed form takes loads as constant and tyres as points."""

_SUMMARY = (
    "The left wheel stands on good floor, the right one on less and less friction. While the robot "
    "gets going the slipping wheel lags, and the robot turns to its side until friction has "
    "brought both wheels to the same speed."
)


def split_found(config: MuSplitConfig, outcomes: Sequence[Outcome]) -> Findings:
    """outcomes: those on rolling supports, and those whose supports are dragged."""
    plain = having(outcomes, support_friction=None)
    dragged = [one for one in outcomes if one not in plain]
    main = having(plain, motor=config.motors[0])
    turns = {
        number(one.values, "right_friction"): number(one.values, "direction_deg") for one in main
    }
    return Findings(
        summary=f"{_SUMMARY}{_told(turns)}",
        numbers={f"direction_deg_at_{friction:g}": turn for friction, turn in turns.items()},
        verdicts=(*_study_verdicts(turns, main), *_theory_verdicts(config, turns, main)),
        tables=(_ends(plain), *([_drags(dragged)] if dragged else [])),
        charts=(_paths(main), _turns(config, plain)),
    )


def _told(turns: Mapping[float, float]) -> str:
    if not turns:
        return ""
    least, most = min(turns), max(f for f in turns if f <= STUDY_LIMIT or f == min(turns))
    return (
        f" Its direction of motion turns by {-turns[least]:.0f}° on {least:g} and by "
        f"{-turns[most]:.1f}° on {most:g}."
    )


def _study_verdicts(turns: Mapping[float, float], main: Sequence[Outcome]) -> list[Verdict]:
    slippery = {f: turn for f, turn in turns.items() if f < STUDY_LIMIT}
    grows = trend(list(slippery), [abs(turn) for turn in slippery.values()])
    notable, free = turns.get(STUDY_NOTABLE), turns.get(0.0)
    return [
        Verdict(
            f"The robot turns towards the slippery side below about {STUDY_LIMIT:g}",
            "study",
            all(turn < -STRAIGHT_DEG for turn in slippery.values()) if slippery else None,
            ", ".join(f"{f:g}: {turn:.1f}°" for f, turn in slippery.items()),
        ),
        Verdict(
            "The less friction, the more it turns",
            "study",
            None if grows is None else grows.falls(),
            "too few runs" if grows is None else str(grows),
        ),
        Verdict(
            f"The curve is still to be seen at {STUDY_NOTABLE:g}",
            "study",
            None if notable is None else notable < -STRAIGHT_DEG,
            "not run" if notable is None else f"{notable:.2f}°",
        ),
        _end_verdict(having(main, right_friction=STUDY_LIMIT)),
        *(
            Verdict(
                f"Without any friction its direction of motion turns by {words}",
                "study",
                None if free is None else abs(-free - turn_deg) <= TURN_NEAR_DEG,
                "not run" if free is None else f"{-free:.0f}°; the drag of the supports decides",
            )
            for words, turn_deg in (
                ("slightly under 90°, as in Gazebo", STUDY_GAZEBO_TURN_DEG),
                ("about 120°, as in Unity", STUDY_UNITY_TURN_DEG),
            )
        ),
    ]


def _end_verdict(runs: Sequence[Outcome]) -> Verdict:
    ahead_m, left_m = STUDY_END_M
    statement = f"At {STUDY_LIMIT:g} it ends near {ahead_m} m ahead, {-left_m} m to the right"
    if not runs:
        return Verdict(statement, "study", None, "not run")
    x_m, y_m = (number(runs[0].values, key) for key in ("end_x_m", "end_y_m"))
    off_m = float(np.hypot(x_m - ahead_m, y_m - left_m))
    told = f"{x_m:.3f} m ahead, {-y_m:.3f} m to the right: {100 * off_m:.1f} cm away"
    return Verdict(statement, "study", off_m < END_TOLERANCE_M, told)


def _theory_verdicts(
    config: MuSplitConfig, turns: Mapping[float, float], main: Sequence[Outcome]
) -> list[Verdict]:
    even = turns.get(config.left_friction)
    expected_deg = column(main, "turn_by_theory_deg")
    slips = (column(main, "right_friction") <= STUDY_LIMIT) & (expected_deg < 0.0)
    share = column(main, "direction_deg")[slips] / expected_deg[slips]
    worst = float(np.abs(share - 1.0).max()) if share.size else None
    return [
        Verdict(
            "With the same friction on both sides it drives straight",
            "theory",
            None if even is None else abs(even) < STRAIGHT_DEG,
            "not run" if even is None else f"{abs(even):.3f}° aside",
        ),
        Verdict(
            f"Up to {STUDY_LIMIT:g} it turns as a rigid body that Coulomb friction brakes, within "
            f"{100 * THEORY_TOLERANCE:.0f} %",
            "theory",
            None if worst is None else worst < THEORY_TOLERANCE,
            "nothing to compare" if worst is None else f"at most {100 * worst:.1f} % away",
        ),
    ]


def _ends(outcomes: Sequence[Outcome]) -> ResultTable:
    header = (
        "motors",
        "friction right",
        "ahead [m]",
        "to the left [m]",
        "heading [°]",
        "direction of motion [°]",
        "theory [°]",
    )
    return ResultTable("Where it ends", header, tuple(map(_end_row, outcomes)))


def _end_row(one: Outcome) -> tuple[str, ...]:
    row = one.values
    known = row["turn_by_theory_deg"] is not None
    return (
        str(row["motor"]),
        f"{row['right_friction']:g}",
        f"{row['end_x_m']:.3f}",
        f"{row['end_y_m']:.3f}",
        f"{row['yaw_deg']:.1f}",
        f"{row['direction_deg']:.1f}",
        f"{row['turn_by_theory_deg']:.1f}" if known else "",
    )


def _drags(outcomes: Sequence[Outcome]) -> ResultTable:
    rows = tuple(
        (
            f"{row['support_friction']:g}",
            f"{row['direction_deg']:.0f}",
            f"{row['end_x_m']:.2f}",
            f"{row['end_y_m']:.2f}",
        )
        for row in (one.values for one in outcomes)
    )
    return ResultTable(
        "Supports that are dragged, where the right wheel finds least hold",
        ("their friction", "direction of motion [°]", "ahead [m]", "to the left [m]"),
        rows,
        "Unity's direction turned by 120°, Gazebo's by slightly less than 90°. The supports of the "
        "study's model were dragged; their friction is not told.",
    )


def _paths(outcomes: Sequence[Outcome]) -> Chart:
    paths = [
        Series(f"{one.values['right_friction']:g}", "slamsim", *one.arrays["path_m"].T)
        for one in outcomes
    ]
    end = [np.array([value]) for value in STUDY_END_M]
    unity = Series(f"Unity, end at {STUDY_LIMIT:g}", "unity", end[0], end[1], "points")
    return Chart("Paths by friction", "ahead [m]", "to the left [m]", (*paths, unity), equal=True)


def _turns(config: MuSplitConfig, outcomes: Sequence[Outcome]) -> Chart:
    curves = [
        Series(
            f"{motor} motors",
            "slamsim",
            column(runs, "right_friction"),
            -column(runs, "direction_deg"),
            "line+points",
            dashed=motor != config.motors[0],
        )
        for motor in config.motors
        if (runs := having(outcomes, motor=motor))
    ]
    main = having(outcomes, motor=config.motors[0])
    expected_deg = -column(main, "turn_by_theory_deg")
    known = np.isfinite(expected_deg)
    theory = Series(
        "rigid body, Coulomb friction",
        "theory",
        column(main, "right_friction")[known],
        expected_deg[known],
    )
    zero = np.array([0.0])
    unity = Series("Unity", "unity", zero, np.array([STUDY_UNITY_TURN_DEG]), "points")
    gazebo = Series("Gazebo", "gazebo", zero, np.array([STUDY_GAZEBO_TURN_DEG]), "points")
    return Chart(
        "Turn towards the slippery side",
        "friction under the right wheel",
        "turn of the direction of motion [°]",
        (*curves, theory, unity, gazebo),
    )
