"""Physics and sensors, given numbers that are none: refused at the door, or simulated as asked.

Each table names what is called and what it is given; ``refused`` ends in one clear sentence,
``right`` in numbers that are all finite.
"""

from __future__ import annotations

import math
from dataclasses import fields, replace
from functools import cache, partial

import numpy as np
import pytest
from fault_numbers import BAD, Case, cases, each, judge, put, refused, right, steps
from sensing_example import PERFECT_LIDAR, Robot, drive_along, room

from slamsim.config.drive import PhysicsConfig
from slamsim.config.robot import RobotConfig
from slamsim.config.scenarios.bodies import SolverConfig
from slamsim.config.sensors import EncoderConfig, ImuConfig, SensorsConfig
from slamsim.core.types import Drive, FloatArray
from slamsim.sensors.base import Site
from slamsim.sensors.imu import Imu
from slamsim.sensors.lidar import Lidar
from slamsim.sensors.motion import Motion, joined
from slamsim.sensors.rig import Encoders, SensorRig
from slamsim.sensors.scene import Scene
from slamsim.sim.bodies import BodySurroundings, Box, Shape, Sphere, free_bodies
from slamsim.sim.drive.script import Command, scripted_run
from slamsim.sim.ground import Block, Ground
from slamsim.sim.robot.inertia import Inertial, box_inertia, cylinder_inertia, join, sphere_inertia
from slamsim.sim.robot.model import RobotModel, build_robot
from slamsim.world.model import FloorPatch

pytestmark = pytest.mark.fault

PHYSICS = PhysicsConfig(rate_hz=60, settle_s=0.1, solver_iterations=5)
FLAT = Ground()


@cache
def _robot() -> RobotModel:
    return build_robot(RobotConfig())


def _played(*commands: Command, ground: Ground = FLAT, **options: object) -> object:
    run = scripted_run(_robot(), ground, commands, PHYSICS, **options)  # type: ignore[arg-type]
    return run.drive, run.blocks, run.forces


AHEAD = Command(0.2, 0.2)
BLOCK = Block((0.2, 0.2, 0.2), 1.0, (1.0, 0.0, 0.1))
PATCH = FloorPatch(-1.0, -1.0, 1.0, 1.0, 0.5)

SCRIPTS: dict[str, Case] = {
    **each("command: a speed", lambda bad: Command(1.0, bad)),
    **each("command: a yaw rate", lambda bad: Command(1.0, 0.0, bad)),
    **each("command: a duration", lambda bad: Command(bad, 0.0)),
    "command: a negative duration": refused(lambda: Command(-1.0, 0.1)),
    "script: no command": refused(_played),
    "script: commands of no time": refused(lambda: _played(Command(0.0, 0.1))),
    "script: a week of commands": refused(lambda: _played(Command(604_800.0, 0.1))),
    "script: one command": right(lambda: _played(AHEAD, forces=True)),
    "script: steps to the speed of a rocket": right(lambda: _played(Command(0.5, 1e6, -1e6))),
    **each("script: a start", lambda bad: _played(AHEAD, start_pose=(bad, 0.0, 0.0))),
    **each("script: a heading", lambda bad: _played(AHEAD, start_pose=(0.0, 0.0, bad))),
    "script: a start off the end of the floor": right(
        lambda: _played(AHEAD, start_pose=(5e4, 0.0, 0.0))
    ),
    "script: a start of two numbers": refused(lambda: _played(AHEAD, start_pose=(0.0, 0.0))),
    "script: a start that is turned a thousand times": right(
        lambda: _played(AHEAD, start_pose=(0.0, 0.0, 6283.0))
    ),
    "script: on ice": right(lambda: _played(AHEAD, ground=Ground(friction=0.0))),
    "script: on a slope that nothing stands on": right(
        lambda: _played(Command(1.0, 0.1), ground=Ground(slope_rad=1.5))
    ),
    "script: a block inside the robot": right(
        lambda: _played(AHEAD, ground=Ground(blocks=(replace(BLOCK, position_m=(0.0, 0.0, 0.1)),)))
    ),
    "script: a block as light as dust": right(
        lambda: _played(AHEAD, ground=Ground(blocks=(replace(BLOCK, mass_kg=1e-9),)))
    ),
    "script: a hand": right(lambda: _played(AHEAD, ground=Ground(hand_height_m=0.1))),
}

GROUNDS: dict[str, Case] = {
    **each("ground: a slope", lambda bad: Ground(slope_rad=bad)),
    **each("ground: friction", lambda bad: Ground(friction=bad)),
    **each("ground: friction under a wheel", lambda bad: Ground(under_wheels=(1.0, bad))),
    **each("ground: a hand's height", lambda bad: Ground(hand_height_m=bad)),
    **each("patch: a border", lambda bad: replace(PATCH, x_max_m=bad)),
    **each("patch: friction", lambda bad: Ground(patches=(replace(PATCH, friction=bad),))),
    **each("block: a size", lambda bad: replace(BLOCK, size_m=(0.1, bad, 0.1))),
    **each("block: a mass", lambda bad: replace(BLOCK, mass_kg=bad)),
    **each("block: a position", lambda bad: replace(BLOCK, position_m=(0.0, 0.0, bad))),
    **each("block: a yaw", lambda bad: replace(BLOCK, yaw_rad=bad)),
    **each("block: friction", lambda bad: replace(BLOCK, friction=bad)),
    "ground: negative friction": refused(lambda: Ground(friction=-0.1)),
    "block: no size": refused(lambda: replace(BLOCK, size_m=(0.0, 0.1, 0.1))),
    "block: a negative mass": refused(lambda: replace(BLOCK, mass_kg=-1.0)),
}

UP = np.array([[0.0, 0.0, 1.0]])
FLOOR = BodySurroundings(UP, 0.6)
BALL = Sphere(0.1)


def _fallen(
    shape: Shape = BALL,
    mass_kg: float = 1.0,
    centres_m: FloatArray = UP,
    around: BodySurroundings = FLOOR,
    step_s: float = 0.01,
) -> object:
    with free_bodies(shape, mass_kg, centres_m, around, step_s, SolverConfig()) as bodies:
        bodies.advance(50)
        state = bodies.state()
        return state, bodies.energy_j(state), bodies.load_n(), bodies.deepest_listed_m()


BODIES: dict[str, Case] = {
    "bodies: a ball": right(_fallen),
    "bodies: none": refused(lambda: _fallen(centres_m=np.zeros((0, 3)))),
    "bodies: all in one place": right(lambda: _fallen(centres_m=np.repeat(UP, 5, axis=0))),
    "bodies: no floor": right(lambda: _fallen(around=replace(FLOOR, plane_normals=UP[:0]))),
    **each("bodies: a radius", lambda bad: _fallen(Sphere(bad))),
    **each("bodies: an edge", lambda bad: _fallen(Box((0.1, bad, 0.1)))),
    **each("bodies: a mass", lambda bad: _fallen(mass_kg=bad)),
    **each("bodies: a place", lambda bad: _fallen(centres_m=put(UP, bad))),
    **each(
        "bodies: a normal", lambda bad: _fallen(around=replace(FLOOR, plane_normals=put(UP, bad)))
    ),
    **each("bodies: friction", lambda bad: _fallen(around=replace(FLOOR, friction=bad))),
    **each("bodies: restitution", lambda bad: _fallen(around=replace(FLOOR, restitution=bad))),
    **each("bodies: a time step", lambda bad: _fallen(step_s=bad)),
    "bodies: a ball of no size": refused(lambda: _fallen(Sphere(0.0))),
    "bodies: a ball turned inside out": refused(lambda: _fallen(Sphere(-0.1))),
    "bodies: a box without height": refused(lambda: _fallen(Box((0.1, 0.1, 0.0)))),
    "bodies: no mass": refused(lambda: _fallen(mass_kg=0.0)),
    "bodies: less than no mass": refused(lambda: _fallen(mass_kg=-1.0)),
    "bodies: a normal of no length": refused(
        lambda: _fallen(around=replace(FLOOR, plane_normals=np.zeros((1, 3))))
    ),
    "bodies: negative friction": refused(lambda: _fallen(around=replace(FLOOR, friction=-1.0))),
    "bodies: no time": refused(lambda: _fallen(step_s=0.0)),
    "bodies: back in time": refused(lambda: _fallen(step_s=-0.01)),
}

SOLID = Inertial(1.0, np.zeros(3), np.eye(3))

INERTIAS: dict[str, Case] = {
    **each("inertia: a box's mass", lambda bad: box_inertia(bad, (1.0, 1.0, 1.0))),
    **each("inertia: a box's edge", lambda bad: box_inertia(1.0, (1.0, bad, 1.0))),
    **each("inertia: a cylinder's radius", lambda bad: cylinder_inertia(1.0, bad, 1.0)),
    **each("inertia: a cylinder's length", lambda bad: cylinder_inertia(1.0, 1.0, bad)),
    **each("inertia: a ball's radius", lambda bad: sphere_inertia(1.0, bad)),
    **each("inertia: a mass", lambda bad: replace(SOLID, mass_kg=bad)),
    **each("inertia: a centre", lambda bad: replace(SOLID, centre_m=put(np.zeros(3), bad))),
    **each("inertia: a tensor", lambda bad: replace(SOLID, inertia_kg_m2=put(np.eye(3), bad))),
    **each("inertia: a frame", lambda bad: SOLID.seen_from(put(np.eye(4), bad, 3))),
    "inertia: a negative mass": refused(lambda: replace(SOLID, mass_kg=-1.0)),
    "inertia: nothing joined": refused(lambda: join([])),
    "inertia: one joined": right(lambda: join([SOLID])),
    "inertia: what has no mass joined": refused(lambda: join([replace(SOLID, mass_kg=0.0)] * 2)),
}

RIGHT_AHEAD = drive_along(0.4, 60.0, speed_m_s=0.2)
COARSE = PERFECT_LIDAR.model_copy(
    update={"angle_min_deg": -180.0, "angle_step_deg": 30.0, "beam_count": 12, "rate_hz": 10.0}
)
SENSORS = SensorsConfig(lidar=COARSE)


def _changed(drive: Drive, **changed: object) -> Drive:
    return Drive(**{**{f.name: getattr(drive, f.name) for f in fields(Drive)}, **changed})


def _first(count: int, stamps_ns: object = None) -> Drive:
    """So many steps of the drive, perhaps at other instants."""
    cut = {f.name: getattr(RIGHT_AHEAD, f.name)[:count] for f in fields(Drive)}
    return Drive(**(cut if stamps_ns is None else {**cut, "stamps_ns": stamps_ns}))


def _sensed(*drives: Drive, robot: Robot | None = None) -> object:
    rig = SensorRig(room(), robot or Robot(), SENSORS, seed=0)
    read = [rig.sense(drive) for drive in drives]
    return [([*one.scans], one.imu, one.encoders) for one in read]


def _imu(T_base_imu: FloatArray) -> object:
    return Imu(ImuConfig(), T_base_imu, 0, 0).sense(joined(None, RIGHT_AHEAD))


def _encoders(radius_m: float, track_m: float) -> object:
    return Encoders(EncoderConfig(), radius_m, track_m, 0, 0).sense(joined(None, RIGHT_AHEAD))


def _lidar(T_base_laser: FloatArray) -> object:
    return Lidar(COARSE, T_base_laser, Site(room(), 0, 0)).sense(joined(None, RIGHT_AHEAD))


AT_MOST_NS = 2**62

SENSING: dict[str, Case] = {
    "sensing: a drive": right(lambda: _sensed(RIGHT_AHEAD)),
    "sensing: no step": refused(lambda: _sensed(_first(0))),
    "sensing: one step": refused(lambda: _sensed(_first(1))),
    "sensing: two steps": right(lambda: _sensed(_first(2))),
    "sensing: nothing more": right(lambda: _sensed(_first(2), _first(0))),
    "sensing: the same again": refused(lambda: _sensed(RIGHT_AHEAD, RIGHT_AHEAD)),
    "sensing: two steps a century apart": refused(
        lambda: _sensed(_first(2, np.array([0, 3 * 10**18])))
    ),
    "sensing: a century between windows": refused(
        lambda: _sensed(_first(2), _first(2, np.array([3 * 10**18, 3 * 10**18 + 10**7])))
    ),
    "sensing: at the end of time": right(
        lambda: _sensed(_first(3, AT_MOST_NS - steps(3, 10**7)[::-1]))
    ),
    "sensing: at the beginning of time": right(
        lambda: _sensed(_first(3, steps(3, 10**7) - AT_MOST_NS))
    ),
    "sensing: nowhere near the walls": right(
        lambda: _sensed(_changed(RIGHT_AHEAD, positions_m=RIGHT_AHEAD.positions_m + 9e8))
    ),
    "sensing: wheels that spin as fast as can be": right(
        lambda: _sensed(_changed(RIGHT_AHEAD, wheel_angles_rad=RIGHT_AHEAD.wheel_angles_rad * 1e8))
    ),
    "motion: one step": refused(lambda: Motion(_first(1)).positions_at(steps(1))),
    "motion: before it begins": refused(lambda: Motion(RIGHT_AHEAD).positions_at(steps(1) - 1)),
    "motion: after it ends": refused(lambda: Motion(RIGHT_AHEAD).positions_at(steps(1) + 10**12)),
    "motion: at no instant": right(lambda: Motion(RIGHT_AHEAD).positions_at(steps(0))),
    **each("imu: a mount", lambda bad: _imu(put(np.eye(4), bad, 3))),
    "imu: a mount of zeros": refused(lambda: _imu(np.zeros((4, 4)))),
    "imu: a mount of double size": refused(lambda: _imu(2.0 * np.eye(4))),
    **each("lidar: a mount", lambda bad: _lidar(put(np.eye(4), bad, 3))),
    "lidar: a mount of zeros": refused(lambda: _lidar(np.zeros((4, 4)))),
    "lidar: a mirrored mount": refused(lambda: _lidar(np.diag([1.0, 1.0, -1.0, 1.0]))),
    **each("encoders: a radius", lambda bad: _encoders(bad, 0.2)),
    **each("encoders: a track", lambda bad: _encoders(0.03, bad)),
    "encoders: a radius of zero": refused(lambda: _encoders(0.0, 0.2)),
    "encoders: a negative track": refused(lambda: _encoders(0.03, -0.2)),
}

RAY = np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0]], dtype=np.float32)


@cache
def _scene() -> Scene:
    return Scene(room(), 1.0)


def _cast(rays: object) -> object:
    hits = _scene().cast(rays)  # type: ignore[arg-type]
    return hits.ranges_m, hits.cos_incidence


RAYS: dict[str, Case] = {
    "rays: one": right(lambda: _cast(RAY)),
    "rays: none": right(lambda: _cast(RAY[:0])),
    "rays: a million alike": right(lambda: _cast(np.repeat(RAY, 1_000_000, axis=0))),
    **{
        f"rays: one number {place} of {what}": refused(
            partial(_cast, put(np.repeat(RAY, 3, axis=0), min(bad, 1e38), place))
        )
        for place in (0, 17)
        for what, bad in BAD.items()
    },
    "rays: no direction": refused(lambda: _cast(RAY * 0.0)),
    "rays: of five numbers": refused(lambda: _cast(RAY[:, :5].copy())),
    "rays: of doubles": refused(lambda: _cast(RAY.astype(np.float64))),
    **each("scene: a floor", lambda bad: Scene(room(), bad)),
    "scene: a negative floor": refused(lambda: Scene(room(), -1.0)),
}


@cases(SCRIPTS, GROUNDS, BODIES, INERTIAS)
def test_the_physics_never_passes_on_what_is_no_number(case: Case) -> None:
    judge(case)


@cases(SENSING, RAYS)
def test_no_sensor_reads_what_is_no_number(case: Case) -> None:
    judge(case)


def test_a_million_metres_are_seen_as_nothing_not_as_nonsense() -> None:
    assert math.isinf(float(_scene().cast(put(RAY, 1e6, 0)).ranges_m[0]))
