"""Floor friction under each wheel, by patches."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from slamsim.sim.robot.chassis import Engine, set_foot_friction

if TYPE_CHECKING:
    from slamsim.world.model import FloorPatch


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
