"""Worlds, ways, bounds, calibration and draws, given numbers that are none.

Each table names what is called and what it is given; ``refused`` ends in one clear sentence,
``right`` in numbers that are all finite.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
import shapely
from calibration_example import Robot
from drive_worlds import hall
from fault_numbers import Case, cases, each, judge, put, refused, right, steps
from test_bound import driven, sensors
from test_bound_scans import T_BASE_LASER, polygon
from test_dataset_catalogue import row, shard

from slamsim.check.calibration.joint import calibrate_inputs
from slamsim.check.motion.inputs import Inputs
from slamsim.check.motion.integrated import IntegratedMotion
from slamsim.check.questions.laser.gain import turn_gain
from slamsim.check.questions.laser.heading import heading_by_path
from slamsim.config.drive import LimitsConfig
from slamsim.core.types import FloatArray, PlanarTrajectory
from slamsim.dataset.catalogue.statistics import manifest, statistics
from slamsim.dataset.recipe.distributions import Integers, LogUniform, Normal, Uniform
from slamsim.evaluate.bound import TrajectoryBound, trajectory_bound
from slamsim.models.jackknife import jackknife
from slamsim.sim.drive.legs import speed_profile
from slamsim.sim.drive.smooth import resample, smooth_path
from slamsim.sim.drive.space import Space, connect_places, free_space
from slamsim.sim.drive.tour import closed_tour
from slamsim.world.cells import CellGrid
from slamsim.world.prism import Prism, circle
from slamsim.world.raster import Raster, rasterise
from slamsim.world.topology import ALGORITHMS

pytestmark = pytest.mark.fault

RASTER = Raster.covering((0.0, 0.0, 1.0, 1.0), 0.1)
SQUARE = polygon(np.random.default_rng(1), 4) * 0.05 + 0.5
WIDE = 9e8

RASTERS: dict[str, Case] = {
    **each("raster: a border", lambda bad: Raster.covering((0.0, 0.0, bad, 1.0), 0.1)),
    **each("raster: a cell", lambda bad: Raster.covering((0.0, 0.0, 1.0, 1.0), bad)),
    "raster: cells of no size": refused(lambda: Raster.covering((0.0, 0.0, 1.0, 1.0), 0.0)),
    "raster: cells of negative size": refused(lambda: Raster.covering((0.0, 0.0, 1.0, 1.0), -0.1)),
    "raster: borders swapped": refused(lambda: Raster.covering((1.0, 0.0, 0.0, 1.0), 0.1)),
    "raster: of no width": right(lambda: Raster.covering((1.0, 1.0, 1.0, 1.0), 0.1)),
    "raster: larger than the earth, in millimetres": refused(
        lambda: rasterise(SQUARE, Raster.covering((0.0, 0.0, WIDE, WIDE), 0.001))
    ),
    **each("outline: a corner", lambda bad: rasterise(put(SQUARE, bad), RASTER)),
    "outline: of nothing": right(lambda: rasterise(SQUARE[:0], RASTER)),
    "outline: of one segment": right(lambda: rasterise(SQUARE[:1], RASTER)),
    "outline: of points": right(lambda: rasterise(np.zeros((5, 2, 2)), RASTER)),
    "outline: as wide as can be": refused(lambda: rasterise(SQUARE * WIDE, RASTER)),
    "outline: of triples": refused(lambda: rasterise(np.zeros((5, 2, 3)), RASTER)),
}

BOX = shapely.box(0.0, 0.0, 1.0, 1.0)
HALL = hall(2.0)

WORLDS: dict[str, Case] = {
    **each("prism: its bottom", lambda bad: Prism(BOX, bad, 1.0)),
    **each("prism: its top", lambda bad: Prism(BOX, 0.0, bad)),
    **each("prism: its lean", lambda bad: Prism(BOX, 0.0, 1.0, (bad, 0.0))),
    "prism: without height": refused(lambda: Prism(BOX, 1.0, 1.0)),
    "prism: upside down": refused(lambda: Prism(BOX, 1.0, 0.0)),
    **each("prism: a corner", lambda bad: Prism(circle((bad, 0.0), 1.0), 0.0, 1.0)),
    **each("world: its start", lambda bad: replace(HALL, start_pose=put(np.zeros(3), bad))),
    **each("world: a border", lambda bad: replace(HALL, bounds_m=(0.0, 0.0, bad, 1.0))),
    **each("world: a place", lambda bad: replace(HALL, visit_points_m=put(np.zeros((2, 2)), bad))),
    **each("world: its friction", lambda bad: replace(HALL, floor_friction=bad)),
    **each("world: its clearance", lambda bad: replace(HALL, clearance_m=bad)),
    **each("world: a grid's cell", lambda bad: HALL.grid(bad, 0.2)),
    **each("world: a grid's height", lambda bad: HALL.grid(0.1, bad)),
    "world: cells of no size": refused(lambda: HALL.obstacle_grid(0.0)),
    "world: cells of dust": refused(lambda: HALL.obstacle_grid(1e-6)),
    "world: a grid above all walls": right(lambda: HALL.grid(0.1, 1e6)),
    "world: a start outside": refused(
        lambda: replace(HALL, start_pose=np.array([50.0, 0.0, 0.0])).grid(0.1, 0.2)
    ),
}

RNG = np.random.default_rng
MAZES: dict[str, Case] = {
    **{
        f"maze: {name} of one cell": right(partial(lambda grow: grow(CellGrid(1, 1), RNG(0)), grow))
        for name, grow in ALGORITHMS.items()
    },
    **{
        f"maze: {name} in a row": right(partial(lambda grow: grow(CellGrid(1, 9), RNG(0)), grow))
        for name, grow in ALGORITHMS.items()
    },
    "maze: no cell": refused(lambda: CellGrid(0, 5)),
    "maze: less than none": refused(lambda: CellGrid(5, -1)),
    "maze: half a row": refused(lambda: CellGrid(2.5, 5)),  # type: ignore[arg-type]
    "maze: more cells than memory": refused(lambda: CellGrid(10**6, 10**6)),
}

APART = np.abs(np.subtract.outer(np.arange(6.0), np.arange(6.0)))
LINE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
FREE = free_space(HALL, 0.1, 0.2)
LIMITS = LimitsConfig()


def _way(line_m: FloatArray, space: Space = FREE) -> object:
    smooth = smooth_path(line_m, space)
    return smooth, speed_profile(smooth, space, LIMITS)


def _net(places_m: FloatArray, space: Space = FREE) -> object:
    net = connect_places(space, places_m, 0.3)
    return net.lengths, closed_tour(net.lengths)


WAYS: dict[str, Case] = {
    "tour: six places": right(lambda: closed_tour(APART)),
    **each("tour: a length", lambda bad: closed_tour(put(APART, bad))),
    **each("tour: all lengths", lambda bad: closed_tour(np.full((5, 5), bad))),
    "tour: no place": refused(lambda: closed_tour(np.zeros((0, 0)))),
    "tour: one place": right(lambda: closed_tour(np.zeros((1, 1)))),
    "tour: two places": right(lambda: closed_tour(APART[:2, :2])),
    "tour: all in one place": right(lambda: closed_tour(np.zeros((9, 9)))),
    "tour: longer there than back": refused(lambda: closed_tour(np.triu(APART))),
    "tour: less than no way": refused(lambda: closed_tour(-APART)),
    "tour: not of pairs": refused(lambda: closed_tour(APART[:3])),
    "tour: as far as can be": right(lambda: closed_tour(APART * 1e8)),
    **each("line: a point", lambda bad: resample(put(LINE, bad))),
    **each("line: a spacing", lambda bad: resample(LINE, bad)),
    "line: a spacing of nothing": refused(lambda: resample(LINE, 0.0)),
    "line: no point": refused(lambda: resample(LINE[:0])),
    "line: one point": right(lambda: resample(LINE[:1])),
    "line: all in one point": right(lambda: _way(np.zeros((4, 2)))),
    "line: there and back": right(lambda: _way(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 0.0]]))),
    "line: to the end of the world": refused(lambda: resample(LINE * WIDE)),
    **each("space: its room", lambda bad: replace(FREE, room_m=put(FREE.room_m, bad))),
    **each("space: its origin", lambda bad: replace(FREE, origin_m=put(FREE.origin_m, bad))),
    **each("space: its cell", lambda bad: replace(FREE, resolution_m=bad)),
    **each("space: what a robot needs", lambda bad: replace(FREE, needed_m=bad)),
    **each("net: a place", lambda bad: _net(put(LINE, bad))),
    "net: no place": refused(lambda: _net(LINE[:0])),
    "net: one place": right(lambda: _net(LINE[:1])),
    "net: all in one place": right(lambda: _net(np.zeros((5, 2)))),
    "net: a place outside": refused(lambda: _net(LINE * WIDE)),
    "net: a robot as wide as the hall": refused(lambda: _net(LINE, replace(FREE, needed_m=9.0))),
}

OUTLINE = polygon(np.random.default_rng(4), 5) * 3.0
TRUTH, WHEELS = driven(2.0)
BOUNDED = sensors()


def _bound(
    outline_m: FloatArray = OUTLINE,
    truth: PlanarTrajectory = TRUTH,
    wheels: PlanarTrajectory = WHEELS,
    T_base_laser: FloatArray = T_BASE_LASER,
    track_m: float = 0.23,
) -> TrajectoryBound | None:
    return trajectory_bound(outline_m, truth, wheels, T_base_laser, BOUNDED, track_m)


def _jump(path: PlanarTrajectory, by_m: float) -> PlanarTrajectory:
    poses = path.poses.copy()
    poses[len(poses) // 2 :, 0] += by_m
    return PlanarTrajectory(path.stamps_ns, poses)


STANDING = PlanarTrajectory(WHEELS.stamps_ns, np.zeros_like(WHEELS.poses))

BOUNDS: dict[str, Case] = {
    "bound: a drive": right(_bound),
    **each("bound: a wall", lambda bad: _bound(put(OUTLINE, bad))),
    **each("bound: a mount", lambda bad: _bound(T_base_laser=put(T_BASE_LASER, bad, 3))),
    **each("bound: a track", lambda bad: _bound(track_m=bad)),
    "bound: a mount of zeros": refused(lambda: _bound(T_base_laser=np.zeros((4, 4)))),
    "bound: a negative track": refused(lambda: _bound(track_m=-0.2)),
    "bound: no wall": right(lambda: _bound(OUTLINE[:0])),
    "bound: one wall": right(lambda: _bound(OUTLINE[:1])),
    "bound: walls that are points": right(lambda: _bound(np.zeros((5, 2, 2)))),
    "bound: walls of one line, one on the other": right(lambda: _bound(OUTLINE[[0] * 5])),
    "bound: walls as far as can be": right(lambda: _bound(OUTLINE + 8e8)),
    "bound: walls as long as can be": right(lambda: _bound(OUTLINE * 1e7)),
    "bound: wheels that stand": right(lambda: _bound(wheels=STANDING)),
    "bound: wheels that jump to the end of the world": right(
        lambda: _bound(wheels=_jump(WHEELS, 9e8))
    ),
    "bound: a truth that jumps to the end of the world": right(
        lambda: _bound(truth=_jump(TRUTH, 9e8))
    ),
    "bound: wheels of nothing": right(
        lambda: _bound(wheels=PlanarTrajectory(steps(0), np.zeros((0, 3))))
    ),
    "bound: a truth of nothing": right(
        lambda: _bound(truth=PlanarTrajectory(steps(0), np.zeros((0, 3))))
    ),
}


@cache
def _inputs() -> Inputs:
    return Robot(seconds=12.0).inputs()


def _course() -> IntegratedMotion:
    course = _inputs().gyro
    assert course is not None
    return course


def _still(inputs: Inputs) -> Inputs:
    held = replace(inputs.steps, T_first_second=np.zeros_like(inputs.steps.T_first_second))
    return replace(inputs, steps=held)


def _fitted(inputs: Inputs) -> object:
    with np.errstate(all="ignore"):  # as every check runs
        found = calibrate_inputs(inputs)
    return found and (found.fit, found.covariance)


def _steps(**changed: object) -> object:
    return replace(_inputs().steps, **changed)  # type: ignore[arg-type]


def _held(scale: float) -> Inputs:
    """The scans tell so many times as much as they do."""
    steps_of = _inputs().steps
    return replace(_inputs(), steps=replace(steps_of, information=steps_of.information * scale))


CHECKS: dict[str, Case] = {
    **each(
        "steps: a motion",
        lambda bad: _steps(T_first_second=put(_inputs().steps.T_first_second, bad)),
    ),
    **each(
        "steps: information", lambda bad: _steps(information=put(_inputs().steps.information, bad))
    ),
    "steps: negative information": refused(
        lambda: _steps(information=-_inputs().steps.information)
    ),
    "steps: a sweep of nan": refused(lambda: _steps(sweep_s=float("nan"))),
    **each("course: a total", lambda bad: replace(_course(), totals=put(_course().totals, bad))),
    **each("course: a track", lambda bad: replace(_course(), track_m=bad)),
    "course: backwards": refused(
        lambda: replace(_course(), stamps_ns=_course().stamps_ns[::-1].copy())
    ),
    "course: standing still": refused(
        lambda: replace(_course(), stamps_ns=_course().stamps_ns * 0)
    ),
    "fit: scans that never move": right(lambda: _fitted(_still(_inputs()))),
    "fit: scans that tell next to nothing": right(lambda: _fitted(_held(1e-12))),
    "fit: scans that tell nothing": right(lambda: _fitted(_held(0.0))),
    "fit: scans that are all but certain": right(lambda: _fitted(_held(1e9))),
    "fit: a gyroscope that stands": right(
        lambda: _fitted(
            replace(_inputs(), gyro=replace(_course(), totals=np.zeros_like(_course().totals)))
        )
    ),
    "fit: a gyroscope as fast as can be": right(
        lambda: _fitted(replace(_inputs(), gyro=replace(_course(), totals=_course().totals * 1e9)))
    ),
    "gain: a gyroscope that stands": right(
        lambda: turn_gain(
            _inputs().steps, replace(_course(), totals=np.zeros_like(_course().totals)), 0, None
        )
    ),
    **each(
        "heading: a lever",
        lambda bad: heading_by_path(_inputs().steps, _course(), 0, np.array([0.0, bad])),
    ),
    "heading: scans that never move": right(
        lambda: heading_by_path(_still(_inputs()).steps, _course(), 0, np.zeros(2))
    ),
    "jackknife: blocks that tell nothing": refused(
        lambda: jackknife(np.zeros((2, 2)), np.zeros((7, 2, 2)), np.zeros((7, 2)))
    ),
    "jackknife: one block tells all": refused(
        lambda: jackknife(np.eye(2), np.eye(2)[None], np.ones((1, 2)))
    ),
}


def _told(**cells: float) -> object:
    return statistics(manifest([shard([row(0), row(1, **cells)])], {}))


DRAWS: dict[str, Case] = {
    **each("statistics: a quality", lambda bad: _told(**{"quality.path_length_m": bad})),
    **each("statistics: a draw", lambda bad: _told(**{"drawn.size": bad})),
    "statistics: one sequence": right(lambda: statistics(manifest([shard([row(0)])], {}))),
    "statistics: nothing made": right(
        lambda: statistics(manifest([shard([row(0, status="failed")])], {}))
    ),
    **each("draw: uniform", lambda bad: Uniform(uniform=(0.0, bad))),
    **each("draw: normal", lambda bad: Normal(normal=(0.0, bad))),
    **each("draw: log uniform", lambda bad: LogUniform(log_uniform=(1.0, bad))),
    "draw: all orders of magnitude": refused(lambda: LogUniform(log_uniform=(1e-320, 1e9))),
    "draw: a whole number beyond all": refused(lambda: Integers(integers=(0, 10**400))),
    "draw: one value": right(lambda: Uniform(uniform=(2.0, 2.0)).value(0.5)),
    "draw: no deviation": right(lambda: Normal(normal=(2.0, 0.0)).value(0.5)),
    "draw: swapped": refused(lambda: Uniform(uniform=(2.0, 1.0))),
}


@cases(RASTERS, WORLDS, MAZES, WAYS)
def test_no_world_is_made_and_no_way_is_found_of_what_is_no_number(case: Case) -> None:
    judge(case)


@cases(BOUNDS, CHECKS, DRAWS)
def test_nothing_is_told_of_what_is_no_number(case: Case) -> None:
    judge(case)
