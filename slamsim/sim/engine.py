"""The physics engine: one PyBullet world with a robot on its floor.

PyBullet multiplies the friction coefficients of two touching bodies. The ground body therefore
has friction 1 and each wheel carries the product of its own coefficient and that of the floor
under it; it is changed when the wheel rolls onto a patch, so that a patch has no edge to bump
into and its border is exact to a control step. Walls are one static triangle mesh, for a body
per wall costs several times the time of a step.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from slamsim.config.drive import PhysicsConfig
from slamsim.geometry import matrix_from_xyzw, se3_from_parts
from slamsim.safe.errors import SlamsimError
from slamsim.sim.bullet import pybullet
from slamsim.sim.describe import urdf_text, weld_fixed_joints
from slamsim.sim.robot import LEFT_WHEEL_JOINT, RIGHT_WHEEL_JOINT, RobotModel
from slamsim.sim.validate import rolling_links
from slamsim.types import GRAVITY_M_S2, FloatArray, IntArray, TriangleMesh

if TYPE_CHECKING:
    from slamsim.world.model import World

CONTACT_REACH = 0.25
"""Share of a shape's size within which a new contact point takes the place of the last step's.
Below the distance rolled in a step, PyBullet keeps stale points behind each wheel, up to three of
them, which cost time and load the floor where the wheel no longer is."""
BODY_CONTACT_M = 0.001
"""The body's contacts further apart than this, which that reach finds, are not solved."""
FLAT_FLOOR_M = 0.005
"""Mesh triangles wholly within this height of z = 0 are floor, which is a plane of its own."""
MESH_CHUNK_TRIANGLES = 30_000
"""PyBullet hands a mesh over in a buffer of 131,072 vertices; this stays well below it."""


@dataclass(frozen=True, slots=True)
class Foot:
    """A wheel on the floor: its link index, its place on the robot, its own coefficient."""

    link: int
    x_m: float
    y_m: float
    friction: float


@dataclass(frozen=True, slots=True, eq=False)
class Engine:
    """Handles of a running PyBullet world. T_base_com: 4 x 4, the frame PyBullet reports."""

    client: int
    body: int
    walls: tuple[int, ...]
    wheels: tuple[int, int]
    feet: tuple[Foot, ...]
    T_base_com: FloatArray


Furnish = Callable[[int], Iterable[int]]
"""Puts the solids around a robot into a client's world and gives their bodies."""


@contextmanager
def running_engine(world: World, robot: RobotModel, physics: PhysicsConfig) -> Iterator[Engine]:
    """A world with the robot at its start pose, standing still; gone when the block ends."""
    walls = partial(_add_walls, mesh=world.mesh)
    with standing_robot(robot, physics, world.start_pose, world.floor_friction, walls) as engine:
        yield engine


@contextmanager
def standing_robot(
    robot: RobotModel,
    physics: PhysicsConfig,
    start_pose: FloatArray,
    floor_friction: float,
    furnish: Furnish,
    gravity_m_s2: float = GRAVITY_M_S2,
) -> Iterator[Engine]:
    """A robot that came to rest at (x, y, yaw) on a level floor; gone when the block ends."""
    client = pybullet.connect(pybullet.DIRECT)
    if client < 0:
        raise SlamsimError("PyBullet could not start a physics world")
    try:
        _set_up(client, physics)
        set_gravity(client, (0.0, 0.0, -gravity_m_s2))
        _add_ground(client)
        walls = tuple(furnish(client))
        body = _load_robot(client, robot, start_pose)
        engine = _prepare(client, body, walls, robot)
        set_floor_friction(engine, floor_friction)
        _settle(engine, physics)
        yield engine
    finally:
        pybullet.disconnect(client)


def engine_parameters(physics: PhysicsConfig) -> dict[str, float | int | str]:
    """What a result depends on, to be kept beside it."""
    with _client() as client:
        _set_up(client, physics)
        used = pybullet.getPhysicsEngineParameters(client)
    kept = (
        "fixedTimeStep",
        "numSubSteps",
        "numSolverIterations",
        "solverResidualThreshold",
        "contactBreakingThreshold",
        "erp",
        "contactERP",
        "frictionERP",
        "globalCFM",
        "enableConeFriction",
        "deterministicOverlappingPairs",
        "gravityAccelerationZ",
    )
    return {
        "engine": "PyBullet",
        "pybullet_api": int(pybullet.getAPIVersion()),
        "friction_combination": "product",
        **{key: used[key] for key in kept if key in used},
    }


@contextmanager
def _client() -> Iterator[int]:
    client = pybullet.connect(pybullet.DIRECT)
    try:
        yield client
    finally:
        pybullet.disconnect(client)


def _set_up(client: int, physics: PhysicsConfig) -> None:
    set_gravity(client, (0.0, 0.0, -GRAVITY_M_S2))
    pybullet.setPhysicsEngineParameter(
        fixedTimeStep=1.0 / physics.rate_hz,
        numSubSteps=0,
        numSolverIterations=physics.solver_iterations,
        # Ending early on a small residual lets a resting robot creep by 10 micrometres a second.
        solverResidualThreshold=0.0,
        contactBreakingThreshold=CONTACT_REACH,
        deterministicOverlappingPairs=1,
        enableFileCaching=0,
        physicsClientId=client,
    )


def set_gravity(client: int, gravity_m_s2: tuple[float, float, float]) -> None:
    """What everything falls with, in the map frame."""
    pybullet.setGravity(*gravity_m_s2, client)


def _add_static(client: int, shape: int) -> int:
    if shape < 0:
        raise SlamsimError("PyBullet refused a collision shape of this world")
    # In maximal coordinates a static body adds nothing to the equations of each contact.
    body = pybullet.createMultiBody(0.0, shape, useMaximalCoordinates=True, physicsClientId=client)
    pybullet.changeDynamics(body, -1, lateralFriction=1.0, restitution=0.0, physicsClientId=client)
    return int(body)


def _add_ground(client: int) -> int:
    shape = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=client)
    return _add_static(client, shape)


def _add_walls(client: int, mesh: TriangleMesh) -> Iterator[int]:
    """Bodies of the mesh without its flat floor, in as many pieces as the engine's buffer needs."""
    heights = mesh.vertices_m[mesh.triangles, 2]
    triangles = mesh.triangles[np.abs(heights).max(axis=1) > FLAT_FLOOR_M].astype(np.int64)
    for first in range(0, len(triangles), MESH_CHUNK_TRIANGLES):
        vertices_m, indices = _compact(mesh, triangles[first : first + MESH_CHUNK_TRIANGLES])
        corners, numbers = _lent(vertices_m), indices.tolist()
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_MESH,
            vertices=corners,
            indices=numbers,
            flags=pybullet.GEOM_FORCE_CONCAVE_TRIMESH,
            physicsClientId=client,
        )
        # PyBullet 3.2 keeps these lists for ever.
        corners.clear()
        numbers.clear()
        yield _add_static(client, shape)


_rows_lent: list[list[float]] = []


def _lent(vertices_m: FloatArray) -> list[list[float]]:
    """The vertices as lists. PyBullet 3.2 keeps what it is given for ever, so it is always given
    the same ones: a process that drives a thousand times does not grow."""
    rows = vertices_m.tolist()
    for kept, row in zip(_rows_lent, rows, strict=False):
        kept[:] = row
    _rows_lent.extend(rows[len(_rows_lent) :])
    return _rows_lent[: len(rows)]


def _compact(mesh: TriangleMesh, triangles: IntArray) -> tuple[FloatArray, IntArray]:
    used, indices = np.unique(triangles.ravel(), return_inverse=True)
    return mesh.vertices_m[used], indices.ravel()


def _load_robot(client: int, robot: RobotModel, start_pose: FloatArray) -> int:
    """The reduced robot at (x, y, yaw); PyBullet reads descriptions from files only."""
    x_m, y_m, yaw_rad = (float(value) for value in start_pose)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.urdf"
        path.write_text(urdf_text(weld_fixed_joints(robot.description)), encoding="utf-8")
        return int(
            pybullet.loadURDF(
                str(path),
                basePosition=(x_m, y_m, 0.0),
                baseOrientation=pybullet.getQuaternionFromEuler((0.0, 0.0, yaw_rad)),
                # Without these flags PyBullet makes up the inertia and turns cylinders into
                # prisms of 32 sides.
                flags=pybullet.URDF_USE_INERTIA_FROM_FILE | pybullet.URDF_USE_IMPLICIT_CYLINDER,
                physicsClientId=client,
            )
        )


def _prepare(client: int, body: int, walls: tuple[int, ...], robot: RobotModel) -> Engine:
    """Free the joints of PyBullet's own motors and the links of its damping."""
    free = {"linearDamping": 0.0, "angularDamping": 0.0, "jointDamping": 0.0, "restitution": 0.0}
    pybullet.changeDynamics(
        body,
        -1,
        lateralFriction=robot.body_friction,
        contactProcessingThreshold=BODY_CONTACT_M,
        physicsClientId=client,
        **free,
    )
    joint_index, link_index = dict[str, int](), dict[str, int]()
    for index in range(pybullet.getNumJoints(body, client)):
        info = pybullet.getJointInfo(body, index, client)
        joint_index[info[1].decode()], link_index[info[12].decode()] = index, index
        pybullet.setJointMotorControl2(
            body, index, pybullet.VELOCITY_CONTROL, force=0.0, physicsClientId=client
        )
        pybullet.changeDynamics(body, index, physicsClientId=client, **free)
    wheels = joint_index[LEFT_WHEEL_JOINT], joint_index[RIGHT_WHEEL_JOINT]
    placed = robot.description.placements()
    feet = tuple(
        Foot(
            link=link_index[name],
            x_m=float(placed[name][0, 3]),
            y_m=float(placed[name][1, 3]),
            friction=robot.wheel_friction if link_index[name] in wheels else robot.support_friction,
        )
        for name in rolling_links(robot.description)
    )
    centre_m, quat_xyzw = pybullet.getDynamicsInfo(body, -1, client)[3:5]
    T_base_com = se3_from_parts(matrix_from_xyzw(np.array(quat_xyzw)), np.array(centre_m))
    return Engine(client, body, walls, wheels, feet, T_base_com)


def set_floor_friction(engine: Engine, friction: float) -> None:
    """The floor under every wheel."""
    for foot in engine.feet:
        set_foot_friction(engine, foot, friction)


def set_foot_friction(engine: Engine, foot: Foot, friction: float) -> None:
    """The floor under one wheel."""
    pybullet.changeDynamics(
        engine.body,
        foot.link,
        lateralFriction=foot.friction * friction,
        physicsClientId=engine.client,
    )


def hold_wheels(engine: Engine, speeds_rad_s: tuple[float, float], torque_n_m: float) -> None:
    """Velocity motors on (left, right) with a largest torque."""
    pybullet.setJointMotorControlArray(
        engine.body,
        engine.wheels,
        pybullet.VELOCITY_CONTROL,
        targetVelocities=speeds_rad_s,
        forces=(torque_n_m, torque_n_m),
        physicsClientId=engine.client,
    )


def _settle(engine: Engine, physics: PhysicsConfig) -> None:
    hold_wheels(engine, (0.0, 0.0), 1.0)
    for _ in range(round(physics.settle_s * physics.rate_hz)):
        pybullet.stepSimulation(engine.client)
