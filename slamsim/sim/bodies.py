"""Free boxes and spheres among planes, at any time step and with any setting of the engine.

PyBullet multiplies the friction coefficients of two touching bodies, adds the compliances of
their contact springs and adds the dampings; each body carries its share, so that what is asked
for holds for every contact. Bodies never fall asleep, for a sleeping stack stands for ever at any
time step.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from slamsim.config.scenarios.bodies import SolverConfig
from slamsim.core.geometry import matrix_from_xyzw
from slamsim.core.types import GRAVITY_M_S2, FloatArray
from slamsim.guard.errors import SlamsimError
from slamsim.guard.numbers import (
    BadNumbers,
    require_directions,
    require_finite,
    require_number,
    require_size,
    require_sizes,
)
from slamsim.sim.bullet import physics_client, pybullet

CONTACT_BREAKING_M = 0.02
"""Contact points further apart than this are forgotten; the default of Bullet."""
FARTHEST_M = 1e5
"""What is farther away was not thrown there by anything that we simulate: it burst."""

LEAST_MASS_KG = 1e-9
LEAST_STEP_S, MOST_STEP_S = 1e-6, 1.0
"""Beyond these, numbers of the engine underflow, or a body passes through another in one step."""


class BurstApart(SlamsimError):
    """The engine's numbers exploded."""


@dataclass(frozen=True, slots=True)
class Box:
    """size_m: along its own x, y and z."""

    size_m: tuple[float, float, float]

    def __post_init__(self) -> None:
        require_sizes("an edge of a box in m", self.size_m)


@dataclass(frozen=True, slots=True)
class Sphere:
    """A ball."""

    radius_m: float

    def __post_init__(self) -> None:
        require_size("the radius of a ball in m", self.radius_m)


Shape = Box | Sphere


@dataclass(frozen=True, slots=True, eq=False)
class BodySurroundings:
    """What free bodies meet. plane_normals: (k, 3) unit, of half-spaces through the origin that
    are solid on the other side. friction, restitution: of every contact."""

    plane_normals: FloatArray
    friction: float
    restitution: float = 0.0

    def __post_init__(self) -> None:
        require_finite("the normals of planes", self.plane_normals, (None, 3))
        require_directions("the normals of planes", self.plane_normals)
        require_number("a friction coefficient", self.friction, 0.0)
        require_number("a restitution", self.restitution, 0.0, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Of n bodies in the map frame: (n, 3) centres, (n, 4) orientations, (n, 3) speeds."""

    centres_m: FloatArray
    quats_xyzw: FloatArray
    speeds_m_s: FloatArray
    turning_rad_s: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class FreeBodies:
    """n equal bodies in a running PyBullet world."""

    client: int
    shape: Shape
    mass_kg: float
    substeps: int
    bodies: tuple[int, ...]
    planes: tuple[int, ...]

    def advance(self, steps: int = 1) -> None:
        """So many time steps."""
        for _ in range(steps):
            pybullet.stepSimulation(self.client)

    def centres_m(self) -> FloatArray:
        """(n, 3) in the map frame. Raises BurstApart."""
        poses = [pybullet.getBasePositionAndOrientation(body, self.client) for body in self.bodies]
        return _credible(np.array([centre_m for centre_m, _ in poses]))

    def state(self) -> State:
        """Where all bodies are and how they move. Raises BurstApart."""
        poses = [pybullet.getBasePositionAndOrientation(body, self.client) for body in self.bodies]
        rates = [pybullet.getBaseVelocity(body, self.client) for body in self.bodies]
        return State(
            _credible(np.array([centre_m for centre_m, _ in poses])),
            _credible(np.array([quat_xyzw for _, quat_xyzw in poses])),
            _credible(np.array([speed_m_s for speed_m_s, _ in rates])),
            _credible(np.array([turning_rad_s for _, turning_rad_s in rates])),
        )

    def energy_j(self, state: State) -> float:
        """Of all bodies together: kinetic, and potential over z = 0."""
        inertia_kg_m2 = _inertia_kg_m2(self.shape, self.mass_kg)
        rotations = matrix_from_xyzw(state.quats_xyzw)
        own_rad_s = np.einsum("nji,nj->ni", rotations, state.turning_rad_s)
        moving = self.mass_kg * (state.speeds_m_s**2).sum() + (inertia_kg_m2 * own_rad_s**2).sum()
        return float(moving / 2 + self.mass_kg * GRAVITY_M_S2 * state.centres_m[:, 2].sum())

    def load_n(self) -> float:
        """What the planes bear, along z, by the engine's own list of contacts."""
        pushed_n = sum(
            point[9] * point[7][2]
            for plane in self.planes
            for point in pybullet.getContactPoints(bodyB=plane, physicsClientId=self.client)
        )
        # The list has the last substep's impulse, spread over the whole step.
        return float(pushed_n * self.substeps)

    def deepest_listed_m(self) -> float:
        """The deepest penetration in the engine's own list of contacts, as the last step began."""
        listed = pybullet.getContactPoints(physicsClientId=self.client)
        return max((-point[8] for point in listed), default=0.0)


@contextmanager
def free_bodies(
    shape: Shape,
    mass_kg: float,
    centres_m: FloatArray,
    around: BodySurroundings,
    step_s: float,
    solver: SolverConfig,
) -> Iterator[FreeBodies]:
    """Equal bodies at rest at ``centres_m`` (n, 3), axes along those of the map.

    Raises BadNumbers for none, and for what is no mass, place or time step.
    """
    require_number("the mass of a body in kg", mass_kg, LEAST_MASS_KG)
    require_number("a time step in s", step_s, LEAST_STEP_S, MOST_STEP_S)
    require_finite("the middles of bodies", centres_m, (None, 3), FARTHEST_M)
    if not len(centres_m):
        raise BadNumbers("at least one body is needed")
    with physics_client() as client:
        _set_up(client, step_s, solver)
        planes = tuple(
            _add(client, _plane(client, normal), around, solver) for normal in around.plane_normals
        )
        outline = _outline(client, shape)
        bodies = tuple(
            _add(client, outline, around, solver, mass_kg, centre_m) for centre_m in centres_m
        )
        yield FreeBodies(client, shape, mass_kg, solver.substeps, bodies, planes)


def engine_settings(solver: SolverConfig) -> dict[str, float | int | str | bool | None]:
    """What a result depends on beside the time step, to be kept beside it."""
    return {
        "engine": "PyBullet",
        "pybullet_api": int(pybullet.getAPIVersion()),
        "coordinates": "articulated" if solver.articulated else "maximal",
        "solver_iterations": solver.iterations,
        "substeps": solver.substeps,
        "contact_erp": solver.contact_erp,
        "contact_stiffness_n_m": solver.contact_stiffness_n_m,
        "contact_damping_n_s_m": (
            None if solver.contact_stiffness_n_m is None else solver.contact_damping_n_s_m
        ),
        "damping": solver.damping,
        "solver_residual_threshold": 0.0,
        "friction_cone": True,
        "friction_combination": "product",
        "sleeping": False,
        "gravity_m_s2": -GRAVITY_M_S2,
    }


def _set_up(client: int, step_s: float, solver: SolverConfig) -> None:
    pybullet.setGravity(0.0, 0.0, -GRAVITY_M_S2, client)
    pybullet.setPhysicsEngineParameter(
        fixedTimeStep=step_s,
        numSubSteps=solver.substeps,
        numSolverIterations=solver.iterations,
        # All sweeps are made, so that their number means something.
        solverResidualThreshold=0.0,
        contactERP=solver.contact_erp,
        # One number for all worlds of a process: an earlier world may have changed it.
        contactBreakingThreshold=CONTACT_BREAKING_M,
        enableConeFriction=1,
        deterministicOverlappingPairs=1,
        physicsClientId=client,
    )


def _add(
    client: int,
    outline: int,
    around: BodySurroundings,
    solver: SolverConfig,
    mass_kg: float = 0.0,
    centre_m: Sequence[float] | FloatArray = (0.0, 0.0, 0.0),
) -> int:
    """A body, fixed if it has no mass."""
    if outline < 0:
        raise SlamsimError("PyBullet refused the shape of a body")
    body = pybullet.createMultiBody(
        mass_kg,
        outline,
        basePosition=[float(value) for value in centre_m],
        useMaximalCoordinates=not (solver.articulated and mass_kg),
        physicsClientId=client,
    )
    share = math.sqrt(around.friction), math.sqrt(around.restitution)
    springs = {}
    if solver.contact_stiffness_n_m is not None:
        springs = {
            "contactStiffness": 2.0 * solver.contact_stiffness_n_m,
            "contactDamping": solver.contact_damping_n_s_m / 2.0,
        }
    pybullet.changeDynamics(
        body,
        -1,
        lateralFriction=share[0],
        restitution=share[1],
        linearDamping=solver.damping,
        angularDamping=solver.damping,
        activationState=pybullet.ACTIVATION_STATE_DISABLE_SLEEPING,
        physicsClientId=client,
        **springs,
    )
    return int(body)


def _plane(client: int, normal: FloatArray) -> int:
    return int(
        pybullet.createCollisionShape(
            pybullet.GEOM_PLANE, planeNormal=normal.tolist(), physicsClientId=client
        )
    )


def _outline(client: int, shape: Shape) -> int:
    if isinstance(shape, Sphere):
        made = pybullet.createCollisionShape(
            pybullet.GEOM_SPHERE, radius=shape.radius_m, physicsClientId=client
        )
    else:
        made = pybullet.createCollisionShape(
            pybullet.GEOM_BOX,
            halfExtents=[side_m / 2 for side_m in shape.size_m],
            physicsClientId=client,
        )
    return int(made)


def _inertia_kg_m2(shape: Shape, mass_kg: float) -> FloatArray:
    """(3,) about the own axes, of a solid body."""
    if isinstance(shape, Sphere):
        return np.full(3, 0.4 * mass_kg * shape.radius_m**2)
    squares: FloatArray = np.square(shape.size_m)
    return np.asarray(mass_kg / 12.0 * (squares.sum() - squares))


def _credible(values: FloatArray) -> FloatArray:
    if not np.all(np.abs(values) < FARTHEST_M):  # also what is not a number
        raise BurstApart("the bodies burst apart: the engine's numbers exploded")
    return values
