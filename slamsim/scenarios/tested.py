"""Robots that drive a script repeatedly, with run-to-run variation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from slamsim.config.bundled import find_input
from slamsim.config.loading import load_model
from slamsim.config.robot import RobotConfig, VariationConfig
from slamsim.core.randomness import random_bits

IDENTIFIED = "turtlebot2_identified"
"""Name of the robot that was fitted to the study's figures of the real one."""


@dataclass(frozen=True, slots=True)
class Tested:
    """A robot under its name in tables."""

    name: str
    config: RobotConfig

    def runs(self, wanted: int) -> int:
        """How many runs are worth driving: one of a robot that is always the same."""
        return wanted if self.config.variation != VariationConfig() else 1


def robots_under_test(robot: RobotConfig, beside: Sequence[str]) -> list[Tested]:
    """The robot, then those of these names or files, each name once."""
    found = [Tested(robot.name, robot)]
    for name in beside:
        config = load_model(RobotConfig, find_input("configs/robots", name))
        if config.name not in [tested.name for tested in found]:
            found.append(Tested(config.name, config))
    return found


def run_seed(seed: int, *names: str) -> int:
    """The seed of one run."""
    return random_bits(seed, *names) >> 1
