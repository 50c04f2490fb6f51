"""True overlap of two scans: the share of one scan's beams that the other also sees.

A beam of scan a that met a wall is seen by scan b if b has a beam that points there, no further
off than b's beams are apart, and met the same surface, or one that faces the same way so near to
the same point that it is the same wall drawn in small pieces. Walls that hide each other, thin
walls seen from either side and the limits of the lidar are thereby as they truly were.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slamsim.core.geometry import between
from slamsim.core.jit import kernel
from slamsim.core.types import BoolArray, FloatArray, IntArray
from slamsim.dataset.truth.key_scans import KeyScan
from slamsim.dataset.truth.surfaces import TrueSurfaces
from slamsim.io.parquet.file import Cells, Column, ParquetFile

LEAST_OVERLAP = 0.1
"""Pairs that overlap less, either way, are not kept."""
CLOSURE_OVERLAP = 0.3
"""From here on, both ways, a pair can close a loop."""
CLOSURE_WAY_M = 10.0
"""So far the robot must have driven in between."""

SAME_WAY = 0.5
"""Least cosine between the normals of pieces of one wall."""
SAME_PLACE_M = 0.05
"""Two surfaces are one if they are nearer: less than the distance of beams on a wall some metres
away."""
_CELL_M = 1.0
"""Of the grid in which ends of beams are sorted, for speed alone."""


_COLUMNS = (
    Column("scan_a", "int32", "row of scans.parquet"),
    Column("scan_b", "int32", "row of scans.parquet"),
    Column("true_stamp_a_ns", "int64"),
    Column("true_stamp_b_ns", "int64"),
    Column("overlap_a", "float32", "share of the returns of a from walls that b sees"),
    Column("overlap_b", "float32", "share of the returns of b from walls that a sees"),
    Column("x_m", "float64", "of T_a_b of the base at the first beam of each scan"),
    Column("y_m", "float64"),
    Column("yaw_rad", "float64"),
    Column("way_m", "float32", "driven between the two"),
    Column("closes_loop", "bool"),
)


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Pairs of key scans that overlap, by the numbers of the key scans.

    first, second: (n,) with first < second. shares: (n, 2) of first seen by second, and of second
    by first. closes: (n,) whether the pair closes a loop.
    """

    first: IntArray
    second: IntArray
    shares: FloatArray
    closes: BoolArray


def overlapping(keys: Sequence[KeyScan], surfaces: TrueSurfaces, step_rad: float) -> Pairs:
    """All pairs that overlap. step_rad: between the beams that the key scans keep."""
    shares = overlap_shares(keys, surfaces, step_rad)
    first, second = np.nonzero(np.triu(np.maximum(shares, shares.T) >= LEAST_OVERLAP, k=1))
    both = np.column_stack([shares[first, second], shares[second, first]])
    ways_m = np.array([key.way_m for key in keys])
    closes = (both.min(axis=1, initial=1.0) >= CLOSURE_OVERLAP) & (
        ways_m[second] - ways_m[first] >= CLOSURE_WAY_M
    )
    return Pairs(first, second, both, closes)


def overlap_shares(keys: Sequence[KeyScan], surfaces: TrueSurfaces, step_rad: float) -> FloatArray:
    """(k, k) float32: share of the returns of key scan a (row) that key scan b (column) sees."""
    count = len(keys)
    starts = np.cumsum([0, *(len(key.surfaces) for key in keys)])
    ends_m = np.concatenate([np.zeros((0, 3)), *(key.ends_m for key in keys)])
    numbers = np.concatenate([np.zeros(0, dtype=np.int64), *(key.surfaces for key in keys)])
    cells, shape = _cells(ends_m)
    bearings, order = np.empty(len(ends_m)), np.empty(len(ends_m), dtype=np.int64)
    for number, key in enumerate(keys):
        mine = slice(starts[number], starts[number + 1])
        seen_m = (key.ends_m - key.T_map_laser[:3, 3]) @ key.T_map_laser[:3, :3]
        angles = np.arctan2(seen_m[:, 1], seen_m[:, 0])
        sorting = np.argsort(angles, kind="stable")
        bearings[mine], order[mine] = angles[sorting], starts[number] + sorting
    frames = np.array([key.T_map_laser for key in keys]).reshape(count, 4, 4)
    return _shares(
        frames, starts, ends_m, numbers, surfaces.normals, bearings, order, cells, shape, step_rad
    )


def _cells(ends_m: FloatArray) -> tuple[IntArray, IntArray]:
    """(n,) number of the square metre, in a frame one wide, of each end, and rows and columns."""
    if len(ends_m) == 0:
        return np.zeros(0, dtype=np.int64), np.array([3, 3])
    places = np.floor(ends_m[:, :2] / _CELL_M).astype(np.int64)
    places -= places.min(axis=0) - 1
    shape = places.max(axis=0) + 2
    return places[:, 0] * shape[1] + places[:, 1], shape


@kernel
def _shares(
    frames: FloatArray,
    starts: IntArray,
    ends_m: FloatArray,
    numbers: IntArray,
    normals: FloatArray,
    bearings: FloatArray,
    order: IntArray,
    cells: IntArray,
    shape: IntArray,
    step_rad: float,
) -> FloatArray:
    shares = np.zeros((frames.shape[0], frames.shape[0]))
    for b in range(len(shares)):
        first, last = starts[b], starts[b + 1]
        # Which surfaces and places scan b can see at all: most points need no more than this.
        near = np.zeros(shape[0] * shape[1], dtype=np.bool_)
        met = np.zeros(normals.shape[0], dtype=np.bool_)
        for k in range(first, last):
            met[numbers[k]] = True
            for row in range(-1, 2):
                for column in range(-1, 2):
                    near[cells[k] + row * shape[1] + column] = True
        for a in range(len(shares)):
            seen = 0
            for k in range(starts[a], starts[a + 1]):
                if met[numbers[k]] or near[cells[k]]:
                    seen += _sees(
                        frames[b],
                        ends_m[k],
                        numbers[k],
                        bearings[first:last],
                        order[first:last],
                        ends_m,
                        numbers,
                        normals,
                        step_rad,
                    )
            shares[a, b] = seen / max(starts[a + 1] - starts[a], 1)
    return shares


@kernel
def _sees(
    frame: FloatArray,
    point_m: FloatArray,
    number: int,
    bearings: FloatArray,
    order: IntArray,
    ends_m: FloatArray,
    numbers: IntArray,
    normals: FloatArray,
    step_rad: float,
) -> bool:
    """Whether a beam beside the direction to a point met what the point lies on."""
    x, y, z = point_m[0] - frame[0, 3], point_m[1] - frame[1, 3], point_m[2] - frame[2, 3]
    ahead = frame[0, 0] * x + frame[1, 0] * y + frame[2, 0] * z
    aside = frame[0, 1] * x + frame[1, 1] * y + frame[2, 1] * z
    bearing = math.atan2(aside, ahead)
    right = np.searchsorted(bearings, bearing)
    reach_m = SAME_PLACE_M + step_rad * math.hypot(ahead, aside)
    for i in range(right - 2, right + 2):
        k = i % bearings.size
        apart = abs(bearings[k] - bearing)
        if min(apart, 2.0 * math.pi - apart) > step_rad:
            continue
        beam = order[k]
        if numbers[beam] == number:
            return True
        facing, distance = 0.0, 0.0
        for axis in range(3):
            facing += normals[numbers[beam], axis] * normals[number, axis]
            distance += (ends_m[beam, axis] - point_m[axis]) ** 2
        if facing >= SAME_WAY and distance <= reach_m * reach_m:
            return True
    return False


def write_pairs(path: Path, keys: Sequence[KeyScan], pairs: Pairs, sequence: int) -> None:
    """``pairs.parquet``: a row for each pair, with the true motion between the two scans."""
    rows = np.array([key.row for key in keys], dtype=np.int64)
    stamps_ns = np.array([key.true_stamp_ns for key in keys], dtype=np.int64)
    poses = np.array([key.pose for key in keys]).reshape(-1, 3)
    ways_m = np.array([key.way_m for key in keys])
    a, b = pairs.first, pairs.second
    T_a_b = between(poses[a], poses[b]) if a.size else np.zeros((0, 3))
    cells: dict[str, Cells] = {
        "scan_a": rows[a].astype(np.int32),
        "scan_b": rows[b].astype(np.int32),
        "true_stamp_a_ns": stamps_ns[a],
        "true_stamp_b_ns": stamps_ns[b],
        "overlap_a": pairs.shares[:, 0],
        "overlap_b": pairs.shares[:, 1],
        "x_m": T_a_b[:, 0],
        "y_m": T_a_b[:, 1],
        "yaw_rad": T_a_b[:, 2],
        "way_m": ways_m[b] - ways_m[a],
        "closes_loop": pairs.closes,
    }
    facts = {
        "table": "pairs",
        "least_overlap": LEAST_OVERLAP,
        "closes_loop": f"both overlaps at least {CLOSURE_OVERLAP:g}, "
        f"at least {CLOSURE_WAY_M:g} m driven in between",
        "key_scans": rows.tolist(),
    }
    with ParquetFile(path, _COLUMNS, facts, sequence=sequence) as file:
        file.append(cells)
