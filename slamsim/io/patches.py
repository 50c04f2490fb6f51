"""What an edited row sets in the decoded message that it came from, kind by kind.

A row is compared with the one that was read, bit by bit; only what differs is set.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamsim.logs.frames import frame_name
from slamsim.recording import RawImu, RawJoints, RawOdometry, RawScans, RawTicks, TransformEdge
from slamsim.types import BoolArray, IntArray

Patch = Callable[[Any, int], None]
"""Sets what differs in row i in its message, or in its transform of a message."""
Patches = list[tuple[BoolArray, Patch]]
"""(where, how): (k,) rows of a pair, and what is set there."""
Setter = Callable[[Any, Any], None]

_BLOCK = 4096
_LAYOUT_FIELDS = (
    "angle_min",
    "angle_max",
    "angle_increment",
    "time_increment",
    "scan_time",
    "range_min",
    "range_max",
)
"""Of a LaserScan, in the order of ``ScanLayout``."""


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """An edited part beside one that was read from the same messages.

    rows: (k,) of the edited one; read_rows: (k,) the ones they were read as.
    """

    edited: Any
    read: Any
    rows: IntArray
    read_rows: IntArray

    def unequal(self, name: str) -> BoolArray:
        """(k,) where a field that has a row for each message differs in any bit."""
        mine, theirs = getattr(self.edited, name), getattr(self.read, name)
        if mine is theirs and np.array_equal(self.rows, self.read_rows):
            return np.zeros(self.rows.size, dtype=np.bool_)
        if isinstance(mine, np.ndarray) and isinstance(theirs, np.ndarray):
            if mine.shape[1:] != theirs.shape[1:]:
                return np.ones(self.rows.size, dtype=np.bool_)
            blocks = [  # for ranges may be on the disk, and larger than the memory
                _bits_differ(
                    mine[self.rows[start : start + _BLOCK]],
                    theirs[self.read_rows[start : start + _BLOCK]],
                )
                for start in range(0, self.rows.size, _BLOCK)
            ]
            return np.concatenate(blocks)
        pairs = zip(self.rows.tolist(), self.read_rows.tolist(), strict=True)
        return np.array([not _same_bits(mine[i], theirs[j]) for i, j in pairs], dtype=np.bool_)

    def renamed(self, name: str) -> Callable[[str], str] | None:
        """From the frame that a message names to another; None where none is renamed."""
        before, after = getattr(self.read, name), getattr(self.edited, name)
        if before == after or not after:
            return None
        known = dict(zip(before, after, strict=True)) if len(before) == len(after) else {}
        return lambda frame: known.get(frame_name(frame), after[0])


def patches_of(pair: Pair) -> Patches:
    """(where, how) for everything that a message of this kind says."""
    stamps_ns = pair.edited.stamps_ns

    def set_stamp(message: Any, row: int) -> None:
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = divmod(int(stamps_ns[row]), 1_000_000_000)

    found: Patches = [(pair.unequal("stamps_ns"), set_stamp)]
    if isinstance(pair.edited, TransformEdge):
        return found + _edge_patches(pair)
    found += _frame_patch(pair, "frame_ids", lambda m: m.header, "frame_id")
    kinds: dict[type, Callable[[Pair], Patches]] = {
        RawScans: _scan_patches,
        RawImu: _imu_patches,
        RawOdometry: _odometry_patches,
        RawTicks: _ticks_patches,
        RawJoints: _joint_patches,
    }
    return found + kinds[type(pair.edited)](pair)


def _frame_patch(pair: Pair, name: str, part: Callable[[Any], Any], field: str) -> Patches:
    renamed = pair.renamed(name)
    if renamed is None:
        return []

    def rename(message: Any, _: int) -> None:
        setattr(part(message), field, renamed(getattr(part(message), field)))

    return [(np.ones(pair.rows.size, dtype=np.bool_), rename)]


def _columns(pair: Pair, setters: dict[str, Setter]) -> Patches:
    """A patch for each field of the stream that a setter writes from its row."""

    def patch_of(name: str, setter: Setter) -> Patch:
        values = getattr(pair.edited, name)
        return lambda message, row: setter(message, values[row])

    return [(pair.unequal(name), patch_of(name, setter)) for name, setter in setters.items()]


def _vector(*path: str) -> Setter:
    """Sets x, y, z (and w) of a part of a message."""

    def set_vector(message: Any, values: NDArray[np.float64]) -> None:
        for name in path:
            message = getattr(message, name)
        for axis, value in zip("xyzw", values.tolist(), strict=False):
            setattr(message, axis, value)

    return set_vector


def _edge_patches(pair: Pair) -> Patches:
    edge, before = pair.edited, pair.read
    found = _columns(
        pair,
        {
            "positions_m": _vector("transform", "translation"),
            "quats_xyzw": _vector("transform", "rotation"),
        },
    )
    if (edge.parent, edge.child) != (before.parent, before.child):

        def rename(transform: Any, _: int) -> None:
            transform.header.frame_id, transform.child_frame_id = edge.parent, edge.child

        found.append((np.ones(pair.rows.size, dtype=np.bool_), rename))
    return found


def _scan_patches(pair: Pair) -> Patches:
    before, after = (
        np.array([astuple(layout) for layout in part.layouts])[part.layout_of]
        for part in (pair.read, pair.edited)
    )
    unequal = np.zeros(after.shape, dtype=np.bool_)
    unequal[pair.rows] = before[pair.read_rows].view(np.int64) != after[pair.rows].view(np.int64)

    def declare(message: Any, row: int) -> None:
        with np.errstate(over="ignore"):
            for i in np.flatnonzero(unequal[row]).tolist():
                setattr(message, _LAYOUT_FIELDS[i], float(np.float32(after[row, i])))

    def set_ranges(message: Any, values: Any) -> None:
        message.ranges = np.ascontiguousarray(values, dtype=np.float32)

    def set_intensities(message: Any, values: Any) -> None:
        message.intensities = np.ascontiguousarray(values, dtype=np.float32)

    found: Patches = [(np.asarray(unequal[pair.rows].any(axis=1)), declare)]
    found += _columns(pair, {"ranges_m": set_ranges})
    if pair.edited.intensities is None and pair.read.intensities is not None:
        every = np.ones(pair.rows.size, dtype=np.bool_)
        none = np.zeros(0, dtype=np.float32)
        found.append((every, lambda message, _: set_intensities(message, none)))
    elif pair.read.intensities is not None:
        found += _columns(pair, {"intensities": set_intensities})
    return found


def _imu_patches(pair: Pair) -> Patches:
    found = _columns(
        pair,
        {
            "angular_velocity_rad_s": _vector("angular_velocity"),
            "linear_acceleration_m_s2": _vector("linear_acceleration"),
        },
    )
    set_orientation = _vector("orientation")
    before, after = pair.read.orientation_xyzw, pair.edited.orientation_xyzw

    def orient(message: Any, row: int) -> None:
        # A first covariance of -1 says that there is no orientation (sensor_msgs/Imu).
        covariance = np.array(message.orientation_covariance)
        if after is None:
            covariance[0] = -1.0
        else:
            set_orientation(message, after[row])
            covariance[0] = 0.0 if covariance[0] == -1.0 else covariance[0]
        message.orientation_covariance = covariance

    if before is None and after is None:
        return found
    if before is None or after is None:
        return [*found, (np.ones(pair.rows.size, dtype=np.bool_), orient)]
    return [*found, (pair.unequal("orientation_xyzw"), orient)]


def _odometry_patches(pair: Pair) -> Patches:
    return _columns(
        pair,
        {
            "positions_m": _vector("pose", "pose", "position"),
            "quats_xyzw": _vector("pose", "pose", "orientation"),
            "linear_m_s": _vector("twist", "twist", "linear"),
            "angular_rad_s": _vector("twist", "twist", "angular"),
        },
    ) + _frame_patch(pair, "child_frame_ids", lambda message: message, "child_frame_id")


def _ticks_patches(pair: Pair) -> Patches:
    def set_ticks(message: Any, values: IntArray) -> None:
        message.left, message.right = values.tolist()

    numbers = ("ticks_per_revolution", "wheel_radius_m", "track_m")
    new = {n: getattr(pair.edited, n) for n in numbers}
    new = {n: value for n, value in new.items() if value != getattr(pair.read, n)}

    def set_numbers(message: Any, _: int) -> None:
        for name, value in new.items():
            setattr(message, name, value)

    return [
        *_columns(pair, {"ticks": set_ticks}),
        (np.full(pair.rows.size, bool(new)), set_numbers),
    ]


def _joint_patches(pair: Pair) -> Patches:
    names: Sequence[str] = pair.edited.names

    def setter(field: str) -> Setter:
        def set_joints(message: Any, values: Any) -> None:
            now = np.array(getattr(message, field), dtype=np.float64)
            if now.size != len(message.name):
                return  # the message gives none, as one may
            mine = np.array([values[names.index(name)] for name in message.name])
            setattr(message, field, mine)

        return set_joints

    return _columns(
        pair, {"positions_rad": setter("position"), "velocities_rad_s": setter("velocity")}
    )


def _bits_differ(one: NDArray[Any], other: NDArray[Any]) -> BoolArray:
    """(n,) where rows differ in any bit, so that -0 is not 0 and nan is nan."""
    one, other = (np.ascontiguousarray(each) for each in (one, other))
    if one.dtype != other.dtype:
        return np.asarray((one != other).reshape(len(one), -1).any(axis=1))
    bits = np.dtype(f"u{one.dtype.itemsize}")
    unequal = one.view(bits) != other.view(bits)
    return np.asarray(unequal.reshape(len(one), -1).any(axis=1))


def _same_bits(one: Any, other: Any) -> bool:
    return len(one) == len(other) and np.asarray(one).tobytes() == np.asarray(other).tobytes()
