"""What may be wrong with a recording, and which words of a checker would be right about it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from independent.recorded import Bag, Messages
from independent.robots import Robot
from independent.sensors import Conditions


@dataclass
class Made:
    """A recording while faults are put into it."""

    bag: Bag
    robot: Robot
    conditions: Conditions
    rng: np.random.Generator


Change = Callable[[Made], None]


@dataclass(frozen=True)
class Fault:
    """name: unique. group: of faults that differ in size or direction alone; two of one group are
    never put into one recording. right: names of which any one is right; None where no checker has
    a name for it yet: any fault that is told counts. also: names that may be told besides.

    flaws: what is declared less what is true, on top of what care leaves. robot, conditions:
    another robot, or other conditions, to be sensed anew. change: of what was recorded. fits:
    robots on which it can be. sized: whether the truth about the sizes that a checker measures
    follows from the flaws. pairs: whether it leaves another fault to be told.
    """

    name: str
    group: str
    right: frozenset[str] | None
    also: frozenset[str] = frozenset()
    flaws: Mapping[str, float] = field(default_factory=dict)
    robot: Callable[[Robot], Robot] | None = None
    conditions: Callable[[Conditions], Conditions] | None = None
    change: Change | None = None
    fits: Callable[[Robot], bool] = lambda robot: True
    sized: bool = False
    pairs: bool = False


def fault(name: str, group: str, right: str | None, also: str = "", **more: Any) -> Fault:
    """right, also: names separated by blanks."""
    names = None if right is None else frozenset(right.split())
    return Fault(name, group, names, frozenset(also.split()), **more)


def sizes(
    group: str, right: str, flaw: str, each: Iterable[tuple[str, float]], **more: Any
) -> list[Fault]:
    """One flaw in several sizes: what is put behind the group's name, and the size."""
    return [
        fault(f"{group}{words}", group, right, flaws={flaw: size}, **{"sized": True, **more})
        for words, size in each
    ]


def rolling(robot: Robot) -> bool:
    """Whether beams fire one after the other."""
    return not robot.lidar.at_once


def all_round(robot: Robot) -> bool:
    """Whether the laser sees all round."""
    return robot.lidar.fov_deg == 360.0


Of = Callable[[Bag], list[Messages]]


def of_lidar(bag: Bag) -> list[Messages]:
    return list(bag.scans)


def of_imu(bag: Bag) -> list[Messages]:
    return list(bag.imu)


def of_wheels(bag: Bag) -> list[Messages]:
    """The odometry and its transform, which are one publisher's."""
    return [*bag.odometry, *(edge for edge in bag.edges if not edge.static)]


def of_all(bag: Bag) -> list[Messages]:
    return [*of_lidar(bag), *of_imu(bag), *of_wheels(bag)]
