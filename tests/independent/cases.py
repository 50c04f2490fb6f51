"""Which recordings to make: by seed clean ones, each fault, pairs of faults, mutations."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations
from pathlib import Path

import numpy as np

from independent.consumer import HARMFUL_M, harm_m, use_of
from independent.drives import random_drive
from independent.fault import Fault, Made
from independent.faults import FAULTS
from independent.harsh import HARSH
from independent.mutate import mutated
from independent.recorded import Bag
from independent.robots import LIDARS, Flaws, Robot, random_robot
from independent.rooms import random_room
from independent.sensors import Conditions, Scanner, bag_with
from independent.writer import messages_of, write, write_messages

DRIVES = len(LIDARS)
"""For each seed: one with each kind of lidar."""

MUTATION = "mutation_"
CLOCKS = ("lidar_late", "imu_late", "wheels_late")
CLEAN, CLEAN_FROM = "clean", 1_000_000
"""Drives from this number on are those of clean recordings."""


@dataclass(frozen=True)
class Case:
    """One recording. drive: number of the drive. harsh: the name of its conditions, "" for usual
    ones. faults: names. sort: clean, fault, pair or mutation."""

    sort: str
    drive: int
    harsh: str = ""
    faults: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """By which ``cases`` makes it again."""
        return f"{'+'.join(self.faults) or CLEAN}@{self.drive}"


@dataclass(frozen=True)
class Expected:
    """right: for each fault the names of which any is right, None for any at all. also: names that
    may be told besides, None for any. truth: what a checker's sizes should be, by question, in its
    units. about: the lidar, and of a mutation what was done and its harm.
    """

    right: tuple[frozenset[str] | None, ...]
    also: frozenset[str] | None
    truth: dict[str, float]
    about: str


def fault_names() -> list[str]:
    """Of all single faults, in their order."""
    return list(FAULTS)


def cases(
    seeds: Sequence[int],
    clean: int,
    pairs: int,
    wanted: Sequence[str] | None = None,
    mutations: int = 0,
) -> list[Case]:
    """For each seed every fault, so many pairs of faults and mutations; and clean drives.

    Over the seeds a fault meets all lidars. wanted: only these, by name: ``laser_yaw_1deg`` on the
    drives of all seeds, ``laser_yaw_1deg+track_2%@13`` on drive 13, ``clean@1000003``. Raises
    KeyError for an unknown fault.
    """
    if wanted is not None:
        return [case for name in wanted for case in _wanted(name, seeds)]
    found: list[Case] = []
    for seed in seeds:
        for index, name in enumerate(FAULTS):
            found.append(_case((name,), seed, index))
        rng = np.random.default_rng([seed, 2])
        found += [_case(pair, seed, index) for index, pair in enumerate(_pairs(rng, pairs))]
        for number in range(mutations):
            drive = seed * DRIVES + number % DRIVES
            found.append(Case("mutation", drive, "", (f"{MUTATION}{number}",)))
    first = CLEAN_FROM + min(seeds, default=0) * 1000
    return found + [clean_case(first + number) for number in range(clean)]


def clean_case(drive: int) -> Case:
    """Every other one under harsh conditions, each kind in turn."""
    kinds = list(HARSH)
    return Case("clean", drive, kinds[(drive // 2) % len(kinds)] if drive % 2 else "")


def _wanted(name: str, seeds: Sequence[int]) -> list[Case]:
    what, _, drive = name.partition("@")
    if what == CLEAN:
        return [clean_case(int(drive or CLEAN_FROM))]
    if what.startswith(MUTATION):
        return [Case("mutation", int(drive or 0), "", (what,))]
    faults = tuple(FAULTS[each].name for each in what.split("+"))
    if drive:
        return [Case("fault" if len(faults) == 1 else "pair", int(drive), "", faults)]
    index = list(FAULTS).index(faults[0])
    return [_case(faults, seed, index) for seed in seeds]


def _case(faults: tuple[str, ...], seed: int, index: int) -> Case:
    """On the next drive of this seed whose robot can have these faults."""
    for step in range(DRIVES):
        drive = seed * DRIVES + (index + seed + step) % DRIVES
        if all(FAULTS[name].fits(robot_of(drive)) for name in faults):
            return Case("fault" if len(faults) == 1 else "pair", drive, "", faults)
    raise ValueError(f"no robot can have {faults}")


def _pairs(rng: np.random.Generator, count: int) -> Iterator[tuple[str, str]]:
    """Random pairs of faults of different groups."""
    able = [fault for fault in FAULTS.values() if fault.pairs]
    every = [(a.name, b.name) for a, b in combinations(able, 2) if a.group != b.group]
    for chosen in rng.choice(len(every), size=min(count, len(every)), replace=False):
        yield every[int(chosen)]


def robot_of(drive: int) -> Robot:
    return random_robot(np.random.default_rng([drive, 1]), LIDARS[drive % len(LIDARS)])


@lru_cache(maxsize=2)
def conditions_of(drive: int, harsh: str, seconds: float) -> Conditions:
    """Room and path of a drive."""
    rng = np.random.default_rng([drive, 0])
    scene = random_room(rng, glass=harsh == "glass")
    usual = Conditions(scene, random_drive(scene, rng, seconds), drive)
    return HARSH[harsh](usual, rng) if harsh else usual


@lru_cache(maxsize=2)
def _true_ranges(drive: int, harsh: str, seconds: float) -> np.ndarray:
    """Of the unharmed laser: most faults leave where its rays go as it is."""
    return Scanner(robot_of(drive), conditions_of(drive, harsh, seconds)).true_ranges()


def bag_of(case: Case, seconds: float) -> tuple[Bag, Expected]:
    """The recording in memory. Raises KeyError for a fault that is not known."""
    faults = [FAULTS[name] for name in case.faults]
    robot, conditions = robot_of(case.drive), conditions_of(case.drive, case.harsh, seconds)
    usual = robot
    for fault in faults:
        robot = replace(robot, flaws=robot.flaws.plus(**fault.flaws))
        robot = robot if fault.robot is None else fault.robot(robot)
        if fault.conditions is not None:
            conditions = fault.conditions(conditions)
    scanner = Scanner(robot, conditions)
    same = (usual.lidar, usual.laser) == (robot.lidar, robot.laser) and not _knocked(robot.flaws)
    known = same and all(fault.conditions is None for fault in faults)
    true_m = _true_ranges(case.drive, case.harsh, seconds) if known else scanner.true_ranges()
    bag = bag_with(robot, conditions, scanner.declared(scanner.measured(true_m)))
    made = Made(bag, robot, conditions, np.random.default_rng([case.drive, 3]))
    for fault in faults:
        if fault.change is not None:
            fault.change(made)
    return made.bag, _expected(robot, faults)


def make(case: Case, path: Path, seconds: float) -> Expected:
    """Writes the recording as a folder at path; every fourth drive as SQLite, the others MCAP."""
    storage = "sqlite3" if case.drive % 4 == 3 else "mcap"
    if case.sort == "mutation":
        return _make_mutation(case, path, seconds, storage)
    bag, expected = bag_of(case, seconds)
    write(bag, path, storage)
    return expected


def _make_mutation(case: Case, path: Path, seconds: float, storage: str) -> Expected:
    """A harmful one must be told by whatever name; of others nothing is expected."""
    bag, expected = bag_of(replace(case, faults=()), seconds)
    before = list(enumerate(messages_of(bag)))
    number = int(case.faults[0].removeprefix(MUTATION))
    mutation = mutated(before, np.random.default_rng([case.drive, number, 4]))
    harm = harm_m(use_of(before), use_of(mutation.messages))
    write_messages([message for _, message in mutation.messages], path, storage)
    right: tuple[None, ...] = (None,) if harm > HARMFUL_M else ()
    told = f"{harm:.3f} m of harm" if np.isfinite(harm) else "breaks a consumer"
    return Expected(right, None, {}, f"{expected.about}; {mutation.words}; {told}")


def _knocked(flaws: Flaws) -> bool:
    return any((flaws.knock_x, flaws.knock_y, flaws.knock_yaw))


def _expected(robot: Robot, faults: Sequence[Fault]) -> Expected:
    also = frozenset(name for fault in faults for name in fault.also)
    truth = _truth(robot) if all(fault.sized for fault in faults) else {}
    return Expected(_right(faults), also, truth, robot.lidar.name)


def _right(faults: Sequence[Fault]) -> tuple[frozenset[str] | None, ...]:
    """Of three clocks two are late by different times: nothing recorded tells which two."""
    if sum(fault.group in CLOCKS for fault in faults) < 2:
        return tuple(fault.right for fault in faults)
    return tuple(
        fault.right | {"clocks_apart"} if fault.right and fault.group in CLOCKS else fault.right
        for fault in faults
    )


def _truth(robot: Robot) -> dict[str, float]:
    """Wheels and clocks as declared, less the truth; of the laser where it sits, less where it is
    declared to sit. Lengths in mm, times in ms, shares in %."""
    flaws, lidar = robot.flaws, robot.lidar
    late = {"lidar": flaws.lidar_late_s, "imu": flaws.imu_late_s, "wheels": flaws.wheels_late_s}
    drifting = flaws.lidar_drift or flaws.imu_drift or flaws.wheels_drift
    times = {
        f"time.offset.{one}_{other}": 1e3 * (late[other] - late[one])
        for one, other in (("lidar", "imu"), ("lidar", "wheels"), ("imu", "wheels"))
    }
    return {
        **({} if drifting else {**times, "time.drift": 0.0}),
        "wheels.radius": 100.0 * flaws.radius,
        "wheels.unequal": 100.0 * flaws.unequal,
        "wheels.track": 100.0 * flaws.track,
        # By its own clock, which is told by itself.
        "gyro.scale": 100.0 * ((1.0 + flaws.gyro_scale) * (1.0 + flaws.imu_drift) - 1.0),
        "gyro.bias": flaws.gyro_bias,
        "laser.yaw": float(np.rad2deg(-flaws.laser_yaw)),
        "laser.x": -1e3 * flaws.laser_x,
        "laser.y": -1e3 * flaws.laser_y,
        "laser.angle_step": 100.0 * flaws.angle_step,
        "ranges.offset": 1e3 * flaws.range_offset,
        **({} if lidar.at_once else {"laser.sweep": 1.0 / (1.0 + flaws.sweep)}),
    }
