"""One of every value that crosses a stage, and what each is damaged with."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from fault_numbers import BAD, EDGES_NS, Case, line, put, refused, right, steps

from slamsim.core.geometry import xyzw_from_yaw
from slamsim.core.result import Calibrated, PoseGraph, SlamResult
from slamsim.core.types import (
    Cloud,
    Drive,
    EncoderStream,
    ImuStream,
    Log,
    PlanarTrajectory,
    Scan,
    ScanGeometry,
    Trajectory,
    TriangleMesh,
)
from slamsim.slam.backend.smoothing import Chain
from slamsim.slam.matching import Match

N = 5
PATH = PlanarTrajectory(steps(N), line(N))
QUATS = xyzw_from_yaw(np.linspace(0.0, 1.0, N))
TWO, THREE = np.zeros((N, 2)), np.zeros((N, 3))
GEOMETRY = ScanGeometry(-1.0, 0.5, N, 1000, 0.1, 30.0)
TICKS = np.arange(2 * N, dtype=np.int64).reshape(N, 2)
IMU = ImuStream(steps(N), THREE, THREE)
ENCODERS = EncoderStream(steps(N), TICKS, 4096, 0.1, 0.4)
COVARIANCES = np.broadcast_to(np.eye(3), (N, 3, 3)).copy()
GRAPH = PoseGraph(PATH, COVARIANCES, ())


class NoScans:
    """A log in which nothing was seen."""

    def __len__(self) -> int:
        return 0

    def __iter__(self) -> Iterator[Scan]:
        return iter(())


VALUES: dict[str, tuple[Callable[..., object], dict[str, Any]]] = {
    "planar trajectory": (PlanarTrajectory, {"stamps_ns": steps(N), "poses": line(N)}),
    "trajectory": (
        Trajectory,
        {"stamps_ns": steps(N), "positions_m": THREE, "quats_xyzw": QUATS},
    ),
    "scan": (
        Scan,
        {"stamp_ns": 0, "ranges_m": np.ones(N, np.float32), "geometry": GEOMETRY},
    ),
    "cloud": (
        Cloud,
        {"stamp_ns": 0, "points_m": TWO, "origins_m": TWO, "hit": np.ones(N, np.bool_)},
    ),
    "IMU": (
        ImuStream,
        {
            "stamps_ns": steps(N),
            "angular_velocity_rad_s": THREE,
            "linear_acceleration_m_s2": THREE,
        },
    ),
    "encoders": (
        EncoderStream,
        {
            "stamps_ns": steps(N),
            "ticks": TICKS,
            "ticks_per_revolution": 4096,
            "wheel_radius_m": 0.1,
            "track_m": 0.4,
        },
    ),
    "mesh": (
        TriangleMesh,
        {"vertices_m": np.eye(3), "triangles": np.array([[0, 1, 2]], np.int32)},
    ),
    "drive": (
        Drive,
        {
            "stamps_ns": steps(N),
            "positions_m": THREE,
            "quats_xyzw": QUATS,
            "linear_velocity_m_s": THREE,
            "angular_velocity_rad_s": THREE,
            "wheel_angles_rad": TWO,
            "wheel_speeds_rad_s": TWO,
            "commands": TWO,
            "wall_contact": np.zeros(N, np.bool_),
        },
    ),
    "log": (
        Log,
        {
            "name": "a log",
            "epoch": "unknown",
            "scans": NoScans(),
            "odometry": None,
            "imu": None,
            "encoders": None,
            "T_base_laser": np.eye(4),
            "T_base_imu": np.eye(4),
        },
    ),
    "geometry": (
        ScanGeometry,
        {
            "angle_min_rad": -1.0,
            "angle_step_rad": 0.1,
            "beam_count": N,
            "beam_dt_ns": 1000,
            "range_min_m": 0.1,
            "range_max_m": 30.0,
        },
    ),
    "calibrated": (Calibrated, {"value": 0.1, "sigma": 0.01, "observed": True}),
    "pose graph": (PoseGraph, {"keyframes": PATH, "covariances": COVARIANCES, "edges": ()}),
    "match": (
        Match,
        {
            "T_map_base": np.zeros(3),
            "information": np.eye(3),
            "inlier_ratio": 1.0,
            "covered_ratio": 1.0,
            "degenerate_directions": np.zeros((0, 3)),
            "pull": np.zeros(3),
        },
    ),
    "chain of matches": (
        Chain,
        {
            "track": PATH,
            "information": COVARIANCES,
            "pull": THREE,
            "steps": np.zeros((N - 1, 3)),
            "noise": COVARIANCES[1:],
        },
    ),
    "result": (
        SlamResult,
        {
            "trajectory": PATH,
            "odometry": PATH,
            "graph": GRAPH,
            "match_quality": np.ones(N),
            "degenerate": np.zeros(N, np.bool_),
            "closures_accepted": 0,
            "closures_rejected": 0,
            "match_information": COVARIANCES,
        },
    ),
}
"""Every value that crosses a stage, and arguments with which it can be made."""

ANY_SIZE = ("information", "pull", "match_information")
"""Arguments that may be as large as they like."""

MEANINGFUL = ("ranges_m", "occupancy")
"""Arguments in which a number that is none has a meaning."""


COUNTS = ("observed", "closures_accepted", "closures_rejected")
"""Arguments that are told, and never reckoned with."""


IN_ORDER = (PlanarTrajectory, Drive)
"""Values whose stamps increase; those of a single sensor do in a log, see below."""


def damaged_values() -> dict[str, Case]:
    """Each number of each value not finite, each array of another shape, stamps at the edges."""
    found: dict[str, Case] = {}
    for value, (make, whole) in VALUES.items():
        found[f"{value}: as it should be"] = right(partial(make, **whole))
        for name, argument in whole.items():
            changes = _changes(name, argument)
            if name == "stamps_ns" and make in IN_ORDER:
                changes |= {"all equal": np.zeros_like(argument), "backwards": argument[::-1]}
            if value == "mesh":
                changes.pop("one row short", None)
            for what, changed in changes.items():
                arguments = {**whole, name: changed}
                found[f"{value}: {name} {what}"] = refused(partial(make, **arguments))
    return found


def _changes(name: str, argument: object) -> dict[str, object]:
    changes: dict[str, object] = {}
    if isinstance(argument, np.ndarray) and argument.size:
        changes = {"one row short": argument[1:], "a list": argument.tolist()}
        if argument.dtype.kind == "f" and name not in MEANINGFUL:
            worse = {k: v for k, v in BAD.items() if k != "huge" or name not in ANY_SIZE}
            changes |= {what: put(argument, bad) for what, bad in worse.items()}
            changes["whole numbers"] = argument.astype(np.int64)
        if name == "stamps_ns":
            changes["in seconds"] = argument * 1e-9
            changes |= {k: put(argument, edge) for k, edge in EDGES_NS.items()}
    elif isinstance(argument, float):
        changes = {**BAD, "words": "1.0"}
    elif isinstance(argument, int) and name not in COUNTS:
        changes = {"a fraction": 0.5, "nan": math.nan, **EDGES_NS}
    return changes
