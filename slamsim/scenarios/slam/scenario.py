"""The study's SLAM case: the rotation bug, the time base and the transform tree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

from slamsim.config.scenarios.slam_case import SlamCaseConfig
from slamsim.scenarios.base import (
    Chart,
    Findings,
    Outcome,
    ResultTable,
    Row,
    Scenario,
    Series,
    Trial,
    Verdict,
)
from slamsim.scenarios.slam.trial import (
    BUG,
    BYPASS,
    CLOCKS,
    NO_ODOM,
    RIGHT,
    SIMULATOR,
    VARIANTS,
    as_grid,
    slam_trial,
)
from slamsim.sim.engine import engine_parameters

_SECONDS = 12.0
_RIGHT_ATE_M, _RIGHT_SHARE = 0.05, 0.95
"""A map is right if the path is within this and so much of the walls is found and true."""
_TORN_PRECISION = 0.9
"""A map is torn if fewer of its walls than this are true."""
_NO_ERROR_M = 0.001
"""Odometry that is off by less is the truth, as Unity publishes it."""


def _trials(config: SlamCaseConfig, seed: int) -> Sequence[Trial]:
    return [
        Trial(variant.name, partial(slam_trial, config, seed, number), _SECONDS)
        for number, variant in enumerate(VARIANTS)
    ]


def _conclude(config: SlamCaseConfig, outcomes: Sequence[Outcome]) -> Findings:
    found = {str(outcome.values["variant"]): outcome for outcome in outcomes}
    rows = {name: outcome.values for name, outcome in found.items()}
    verdicts = (
        *_rotation(rows),
        *_time_base(rows, config.delay_s),
        *_trees(rows),
        *_checked(rows),
    )
    return Findings(
        summary=_summary(rows),
        numbers=_numbers(rows),
        verdicts=verdicts,
        tables=(_table(rows),),
        charts=tuple(_maps(found)),
    )


SCENARIO = Scenario[SlamCaseConfig](
    "SLAM case study", lambda config: engine_parameters(config.drive.physics), _trials, _conclude
)


Rows = Mapping[str, Row]
"""The row of each variant that ended well, by its name."""


def _rotation(rows: Rows) -> list[Verdict]:
    """What the study says of the rays' directions."""
    found = []
    if BUG in rows:
        statement = "with rays that keep their directions in the world the map tears"
        found.append(Verdict(statement, "study", _torn(rows[BUG]), _quality(rows[BUG])))
    if RIGHT in rows:
        statement = "with directions relative to the laser frame the map is right"
        found.append(Verdict(statement, "study", _is_right(rows[RIGHT]), _quality(rows[RIGHT])))
    return found


def _time_base(rows: Rows, delay_s: float) -> list[Verdict]:
    """What it says of clocks."""
    found = []
    if CLOCKS in rows:
        row = rows[CLOCKS]
        statement = "with two time bases every scan is dropped as too old"
        none = row["scans_with_transform_share"] == 0.0 and bool(row["slam_refused"])
        found.append(Verdict(statement, "study", none, f"{_usable(row)}; {row['slam_refused']}"))
    if BYPASS in rows:
        found += [_cost_of(rows, BYPASS), _measured(rows[BYPASS], delay_s)]
    return found


def _cost_of(rows: Rows, name: str) -> Verdict:
    """Whether the path suffers from what is wrong."""
    ates = [_number(rows.get(one, {}), "ate_rmse_m") for one in (RIGHT, name)]
    statement = "the bypass brings the scans back, and an unknown delay that the path pays for"
    right_m, wrong_m = ates
    if right_m is None or wrong_m is None:
        return Verdict(statement, "study", None, "a path is missing")
    numbers = f"{_usable(rows[name])}; ATE {_length(wrong_m)} instead of {_length(right_m)}"
    usable = rows[name]["scans_with_transform_share"] == 1.0
    return Verdict(statement, "study", usable and wrong_m > 10.0 * right_m, numbers)


def _measured(row: Row, delay_s: float) -> Verdict:
    statement = "slamsim check measures the delay, to within its 95 % interval"
    value, least, most = (_number(row, f"delay_{part}s") for part in ("", "least_", "most_"))
    if value is None or least is None or most is None:
        return Verdict(statement, "target", False, "no delay was found")
    numbers = f"{1e3 * value:.2f} ms, {1e3 * least:.2f} to {1e3 * most:.2f}; true {1e3 * delay_s:g}"
    return Verdict(statement, "target", least <= delay_s <= most, numbers)


def _trees(rows: Rows) -> list[Verdict]:
    """What it says of the transform tree."""
    found = []
    if NO_ODOM in rows:
        row = rows[NO_ODOM]
        statement = "without odom to base_footprint the tree has no place for any scan"
        none = row["scans_with_transform_share"] == 0.0
        found.append(Verdict(statement, "study", none, _usable(row)))
    if SIMULATOR in rows and RIGHT in rows:
        found.append(_worthless(rows[SIMULATOR], rows[RIGHT]))
    if RIGHT in rows:
        statement = "odom to base from the wheels, map to odom from SLAM: the drift is corrected"
        drift_m, left_m = (_number(rows[RIGHT], f"{p}ate_rmse_m") for p in ("odometry_", ""))
        if drift_m is not None and left_m is not None:
            numbers = f"ATE {_length(left_m)}; the wheels alone {_length(drift_m)}"
            found.append(Verdict(statement, "study", drift_m > 10.0 * left_m, numbers))
    return found


def _worthless(row: Row, right: Row) -> Verdict:
    statement = "a tree from the simulator alone leaves SLAM nothing to correct, and proves nothing"
    given_m, wheels_m = (_number(one, "odometry_ate_rmse_m") for one in (row, right))
    if given_m is None or wheels_m is None:
        return Verdict(statement, "study", None, "a path is missing")
    numbers = f"odometry off by {_length(given_m)}, that of the wheels by {_length(wheels_m)}"
    return Verdict(statement, "study", given_m < _NO_ERROR_M < wheels_m, numbers)


def _checked(rows: Rows) -> list[Verdict]:
    """What the checker makes of each recording."""
    said = {name: str(row["faults"]) for name, row in rows.items()}
    wrong = {one.name: one.expects for one in VARIANTS if one.expects and one.name in said}
    named = all(expected in said[name].split(", ") for name, expected in wrong.items())
    numbers = "; ".join(f"{name}: {said[name] or 'nothing'}" for name in wrong)
    found = [
        Verdict(
            "slamsim check names what is wrong with each recording",
            "target",
            named if wrong else None,
            numbers,
        )
    ]
    for name, statement in (
        (RIGHT, "slamsim check finds nothing wrong with the right recording"),
        (SIMULATOR, "nothing contradicts a tree from the simulator: no check can tell"),
    ):
        if name in said:
            verdict = Verdict(statement, "target", not said[name], said[name] or "nothing is wrong")
            found.append(verdict)
    return found


def _summary(rows: Rows) -> str:
    known = {name: _number(row, "ate_rmse_m") for name, row in rows.items()}
    told = [
        f"{_length(ate_m)} {words}"
        for name, words in (
            (RIGHT, "as recorded rightly"),
            (BUG, "with the rotation bug"),
            (BYPASS, "with a bypassed clock"),
        )
        if (ate_m := known.get(name)) is not None
    ]
    return f"SLAM's path is off by {', '.join(told)}." if told else "No variant gave a map."


def _numbers(rows: Rows) -> Row:
    keys = ("ate_rmse_m", "map_wall_precision", "scans_with_transform_share")
    return {
        f"{name.replace(' ', '_')}_{key}": row[key] for name, row in rows.items() for key in keys
    }


def _table(rows: Rows) -> ResultTable:
    header = (
        "recording",
        "usable scans",
        "ATE",
        "of odometry",
        "walls found",
        "walls true",
        "slamsim check says",
    )
    words = {variant.name: variant.words for variant in VARIANTS}
    body = tuple(
        (
            f"{name}: {words[name]}",
            _share(row, "scans_with_transform_share"),
            _length(_number(row, "ate_rmse_m")),
            _length(_number(row, "odometry_ate_rmse_m")),
            _share(row, "map_wall_recall"),
            _share(row, "map_wall_precision"),
            str(row["faults"]) or "nothing is wrong",
        )
        for name, row in rows.items()
    )
    note = (
        "Usable scans: what a SLAM can use that asks the transform tree where the robot "
        "was, as gmapping did in the study; ours reads odometry messages as well, so that it maps "
        "without the tree. ATE: RMSE of the path after one rigid alignment."
    )
    return ResultTable("The same drive, recorded in six ways", header, body, note)


def _maps(found: Mapping[str, Outcome]) -> list[Chart]:
    """The scans laid along the wheels' path, as a viewer of the raw streams shows them, and below
    what SLAM makes of them."""
    mapped = {name: found[name] for name in (RIGHT, BUG, BYPASS) if name in found}
    return [
        _map(f"{name}: {words}", outcome, key)
        for key, words in (("laid", "scans along the wheels' path"), ("map", "SLAM's map"))
        for name, outcome in mapped.items()
        if outcome.arrays
    ]


def _map(title: str, outcome: Outcome, key: str) -> Chart:
    path_m = outcome.arrays[f"{key}_path"]
    return Chart(
        title=title,
        x_label="x [m]",
        y_label="y [m]",
        series=(Series("path", "slamsim", path_m[:, 0], path_m[:, 1]),),
        equal=True,
        grid=as_grid(outcome.arrays, key),
    )


def _is_right(row: Row) -> bool:
    ate_m = _number(row, "ate_rmse_m")
    shares = [_number(row, f"map_wall_{part}") for part in ("recall", "precision")]
    near = ate_m is not None and ate_m < _RIGHT_ATE_M
    return near and all(share is not None and share > _RIGHT_SHARE for share in shares)


def _torn(row: Row) -> bool:
    precision = _number(row, "map_wall_precision")
    return precision is not None and precision < _TORN_PRECISION


def _quality(row: Row) -> str:
    ate_m = _length(_number(row, "ate_rmse_m"))
    found, true, twice = (
        _share(row, f"map_{part}")
        for part in ("wall_recall", "wall_precision", "doubled_wall_share")
    )
    return f"ATE {ate_m}, walls {found} found, {true} true, {twice} drawn twice"


def _usable(row: Row) -> str:
    return f"{_share(row, 'scans_with_transform_share')} of the scans have a transform"


def _number(row: Row, key: str) -> float | None:
    value = row.get(key)
    return float(value) if isinstance(value, int | float) else None


def _length(value_m: float | None) -> str:
    if value_m is None:
        return "–"
    return f"{value_m:.2f} m" if value_m >= 0.1 else f"{1e3 * value_m:.2g} mm"


def _share(row: Row, key: str) -> str:
    value = _number(row, key)
    return "–" if value is None else f"{100.0 * value:.1f} %"
