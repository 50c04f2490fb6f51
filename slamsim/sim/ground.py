"""Ground of a run: a sloping plane with friction patches and blocks; the friction under each
wheel."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from slamsim.core.types import GRAVITY_M_S2
from slamsim.guard.errors import SlamsimError
from slamsim.guard.numbers import require_number, require_sizes
from slamsim.sim.bullet import pybullet
from slamsim.sim.robot.chassis import Engine, set_foot_friction

if TYPE_CHECKING:
    from slamsim.world.model import FloorPatch


Triple = tuple[float, float, float]

STEEPEST_RAD = math.radians(89.0)
"""Upright, a floor would be a wall."""


@dataclass(frozen=True, slots=True)
class Block:
    """A cuboid on the floor. mass_kg: 0 for one that cannot be moved. position_m: of its centre.

    friction: Coulomb coefficient; it is multiplied with that of what it touches, which is 1 for
    the floor.
    """

    size_m: Triple
    mass_kg: float
    position_m: Triple
    yaw_rad: float = 0.0
    friction: float = 1.0

    def __post_init__(self) -> None:
        require_sizes("an edge of a block in m", self.size_m)
        require_number("the mass of a block in kg", self.mass_kg, 0.0)
        for value in (*self.position_m, self.yaw_rad):
            require_number("the place of a block in m or rad", value)
        require_number("a friction coefficient", self.friction, 0.0)


@dataclass(frozen=True, slots=True)
class Ground:
    """The plane z = 0 with what lies on it. slope_rad: it rises along +x.

    The plane stays level in the map frame and gravity is turned instead, so that x and y are
    measured along the slope and z at right angles to it. friction: Coulomb coefficient of the
    floor outside of the patches, multiplied with that of each wheel. under_wheels: instead, of
    the floor under the left and the right drive wheel wherever they go; not beside patches.
    hand_height_m: if given, a hand keeps that point of the robot's axis where it is along the
    slope and across it; the robot can rise and lean about it.
    """

    slope_rad: float = 0.0
    friction: float = 1.0
    patches: tuple[FloorPatch, ...] = ()
    under_wheels: tuple[float, float] | None = None
    blocks: tuple[Block, ...] = ()
    hand_height_m: float | None = None

    def __post_init__(self) -> None:
        if not abs(self.slope_rad) <= STEEPEST_RAD:
            raise SlamsimError(
                f"a slope of {math.degrees(self.slope_rad):g} degrees cannot be driven: "
                f"at most {math.degrees(STEEPEST_RAD):g} degrees are simulated"
            )
        if self.under_wheels is not None and self.patches:
            raise SlamsimError("give the floor by patches or for each wheel, not both")
        patches = (patch.friction for patch in self.patches)
        for friction in (self.friction, *(self.under_wheels or ()), *patches):
            require_number("a friction coefficient", friction, 0.0)
        if self.hand_height_m is not None:
            require_number("the height of a hand in m", self.hand_height_m)

    @property
    def gravity_m_s2(self) -> Triple:
        """In the frame whose x and y lie in the slope."""
        along, down = math.sin(self.slope_rad), math.cos(self.slope_rad)
        return -GRAVITY_M_S2 * along, 0.0, -GRAVITY_M_S2 * down


def add_blocks(client: int, blocks: Iterable[Block]) -> Iterator[int]:
    """The bodies of the blocks, in their order.

    Raises SlamsimError for one that PyBullet refuses.
    """
    for block in blocks:
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_BOX, halfExtents=[0.5 * s for s in block.size_m], physicsClientId=client
        )
        if shape < 0:
            raise SlamsimError(f"PyBullet refused a block of size {block.size_m} m")
        body = pybullet.createMultiBody(
            block.mass_kg,
            shape,
            basePosition=block.position_m,
            baseOrientation=pybullet.getQuaternionFromEuler((0.0, 0.0, block.yaw_rad)),
            physicsClientId=client,
        )
        pybullet.changeDynamics(
            body,
            -1,
            lateralFriction=block.friction,
            restitution=0.0,
            linearDamping=0.0,
            angularDamping=0.0,
            physicsClientId=client,
        )
        yield int(body)


class Floor:
    """Gives each wheel the friction of the patch that it stands on, the last one where several.

    A wheel's place is where its joint stands on the robot, which turns with the robot's heading.
    """

    def __init__(self, engine: Engine, friction: float, patches: Sequence[FloorPatch]) -> None:
        self._engine, self._floor = engine, friction
        self._patches = [
            (p.x_min_m, p.y_min_m, p.x_max_m, p.y_max_m, p.friction) for p in reversed(patches)
        ]
        self._under = [math.nan] * len(engine.feet)

    def update(self, x_m: float, y_m: float, yaw_rad: float) -> None:
        """To be called with the pose of the base; costs nothing on a floor without patches."""
        if not self._patches:
            return
        cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
        for i, foot in enumerate(self._engine.feet):
            friction = self.friction_at(
                x_m + cos * foot.x_m - sin * foot.y_m, y_m + sin * foot.x_m + cos * foot.y_m
            )
            if friction != self._under[i]:
                set_foot_friction(self._engine, foot, friction)
                self._under[i] = friction

    def friction_at(self, x_m: float, y_m: float) -> float:
        """Of the floor at a point."""
        for x_min, y_min, x_max, y_max, friction in self._patches:
            if x_min <= x_m <= x_max and y_min <= y_m <= y_max:
                return friction
        return self._floor
