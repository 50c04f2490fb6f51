"""Damaged recordings: the run goes on where it can, and says what happened and when."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import damage
import numpy as np
import pytest
from simulated import ScanList, Simulated, ate_rmse_m, labyrinth, simulate

from slamsim.bench.robustness.disturbances import without_span
from slamsim.config.slam import SlamConfig
from slamsim.core.result import EventKind, SlamResult
from slamsim.core.types import Log
from slamsim.guard.errors import SlamsimError
from slamsim.slam.session import run_slam

SPAN_S = (15.0, 20.0)
Change = Callable[[Log], Log]


@cache
def drive() -> Simulated:
    walls, tour = labyrinth(seed=2, cells=4)
    return simulate(walls, tour, seed=2, max_s=32.0)


@cache
def whole() -> Log:
    return drive().log


@cache
def wheels_only() -> Log:
    return replace(whole(), imu=None, T_base_imu=None)


def run(log: Log, calibrate_laser: bool = True) -> SlamResult:
    result = run_slam(log, SlamConfig(calibrate_laser=calibrate_laser))
    assert np.isfinite(result.trajectory.poses).all()
    assert np.isfinite(result.graph.covariances).all()
    return result


def told(result: SlamResult, kind: EventKind) -> list[tuple[float, float]]:
    """When events of a kind began and ended; each of them has a warning of its own."""
    begin_ns = damage.begin_ns(drive().log)
    found = [event for event in result.events if event.kind == kind]
    assert all(any(event.words in words for words in result.warnings) for event in found[:1])
    return [((e.start_ns - begin_ns) * 1e-9, (e.end_ns - begin_ns) * 1e-9) for e in found]


def test_an_undamaged_drive_has_nothing_to_tell() -> None:
    result = run(whole())
    assert result.events == () and result.warnings == ()


BLIND: dict[str, Change] = {
    "three beams": lambda log: damage.few_beams(log, 3, SPAN_S),
    "nothing within reach": lambda log: damage.all_beams(log, np.inf, SPAN_S),
    "not a number": lambda log: damage.all_beams(log, np.nan, SPAN_S),
    "zero": lambda log: damage.all_beams(log, 0.0, SPAN_S),
}


@pytest.mark.long
@pytest.mark.parametrize("name", ["three beams"])
def test_scans_without_returns_are_bridged_and_told_with_their_times(name: str) -> None:
    result = run(BLIND[name](whole()))
    (start_s, end_s), *more = told(result, "blind")
    assert not more
    assert abs(start_s - SPAN_S[0]) < 0.2 and abs(end_s - SPAN_S[1]) < 0.2
    assert told(result, "torn") == []
    assert ate_rmse_m(result.trajectory, drive().truth) < 0.2


@pytest.mark.parametrize("range_m", [np.inf, np.nan, 0.0])
def test_a_log_in_which_no_scan_sees_anything_is_refused_in_a_sentence(range_m: float) -> None:
    log = replace(whole(), scans=ScanList(list(whole().scans)[:40]))
    with pytest.raises(SlamsimError, match="shows a surface"):
        run(damage.all_beams(log, range_m, damage.FOREVER))


ODOMETRY: dict[str, tuple[Change, EventKind]] = {
    "jump": (lambda log: damage.odometry_jump(log, 16.0, (3.0, -2.0, 0.5)), "jump"),
    "reset": (lambda log: damage.odometry_reset(log, 16.0), "jump"),
    "frozen": (lambda log: damage.odometry_frozen(log, SPAN_S), "slip"),
    "gap": (lambda log: damage.gap(log, SPAN_S, scans=False), "gap"),
    "ends early": (lambda log: damage.gap(log, (20.0, 1e4), scans=False), "gap"),
}


@pytest.mark.long
@pytest.mark.parametrize("name", ["jump", "frozen"])
def test_scans_overrule_odometry_that_is_wrong_or_silent(name: str) -> None:
    check_odometry(name)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["reset", "gap", "ends early"])
def test_more_of_odometry_that_is_wrong_or_silent(name: str) -> None:
    check_odometry(name)


def check_odometry(name: str) -> None:
    change, kind = ODOMETRY[name]
    result = run(change(wheels_only()), calibrate_laser=False)
    spans = told(result, kind)
    assert spans and 14.5 < spans[0][0] < 21.0
    assert told(result, "torn") == []
    assert ate_rmse_m(result.trajectory, drive().truth) < 0.08


def test_a_gap_in_all_streams_is_bridged_and_told() -> None:
    result = run(damage.gap(whole(), (15.0, 21.0)))
    ((start_s, end_s),) = told(result, "gap")
    assert abs(start_s - 15.0) < 0.2 and abs(end_s - 21.0) < 0.2
    assert ate_rmse_m(result.trajectory, drive().truth) < 0.2


def test_a_carried_robot_is_noticed() -> None:
    first_ns = damage.begin_ns(whole())
    carried = without_span(wheels_only(), first_ns + 16_000_000_000, first_ns + 26_000_000_000)
    (start_s, _), *_ = told(run(carried, calibrate_laser=False), "kidnapped")
    assert abs(start_s - 16.0) < 1.0


def test_scans_of_another_place_are_no_kidnapping_where_odometry_went_on() -> None:
    """A crowd, a door: the local map is begun anew, and what comes next shows that it fits."""
    seen = damage.seen_elsewhere(wheels_only(), (16.0, 16.35), 8.0)
    result = run(seen, calibrate_laser=False)
    assert any("begun anew" in words for words in result.warnings)
    assert told(result, "kidnapped") == []
    assert ate_rmse_m(result.trajectory, drive().truth) < 0.02


@pytest.mark.long
def test_a_lidar_upside_down_is_right_where_the_transform_says_so() -> None:
    result = run(damage.mirrored(whole(), said=True))
    assert result.events == ()
    assert ate_rmse_m(result.trajectory, drive().truth) < 0.01


@pytest.mark.long
def test_a_lidar_upside_down_is_turned_over_where_nothing_says_so() -> None:
    result = run(damage.mirrored(whole(), said=False))
    assert result.events == ()
    assert result.log is not None
    assert any("mounted upside down" in words for words in result.log.warnings)
    assert ate_rmse_m(result.trajectory, drive().truth) < 0.01


@pytest.mark.long
def test_a_lidar_upside_down_is_noticed_where_it_is_not_calibrated() -> None:
    assert told(run(damage.mirrored(whole(), said=False), calibrate_laser=False), "lidar")


@pytest.mark.long
@pytest.mark.parametrize("rpy", [(0.0, np.pi / 2, 0.0), (np.pi / 2, 0.0, 0.0)])
def test_a_lidar_turned_sideways_is_refused_with_its_angle(rpy: tuple[float, float, float]) -> None:
    with pytest.raises(SlamsimError, match="90 degrees"):
        run(damage.turned_lidar(whole(), rpy))


FINE: dict[str, Change] = {
    "mounted backwards": lambda log: damage.turned_scans(log, np.pi),
    "mounted to the left": lambda log: damage.turned_scans(log, np.pi / 2),
    "changing beam count": damage.every_other_geometry,
    "short sight": lambda log: damage.each_scan(log, lambda s: damage.short_sighted(s, 5.0)),
    "narrow field": lambda log: damage.each_scan(log, lambda s: damage.narrowed(s, np.pi / 2)),
    "seventy-two beams": lambda log: damage.each_scan(log, lambda s: damage.thinned(s, 15)),
    "no gyroscope": lambda log: wheels_only(),
    "three people": lambda log: damage.walkers(log, drive().truth, 3),
    "no odometry": lambda log: replace(wheels_only(), odometry=None),
}


@pytest.mark.long
@pytest.mark.parametrize("name", ["three people"])
def test_what_is_odd_but_sound_is_mapped_without_a_word(name: str) -> None:
    check_fine(name)


@pytest.mark.slow
@pytest.mark.parametrize("name", FINE)
def test_more_of_what_is_odd_but_sound(name: str) -> None:
    check_fine(name)


def check_fine(name: str) -> None:
    result = run(FINE[name](whole()))
    assert {event.kind for event in result.events} <= {"slip"}
    assert ate_rmse_m(result.trajectory, drive().truth) < 0.03


@pytest.mark.slow
@pytest.mark.parametrize("name", BLIND)
def test_more_scans_without_returns(name: str) -> None:
    assert told(run(BLIND[name](whole())), "blind")
