"""The bench of robustness: conditions drawn, disturbances put in, and how outcomes are counted."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from simulated import Simulated, labyrinth, simulate

from slamsim.bench.robustness.campaign import (
    RobustnessCampaign,
    case_line,
    run_robustness,
    summarise,
)
from slamsim.bench.robustness.case import (
    false_kidnappings,
    judge,
    kidnappings_told,
    run_case,
    worst_piece_m,
)
from slamsim.bench.robustness.conditions import Conditions, draw_conditions, ring_drawing
from slamsim.bench.robustness.disturbances import disturbed, without_span
from slamsim.console.reporter import Reporter
from slamsim.core.geometry import compose
from slamsim.core.result import Event, EventKind, PoseGraph, SlamResult
from slamsim.core.types import BoolArray, EncoderStream, FloatArray, PlanarTrajectory, Scan
from slamsim.world.build import build_world

SECOND_NS = 1_000_000_000
CALM = Conditions(
    seed=1,
    number=1,
    world="labyrinth",
    size=(3, 3),
    cell_m=2.0,
    drive="tour",
    path_m=6.0,
    speed_m_s=0.5,
    beams=180,
    field_deg=360.0,
    range_m=12.0,
    rate_hz=5.0,
    noise_m=0.005,
    lost_share=0.0,
    step_m=0.001,
    offset_m=0.0,
    gyroscope=True,
    ticks=True,
    radius_error=0.0,
    track_error=0.0,
    curve_deg_per_m=0.0,
    people=0,
    glass_share=0.0,
    kidnapped=False,
)


@cache
def drive() -> Simulated:
    walls, tour = labyrinth(seed=2, cells=4)
    return simulate(walls, tour, seed=2, max_s=60.0)


def scans_of(conditions: Conditions) -> list[Scan]:
    return list(disturbed(drive().log, drive().truth, conditions)[0].scans)


def test_conditions_follow_from_seed_and_number_alone() -> None:
    drawn = [draw_conditions(3, number) for number in (1, 2, 3)]

    assert drawn == [draw_conditions(3, number) for number in (1, 2, 3)]
    assert len({one.own_seed for one in drawn}) == 3
    assert draw_conditions(4, 1) != drawn[0]
    assert drawn[1].repeat == "slamsim bench robustness --seed 3 --only 2"


def test_conditions_cover_what_they_should() -> None:
    drawn = [draw_conditions(1, number) for number in range(1, 201)]

    assert {one.world for one in drawn} == {"labyrinth", "rooms", "ring", "symmetric", "corridor"}
    assert min(one.beams for one in drawn) < 45 and max(one.beams for one in drawn) > 1200
    assert min(one.rate_hz for one in drawn) < 2.5 and max(one.rate_hz for one in drawn) > 30.0
    assert min(one.range_m for one in drawn) < 5.0 and max(one.range_m for one in drawn) > 50.0
    assert max(one.path_m for one in drawn) > 400.0
    assert 15 <= sum(one.kidnapped for one in drawn) <= 45
    assert 30 <= sum(one.people > 0 for one in drawn) <= 90


@pytest.mark.parametrize("number", range(1, 13))
def test_every_drawn_world_can_be_built(number: int) -> None:
    conditions = draw_conditions(1, number)
    config = conditions.config()
    assert build_world(config.world, config.seed).mesh.triangles.size
    assert config.sensors.lidar.beam_count == conditions.beams


def test_a_ring_is_a_closed_corridor() -> None:
    config = replace(CALM, world="ring", size=(5, 7)).config()
    assert ring_drawing(5, 7).count("##") == 3 * 5
    solids = build_world(config.world, 1).solids
    assert solids.section(0.2).size


def test_unequal_wheels_turn_by_the_degrees_per_metre_that_were_asked_for() -> None:
    config = replace(CALM, curve_deg_per_m=2.0).config()
    left, right = config.sensors.encoders.wheel_scale_error
    turn_rad = (right - left) * 1.0 / config.robot.drive_wheels.track_m
    assert turn_rad == pytest.approx(np.deg2rad(2.0))


def test_nothing_disturbed_leaves_the_log_as_it_was() -> None:
    log, truth, carried_ns = disturbed(drive().log, drive().truth, CALM)

    assert carried_ns == () and truth is drive().truth
    assert log.odometry is drive().log.odometry
    for before, after in zip(drive().log.scans, log.scans, strict=True):
        np.testing.assert_array_equal(before.ranges_m, after.ranges_m)


def test_people_only_stand_in_front_of_walls_and_keep_away() -> None:
    nearer, seen = 0, 0
    for before, after in zip(drive().log.scans, scans_of(replace(CALM, people=4)), strict=True):
        changed = before.ranges_m != after.ranges_m
        assert (after.ranges_m[changed] < np.nan_to_num(before.ranges_m[changed], nan=np.inf)).all()
        assert (after.ranges_m[changed] > 0.3).all()
        nearer += int(np.count_nonzero(changed))
        seen += bool(changed.any())
    assert nearer > 1000 and seen < len(drive().log.scans)


def test_glass_takes_returns_away_and_changes_no_other() -> None:
    lost = total = 0
    for before, after in zip(
        drive().log.scans, scans_of(replace(CALM, glass_share=0.2)), strict=True
    ):
        same = (before.ranges_m == after.ranges_m) | np.isinf(after.ranges_m)
        assert same.all()
        lost += int(np.count_nonzero(np.isinf(after.ranges_m) & np.isfinite(before.ranges_m)))
        total += before.ranges_m.size
    assert 0.02 < lost / total < 0.4


def test_an_offset_is_added_to_every_range() -> None:
    before, after = next(iter(drive().log.scans)), scans_of(replace(CALM, offset_m=0.04))[0]
    np.testing.assert_allclose(after.ranges_m - before.ranges_m, 0.04, atol=1e-5)


def test_a_carried_robot_has_odometry_that_knows_nothing_of_it() -> None:
    log, truth, (at_ns,) = disturbed(
        drive().log, drive().truth, replace(CALM, kidnapped=True, ticks=False)
    )

    assert log.odometry is not None
    around_ns = np.array([at_ns - 20_000_000, at_ns + 20_000_000])
    jump_m = np.hypot(*np.diff(truth.at(around_ns)[:, :2], axis=0)[0])
    felt_m = np.hypot(*np.diff(log.odometry.at(around_ns)[:, :2], axis=0)[0])
    assert jump_m > 1.9 and felt_m < 0.1
    stamps_ns = np.array([scan.stamp_ns for scan in log.scans])
    assert (np.diff(stamps_ns) > 0).all() and np.diff(stamps_ns).max() < 0.3 * SECOND_NS


def test_streams_without_a_span_close_up() -> None:
    log = drive().log
    cut = without_span(log, 10 * SECOND_NS, 20 * SECOND_NS)

    assert log.imu is not None and cut.imu is not None
    assert log.imu.stamps_ns[-1] - cut.imu.stamps_ns[-1] == 10 * SECOND_NS
    assert np.diff(cut.imu.stamps_ns).max() < 2 * np.diff(log.imu.stamps_ns).max()
    assert len(cut.scans) < len(log.scans)


def test_wheel_counters_of_a_carried_robot_go_on_where_they_were() -> None:
    stamps_ns = np.arange(0, 40) * SECOND_NS
    ticks = np.column_stack([np.arange(40) * 7, np.arange(40) * 9])
    log = replace(drive().log, encoders=EncoderStream(stamps_ns, ticks, 1000, 0.03, 0.2))

    kept = without_span(log, 10 * SECOND_NS, 20 * SECOND_NS).encoders

    assert kept is not None
    np.testing.assert_array_equal(kept.stamps_ns, np.arange(30) * SECOND_NS)
    np.testing.assert_array_equal(
        np.diff(kept.ticks, axis=0)[8:12], [[7, 9], [0, 0], [7, 9], [7, 9]]
    )
    without = replace(CALM, ticks=False)
    assert disturbed(log, drive().truth, without)[0].encoders is None


STAMPS_NS = np.arange(0, 20 * SECOND_NS, SECOND_NS // 10)


def path(bend: float = 0.0) -> PlanarTrajectory:
    seconds = STAMPS_NS * 1e-9
    poses = np.column_stack([seconds, np.sin(seconds) + bend * seconds**2, 0.1 * seconds])
    return PlanarTrajectory(STAMPS_NS, poses)


def torn_at(second: float) -> PlanarTrajectory:
    """Right in itself before and after an instant, and metres off between them."""
    poses = path().poses.copy()
    after = second * SECOND_NS <= STAMPS_NS
    poses[after] = compose(np.array([3.0, -1.0, 0.5]), poses[after])
    return PlanarTrajectory(STAMPS_NS, poses)


def event(kind: EventKind, start_s: float, end_s: float) -> Event:
    return Event(round(start_s * SECOND_NS), round(end_s * SECOND_NS), kind, "words")


def result(track: PlanarTrajectory, *events: Event) -> SlamResult:
    first = PlanarTrajectory(track.stamps_ns[:1], track.poses[:1])
    quality: FloatArray = np.ones(len(track))
    degenerate: BoolArray = np.zeros(len(track), dtype=np.bool_)
    graph = PoseGraph(first, np.zeros((1, 3, 3)), ())
    return SlamResult(track, track, graph, quality, degenerate, 0, 0, events=events)


def outcome(track: PlanarTrajectory, *events: Event, bound_m: float | None = None) -> str:
    return judge(result(track, *events), path(), None, lambda: bound_m).outcome


def test_a_run_near_the_truth_is_tracked_whatever_it_says() -> None:
    assert outcome(path()) == "tracked"
    assert outcome(path(), event("torn", 5.0, 6.0)) == "tracked"


def test_the_bound_excuses_an_error_that_nothing_could_avoid() -> None:
    bent = path(bend=0.01)
    ate_m = judge(result(bent), path(), None, lambda: None).ate_m
    assert ate_m > 0.05
    assert outcome(bent, bound_m=ate_m / 11.0) == "silently wrong"
    assert outcome(bent, bound_m=ate_m / 9.0) == "tracked"


def test_a_torn_map_is_told_by_an_event_where_it_is_torn_and_by_no_other() -> None:
    assert outcome(torn_at(12.0)) == "silently wrong"
    assert outcome(torn_at(12.0), event("torn", 11.5, 12.5)) == "told"
    assert outcome(torn_at(12.0), event("kidnapped", 12.0, 12.0)) == "told"
    assert outcome(torn_at(12.0), event("torn", 5.0, 6.0)) == "silently wrong"
    assert outcome(torn_at(12.0), event("slip", 11.5, 12.5)) == "silently wrong"


def test_a_run_that_ends_with_1_has_told() -> None:
    verdict = judge(result(torn_at(12.0)), path(), "closures failed", lambda: None)
    assert (verdict.outcome, verdict.why) == ("told", "closures failed")


def test_pieces_are_aligned_one_by_one() -> None:
    assert worst_piece_m(torn_at(12.0), path(), ()) > 0.5
    assert worst_piece_m(torn_at(12.0), path(), [event("torn", 11.9, 12.0)]) < 1e-9


def test_verdicts_about_a_kidnapping_are_held_against_when_it_happened() -> None:
    events = [
        event("kidnapped", 4.0, 4.5),
        event("kidnapped", 9.0, 11.0),
        event("torn", 15.0, 16.0),
    ]

    assert false_kidnappings(events, ()) == 2
    assert false_kidnappings(events, [5 * SECOND_NS]) == 1
    assert kidnappings_told(events, [5 * SECOND_NS, 13 * SECOND_NS, 19 * SECOND_NS]) == 2


def test_what_could_not_be_simulated_counts_in_no_share() -> None:
    runs: list[dict[str, object]] = [
        {"number": 1, "outcome": "tracked", "false_closures": 2},
        {"number": 2, "outcome": "silently wrong", "ate_m": 2.0, "odometry_ate_m": 1.0},
        {"number": 3, "error": "no room for the robot"},
    ]
    summary = summarise(runs)
    assert (summary["cases"], summary["not_simulated"]) == (2, 1)
    assert summary["tracked_share"] == 0.5 and summary["told_share"] == 0.0
    assert summary["silently_wrong"] == summary["worse_than_wheels"] == 1
    assert summary["false_closures"] == 2


def small(seed: int, number: int) -> Conditions:
    if number == 2:  # a world that cannot be
        return replace(CALM, seed=seed, number=number, cell_m=0.1)
    return replace(CALM, seed=seed, number=number, path_m=3.0, people=1, glass_share=0.1)


@pytest.mark.usefixtures("tried_by_one_worker")
def test_a_campaign_keeps_what_is_done_and_counts_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_robustness(RobustnessCampaign(1, (1, 2), kept=tmp_path), Reporter(as_json=True), draw=small)

    told = json.loads(capsys.readouterr().out)
    first, second = told["runs"]
    assert (told["cases"], told["not_simulated"]) == (1, 1)
    assert first["outcome"] == "tracked" and first["ate_m"] < 0.05
    assert "too narrow" in second["error"] or "cell" in second["error"]
    lines = (tmp_path / "robustness_1.jsonl").read_text().splitlines()
    assert sorted(json.loads(line)["number"] for line in lines) == [1, 2]
    assert "glass 10%" in case_line(first) and "not simulated" in case_line(second)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "number", "outcomes"),
    [
        pytest.param(1, 10, {"tracked"}, id="carried to a room that looks like others"),
        pytest.param(1, 18, {"tracked", "told"}, id="carried along a corridor without marks"),
        pytest.param(431, 50, {"tracked", "told"}, id="carried along a ring"),
        pytest.param(2029, 17, {"tracked", "told"}, id="carried from the end of a corridor"),
    ],
)
def test_a_robot_that_was_carried_is_never_silently_wrong(
    seed: int, number: int, outcomes: set[str]
) -> None:
    figures = run_case(draw_conditions(seed, number))
    assert figures["kidnappings"] == 1 and figures["outcome"] in outcomes
    assert outcomes != {"tracked"} or figures["false_closures"] == 0
