"""Variants of the recording of one drive: the correct one, and the faulty ones of the study."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from slamsim.config.scenarios.slam_case import SlamCaseConfig
from slamsim.core.types import IntArray
from slamsim.recording import RawOdometry, Recording
from slamsim.recording.edits.base import is_odometry_edge
from slamsim.sensors.faults.registry import load_fault
from slamsim.simulation.driven import Driven

RIGHT, BUG, CLOCKS, BYPASS, NO_ODOM, SIMULATOR = (
    "right",
    "rotation bug",
    "two clocks",
    "clock bypassed",
    "no odom frame",
    "tree from the simulator",
)


@dataclass(frozen=True, slots=True)
class Variant:
    """One way to record the drive. expects: what the checker must call it, empty for nothing."""

    name: str
    words: str
    expects: str
    record: Callable[[Driven, SlamCaseConfig], Recording]


def _right(driven: Driven, config: SlamCaseConfig) -> Recording:
    return driven.recording()


def _rotation_bug(driven: Driven, config: SlamCaseConfig) -> Recording:
    return driven.recording([load_fault("laser_world_fixed")])


def _two_clocks(driven: Driven, config: SlamCaseConfig) -> Recording:
    """The simulator's scans count from its start, the transforms of the SLAM side from 1970."""
    return driven.recording([load_fault("epoch_mismatch").model_copy(update={"stream": "wheels"})])


def _bypassed(driven: Driven, config: SlamCaseConfig) -> Recording:
    return driven.recording([load_fault("lidar_late").with_size(config.delay_s)])


def _no_odom(driven: Driven, config: SlamCaseConfig) -> Recording:
    return driven.recording([load_fault("tf_missing_odometry")])


def _from_simulator(driven: Driven, config: SlamCaseConfig) -> Recording:
    """The simulator places the robot itself, as transform and as odometry: where it truly is."""
    recording, truth = driven.recording(), driven.truth()

    def true_poses(stamps_ns: IntArray) -> dict[str, Any]:
        way = truth.at(np.clip(stamps_ns, truth.stamps_ns[0], truth.stamps_ns[-1]))
        return {"positions_m": way.positions_m, "quats_xyzw": way.quats_xyzw}

    return replace(
        recording.changed(RawOdometry, lambda o: replace(o, **true_poses(o.stamps_ns))),
        transforms=tuple(
            replace(edge, **true_poses(edge.stamps_ns)) if is_odometry_edge(edge) else edge
            for edge in recording.transforms
        ),
    )


VARIANTS = (
    Variant(RIGHT, "one clock, odom from the wheels, rays relative to the laser", "", _right),
    Variant(BUG, "rays keep their directions in the world", "laser_world_fixed", _rotation_bug),
    Variant(
        CLOCKS,
        "scans count from the simulator's start, transforms from 1970",
        "epoch_mismatch",
        _two_clocks,
    ),
    Variant(BYPASS, "scans stamped on arrival, late", "time_offset_lidar", _bypassed),
    Variant(NO_ODOM, "no transform from odom to base", "tf_missing_link", _no_odom),
    Variant(SIMULATOR, "odom to base is the simulator's true pose", "", _from_simulator),
)
