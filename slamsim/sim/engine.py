"""The physics engine: one PyBullet world with a robot on its floor.

Walls are one static triangle mesh, for a body per wall costs several times the time of a step.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import lru_cache, partial
from typing import TYPE_CHECKING

import numpy as np

from slamsim.config.drive import PhysicsConfig
from slamsim.core.types import GRAVITY_M_S2, FloatArray, IntArray, TriangleMesh
from slamsim.guard.errors import SlamsimError
from slamsim.guard.numbers import require_finite
from slamsim.sim.bullet import physics_client, pybullet
from slamsim.sim.robot.chassis import Engine, hold_wheels, load_robot, set_floor_friction
from slamsim.sim.robot.model import RobotModel

if TYPE_CHECKING:
    from slamsim.world.model import World

CONTACT_REACH = 0.25
"""Share of a shape's size within which a new contact point takes the place of the last step's.
Below the distance rolled in a step, PyBullet keeps stale points behind each wheel, up to three of
them, which cost time and load the floor where the wheel no longer is."""
FLAT_FLOOR_M = 0.005
"""Mesh triangles wholly within this height of z = 0 are floor, which is a plane of its own."""
MESH_CHUNK_TRIANGLES = 30_000
"""PyBullet hands a mesh over in a buffer of 131,072 vertices; this stays well below it."""


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
    """A robot that came to rest at (x, y, yaw) on a level floor; gone when the block ends.

    Raises BadNumbers for a pose that is none.
    """
    require_finite("where a robot starts", start_pose, (3,))
    with physics_client() as client:
        _set_up(client, physics)
        set_gravity(client, (0.0, 0.0, -gravity_m_s2))
        _add_ground(client)
        walls = tuple(furnish(client))
        engine = load_robot(client, walls, robot, start_pose, 1.0 / physics.rate_hz)
        set_floor_friction(engine, floor_friction)
        _settle(engine, physics)
        yield engine


def engine_parameters(physics: PhysicsConfig) -> dict[str, float | int | str]:
    """What a result depends on, to be kept beside it."""
    return dict(_engine_parameters(physics))


@lru_cache(maxsize=16)
def _engine_parameters(physics: PhysicsConfig) -> dict[str, float | int | str]:
    """Asked once: an engine takes some 30 ms to start, and every log tells of its own."""
    with physics_client() as client:
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


def _settle(engine: Engine, physics: PhysicsConfig) -> None:
    hold_wheels(engine, (0.0, 0.0), (1.0, 1.0))
    for _ in range(round(physics.settle_s * physics.rate_hz)):
        engine.step()
