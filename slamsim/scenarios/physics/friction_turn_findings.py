"""What drives against a heavy box say."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slamsim.config.scenarios.friction_turn import FrictionTurnConfig
from slamsim.scenarios.base import Chart, Findings, Outcome, ResultTable, Series, Verdict
from slamsim.scenarios.rows import having, number

STUDY_CONTACT_S = 1.3
STUDY_SINCE_START_S = (0.1, 1.3, 2.0, 2.9)
STUDY_TURNED_DEG = (0.0, 0.0, 4.0, 24.0)
"""Unity: 20 degrees between side and driving direction at 0.1 s, 24 at 2.0 s; turned by 24 since
the contact at 2.9 s."""
CONTACT_TOLERANCE_S = 0.1
"""The study tells tenths of a second. That the box stands so far away is part of the set-up."""
NEAR_DEG = 10.0
"""Half of the angle at which the robot meets the box."""
TOWARDS_DEG = 5.0
"""A quarter of that angle; the blow of the first touch alone turns it by less."""

_LEAD = (
    "The robot drives against the side of a heavy box at 20°. The box holds the point that touches "
    "it while the wheels push on, and so the robot turns towards the box."
)


def turn_found(config: FrictionTurnConfig, outcomes: Sequence[Outcome]) -> Findings:
    """outcomes: every motor on every friction between body and box."""
    main = having(outcomes, body_friction=config.body_frictions[0])
    return Findings(
        lead=f"{_LEAD}{_told(main)}",
        numbers={
            f"{one.values['motor']}_turned_deg_at_2.9_s": _turned_at(one, STUDY_SINCE_START_S[-1])
            for one in main
        },
        verdicts=tuple(verdict for one in main for verdict in _verdicts(one)),
        sheets=(_sheet(outcomes),),
        charts=(_turn_chart(main), _path_chart(main)),
    )


def _told(main: Sequence[Outcome]) -> str:
    turns = ", ".join(
        f"{_turned_at(one, STUDY_SINCE_START_S[-1]):.0f}° with {one.values['motor']} motors"
        for one in main
    )
    unity_deg = STUDY_TURNED_DEG[-1]
    return f" After 2.9 s it has turned by {turns}; Unity {unity_deg:.0f}°." if turns else ""


def _turned_at(one: Outcome, since_start_s: float) -> float:
    """By then; the last known turn if the run ended before."""
    arrays = one.arrays
    return float(np.interp(since_start_s, arrays["since_start_s"], arrays["turned_deg"]))


def _verdicts(one: Outcome) -> list[Verdict]:
    row, motor = one.values, one.values["motor"]
    contact_s, turned_deg = row["contact_s"], number(row, "turned_deg")
    later_deg = [_turned_at(one, since_s) for since_s in STUDY_SINCE_START_S[2:]]
    off_deg = max(
        abs(ours - theirs) for ours, theirs in zip(later_deg, STUDY_TURNED_DEG[2:], strict=True)
    )
    return [
        Verdict(
            f"With {motor} motors the robot turns towards the box",
            "study",
            contact_s is not None and turned_deg > TOWARDS_DEG,
            f"by {turned_deg:.0f}° at the end",
        ),
        Verdict(
            f"With {motor} motors it touches the box after {STUDY_CONTACT_S:g} s and turns as in "
            f"Unity, within {NEAR_DEG:.0f}°",
            "study",
            contact_s is not None
            and abs(number(row, "contact_s") - STUDY_CONTACT_S) < CONTACT_TOLERANCE_S
            and off_deg < NEAR_DEG,
            "it never touched the box"
            if contact_s is None
            else f"contact at {contact_s:.2f} s; {later_deg[0]:.0f}° at 2.0 s (Unity 4°), "
            f"{later_deg[1]:.0f}° at 2.9 s (Unity 24°)",
        ),
    ]


def _sheet(outcomes: Sequence[Outcome]) -> ResultTable:
    rows = tuple(
        (
            str(row["motor"]),
            f"{row['body_friction']:g}",
            "never" if row["contact_s"] is None else f"{row['contact_s']:.2f}",
            *(f"{_turned_at(one, since_s):.1f}" for since_s in STUDY_SINCE_START_S[2:]),
            f"{row['turned_deg']:.1f}",
            f"{1e3 * number(row, 'box_moved_m'):.1f}",
        )
        for one in outcomes
        for row in (one.values,)
    )
    header = (
        "motors",
        "friction",
        "contact [s]",
        "turned at 2.0 s [°]",
        "at 2.9 s [°]",
        "at the end [°]",
        "box moved [mm]",
    )
    return ResultTable("Turn by friction between robot and box", header, rows)


def _turn_chart(outcomes: Sequence[Outcome]) -> Chart:
    ours = [
        Series(
            f"{one.values['motor']} motors",
            "slamsim",
            one.arrays["since_start_s"],
            one.arrays["turned_deg"],
            dashed=number_of > 0,
        )
        for number_of, one in enumerate(outcomes)
    ]
    unity = Series(
        "Unity",
        "unity",
        np.array(STUDY_SINCE_START_S),
        np.array(STUDY_TURNED_DEG),
        "line+points",
    )
    return Chart("Turn towards the box", "time [s]", "turned [°]", (*ours, unity))


def _path_chart(outcomes: Sequence[Outcome]) -> Chart:
    paths = [
        Series(f"{one.values['motor']} motors", "slamsim", *one.arrays["path_m"].T)
        for one in outcomes
    ]
    box = [Series("box", "theory", *one.arrays["corners_m"].T) for one in outcomes[:1]]
    return Chart("Path along the box", "x [m]", "y [m]", (*paths, *box), equal=True)
