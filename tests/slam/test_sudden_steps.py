"""Steps of the scans that no robot makes: which they are, and at which places they are told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from slamsim.config.back_end import BackEndConfig
from slamsim.core.geometry import between, compose, inverse, transform_points
from slamsim.core.result import Event, GraphEdge, MapGraph
from slamsim.core.types import FloatArray, PlanarPoses
from slamsim.models.wheel_gyro import PARAMETERS
from slamsim.slam.frontend.keyframes import Keyframe
from slamsim.slam.frontend.prediction import Prediction
from slamsim.slam.frontend.preintegration import OdometryStep
from slamsim.slam.frontend.sudden_steps import SUDDEN_SIGMAS, SuddenSteps
from slamsim.slam.mapping.look_alike import ambiguous_steps, unchecked_holds
from slamsim.slam.matching import Match
from slamsim.slam.matching.surfaces import PIECE_FIELDS, X, Y

SURE = 1e-6 * np.eye(3)
TICK_NS = 40_000_000


def seen(
    steps_m: Sequence[float],
    sigmas: Sequence[float],
    tick_ns: int = TICK_NS,
    turns_rad: Sequence[float] = (0.0,) * 5,
    gyro: bool = False,
) -> list[Event]:
    """What is told of scans that were matched so far, and so many sigmas, from their odometry."""
    watch, told = SuddenSteps(), []
    none, here = OdometryStep.none(np.zeros(PARAMETERS)), np.array([1.0, 2.0, 0.5])
    by = replace(none, seconds=tick_ns * 1e-9, gyro_s=tick_ns * 1e-9 * gyro)
    for number, (step_m, turn_rad, off) in enumerate(zip(steps_m, turns_rad, sigmas, strict=False)):
        at = Prediction(number * tick_ns, here, SURE, here, here, here, False, by, SURE)
        there = compose(here, np.array([0.0, step_m, turn_rad]))
        event = watch.see(at, Match(there, np.eye(3), 1.0, 1.0, np.zeros((0, 3))), off)
        told += [] if event is None else [event]
    return told


def test_a_step_that_the_next_scan_does_not_take_back_is_told_with_its_time() -> None:
    (event,) = seen([0.0, 0.0, 0.04, 0.0, 0.0], [1.0, 1.0, 12.0, 1.0, 1.0])

    assert (event.kind, event.start_ns, event.end_ns) == ("torn", TICK_NS, 2 * TICK_NS)
    assert "0.04 m" in event.words


@pytest.mark.parametrize(
    ("steps_m", "sigmas", "tick_ns"),
    [
        pytest.param([0.0, 0.04, 0.0], [1.0, 0.99 * SUDDEN_SIGMAS, 1.0], TICK_NS, id="noise"),
        pytest.param([0.0, 0.02, 0.0], [1.0, 12.0, 1.0], TICK_NS, id="a rough wall"),
        pytest.param([0.0, 0.3, 0.0], [1.0, 12.0, 1.0], 500_000_000, id="time to slide"),
        pytest.param([0.0, 0.04, 0.04, 0.04], [1.0, 12.0, 12.0, 12.0], TICK_NS, id="slipping"),
        pytest.param([0.0, 0.04], [1.0, 12.0], TICK_NS, id="the last scan"),
    ],
)
def test_what_a_robot_can_do_is_no_sudden_step(
    steps_m: list[float], sigmas: list[float], tick_ns: int
) -> None:
    assert seen(steps_m, sigmas, tick_ns) == []


@pytest.mark.parametrize(
    ("gyro", "step_m", "turn_rad", "told"),
    [
        pytest.param(True, 0.01, 0.03, True, id="no push turns a robot and not its gyroscope"),
        pytest.param(False, 0.01, 0.03, False, id="wheels alone do not feel a push"),
        pytest.param(True, 0.01, 0.015, False, id="a rough wall"),
        pytest.param(True, 0.1, 0.025, False, id="a push of which the turn is noise"),
    ],
)
def test_a_turn_that_the_gyroscope_did_not_feel_is_told_however_slow_the_scans(
    gyro: bool, step_m: float, turn_rad: float, told: bool
) -> None:
    turns_rad = [0.0, 0.0, turn_rad, 0.0, 0.0]
    events = seen(
        [0.0, 0.0, step_m, 0.0, 0.0], [1.0, 1.0, 12.0, 1.0, 1.0], 200_000_000, turns_rad, gyro
    )
    assert len(events) == told


ONE_SIDE = [(4.3, 1.0), (4.9, 1.0), (5.9, 1.0), (7.6, 1.0), (8.0, 1.0)]

STEPS = 40
CARRIED = 25


def drive(nooks_m: Sequence[tuple[float, float]]) -> tuple[list[Keyframe], MapGraph]:
    """Key frames every 0.25 m along a corridor 2 m wide and 40 m long, which see 4 m of it.

    nooks_m: (x, side) walls across it, 0.5 m from one of its sides.
    """
    along_m = np.arange(-15.0, 25.0, 0.1)
    walls = [np.column_stack([along_m, np.full(len(along_m), side)]) for side in (-1.0, 1.0)]
    across_m = np.arange(0.5, 1.0, 0.05)
    walls += [np.column_stack([np.full(len(across_m), x), side * across_m]) for x, side in nooks_m]
    walls_m = np.concatenate(walls)
    poses = np.column_stack([0.25 * np.arange(STEPS), np.zeros(STEPS), np.zeros(STEPS)])
    keyframes = [_keyframe(number, T, walls_m) for number, T in enumerate(poses)]
    stamps_ns = np.array([one.stamp_ns for one in keyframes])
    return keyframes, MapGraph(PlanarPoses(stamps_ns, poses), np.zeros((STEPS, 3, 3)), ())


def _keyframe(number: int, T_map_base: FloatArray, walls_m: FloatArray) -> Keyframe:
    near = np.hypot(*(walls_m - T_map_base[:2]).T) < 4.0
    pieces = np.zeros((np.count_nonzero(near), PIECE_FIELDS))
    pieces[:, [X, Y]] = transform_points(inverse(T_map_base), walls_m[near])
    return Keyframe(
        index=number,
        stamp_ns=number * TICK_NS,
        T_map_base=T_map_base,
        T_odom_base=T_map_base,
        information=np.eye(3),
        pieces=pieces,
        view=pieces.astype(np.float32),
        T_base_view=np.zeros(3),
        origin_m=np.zeros(2),
        beams_m=np.zeros((0, 2), dtype=np.float32),
        path_m=0.25 * number,
        restart=None,
        noise_m=0.005,
    )


def told(nooks_m: Sequence[tuple[float, float]]) -> bool:
    """Whether a sudden step in the middle of such a drive is told."""
    keyframes, graph = drive(nooks_m)
    step = Event((CARRIED - 1) * TICK_NS, CARRIED * TICK_NS, "torn", "words")
    return ambiguous_steps([step], keyframes, graph, 0, BackEndConfig()) == (step,)


def test_a_sudden_step_is_told_along_a_corridor_that_looks_the_same_everywhere() -> None:
    assert told([])


def test_a_sudden_step_is_not_told_where_the_place_looks_like_no_other() -> None:
    assert not told(ONE_SIDE)


def test_a_sudden_step_is_told_where_a_room_looks_the_same_the_other_way_round() -> None:
    assert told([*ONE_SIDE, *((12.0 - x, -side) for x, side in ONE_SIDE)])


def test_odometry_that_steps_where_places_differ_is_not_believed_where_they_are_alike() -> None:
    keyframes, graph = drive([(x + 1.5, side) for x, side in ONE_SIDE])
    early, late = (Event((k - 1) * TICK_NS, k * TICK_NS, "torn", "words") for k in (4, CARRIED))

    both = [ambiguous_steps(one, keyframes, graph, 0, BackEndConfig()) for one in ([early], [late])]
    together = ambiguous_steps([early, late], keyframes, graph, 0, BackEndConfig())

    assert both == [(early,), ()] and together == ()


LOST = Event((CARRIED - 1) * TICK_NS, CARRIED * TICK_NS, "torn", "what held the scans is gone")


def test_a_lost_hold_is_told_only_where_places_look_alike() -> None:
    for nooks_m, is_told in (([], True), (ONE_SIDE, False)):
        keyframes, graph = drive(nooks_m)
        found = unchecked_holds([LOST], keyframes, graph, 0, BackEndConfig())
        assert found == ((LOST,) if is_told else ())


@pytest.mark.parametrize(
    ("sigmas_m", "is_told"),
    [
        pytest.param((0.02, 0.02), False, id="the loop holds every direction"),
        pytest.param((5.0, 0.02), True, id="the loop slides along the corridor"),
    ],
)
def test_a_lost_hold_is_not_told_if_a_loop_agrees(
    sigmas_m: tuple[float, float], is_told: bool
) -> None:
    keyframes, graph = drive([])
    source, target = CARRIED - 5, CARRIED + 5
    step = between(graph.keyframes.poses[source], graph.keyframes.poses[target])
    covariance = np.diag(np.square([*sigmas_m, 0.01]))
    loop = GraphEdge(source, target, step, covariance, "closure")
    looped = replace(graph, edges=(loop,))

    found = unchecked_holds([LOST], keyframes, looped, 0, BackEndConfig())

    assert found == ((LOST,) if is_told else ())
