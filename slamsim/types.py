"""The values that cross a stage, and the conventions that hold everywhere.

Frames are right-handed: x forward, y left, z up (REP 103); the tree is
map -> odom -> base_footprint -> base_link -> sensors (REP 105). ``base`` below
always means ``base_footprint``. A transform is named ``T_target_source``: it takes
coordinates in ``source`` to coordinates in ``target``, so that
``T_map_base @ T_base_laser`` cancels by eye. A planar transform is an array
``(x_m, y_m, yaw_rad)``; a spatial one is a 4 x 4 matrix.

Units are SI. Time is an integer count of nanoseconds. All stamps are instants of
acquisition, on the clock of the log. No return is ``inf``, invalid is ``nan``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from slamsim.geometry import interpolate_se2, slerp_xyzw, yaw_from_xyzw

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

Epoch = Literal["simulation", "unix", "unknown"]

GRAVITY_M_S2 = 9.80665
"""Standard gravity, down along z: what the physics falls with and a resting robot feels."""


class OutsideTimeRange(ValueError):
    """A look-up at an instant that the data do not cover; nothing is extrapolated."""


def _require_covered(stamps_ns: IntArray, query_ns: IntArray, what: str) -> None:
    if query_ns.size == 0:
        return
    first, last = int(query_ns.min()), int(query_ns.max())
    if stamps_ns.size == 0 or first < stamps_ns[0] or last > stamps_ns[-1]:
        have = "nothing" if stamps_ns.size == 0 else f"{stamps_ns[0]}..{stamps_ns[-1]} ns"
        raise OutsideTimeRange(f"{what} covers {have}, asked for {first}..{last} ns")


def _bracket(stamps_ns: IntArray, query_ns: IntArray) -> tuple[IntArray, FloatArray]:
    """Index of the sample at or before each query and the fraction towards the next."""
    left = np.clip(
        np.searchsorted(stamps_ns, query_ns, side="right") - 1, 0, max(stamps_ns.size - 2, 0)
    )
    right = np.minimum(left + 1, stamps_ns.size - 1)
    span = (stamps_ns[right] - stamps_ns[left]).astype(np.float64)
    elapsed = (query_ns - stamps_ns[left]).astype(np.float64)
    fraction = np.divide(elapsed, span, out=np.zeros_like(elapsed), where=span > 0)
    return left, fraction


@dataclass(frozen=True, slots=True, eq=False)
class PlanarTrajectory:
    """``T_target_base`` over time in the plane.

    stamps_ns: (n,) strictly increasing. poses: (n, 3) rows of (x_m, y_m, yaw_rad).
    """

    stamps_ns: IntArray
    poses: FloatArray

    def __len__(self) -> int:
        return int(self.stamps_ns.size)

    def at(self, stamps_ns: IntArray) -> FloatArray:
        """(m, 3) poses at the given instants; raises OutsideTimeRange beyond the ends."""
        _require_covered(self.stamps_ns, stamps_ns, "the trajectory")
        left, fraction = _bracket(self.stamps_ns, stamps_ns)
        right = np.minimum(left + 1, len(self) - 1)
        return interpolate_se2(self.poses[left], self.poses[right], fraction)

    def path_length_m(self) -> float:
        return float(np.linalg.norm(np.diff(self.poses[:, :2], axis=0), axis=1).sum())


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """``T_target_base`` over time in space.

    stamps_ns: (n,) strictly increasing. positions_m: (n, 3). quats_xyzw: (n, 4), unit.
    """

    stamps_ns: IntArray
    positions_m: FloatArray
    quats_xyzw: FloatArray

    def __len__(self) -> int:
        return int(self.stamps_ns.size)

    def at(self, stamps_ns: IntArray) -> Trajectory:
        """Poses at the given instants; raises OutsideTimeRange beyond the ends."""
        _require_covered(self.stamps_ns, stamps_ns, "the trajectory")
        left, fraction = _bracket(self.stamps_ns, stamps_ns)
        right = np.minimum(left + 1, len(self) - 1)
        step = self.positions_m[right] - self.positions_m[left]
        return Trajectory(
            stamps_ns,
            self.positions_m[left] + fraction[:, None] * step,
            slerp_xyzw(self.quats_xyzw[left], self.quats_xyzw[right], fraction),
        )

    def planar(self) -> PlanarTrajectory:
        """The projection onto the floor: x, y and the heading of the x axis."""
        yaw = yaw_from_xyzw(self.quats_xyzw)
        return PlanarTrajectory(self.stamps_ns, np.column_stack([self.positions_m[:, :2], yaw]))


@dataclass(frozen=True, slots=True)
class ScanGeometry:
    """What all scans of one lidar share.

    Beam ``i`` fires ``i * beam_dt_ns`` after the scan's stamp and looks along
    ``angle_min_rad + i * angle_step_rad`` in the laser frame, counter-clockwise seen from
    above its z axis. A flash scan has ``beam_dt_ns == 0``.
    """

    angle_min_rad: float
    angle_step_rad: float
    beam_count: int
    beam_dt_ns: int
    range_min_m: float
    range_max_m: float
    frame_id: str = "laser"

    def angles_rad(self) -> FloatArray:
        """(beam_count,) direction of each beam in the laser frame."""
        steps = np.arange(self.beam_count, dtype=np.float64)
        return self.angle_min_rad + steps * self.angle_step_rad

    def offsets_ns(self) -> IntArray:
        """(beam_count,) firing time of each beam after the scan's stamp."""
        return np.arange(self.beam_count, dtype=np.int64) * self.beam_dt_ns

    @property
    def duration_ns(self) -> int:
        """From the first beam to the last."""
        return (self.beam_count - 1) * self.beam_dt_ns


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """One raw sweep in the laser frame: timed beams, motion distortion included.

    stamp_ns: the instant at which beam 0 fires. ranges_m: (beam_count,) float32, ``inf`` for
    no return, ``nan`` for an invalid reading. intensities: (beam_count,) float32 or None.
    """

    stamp_ns: int
    ranges_m: Float32Array
    geometry: ScanGeometry
    intensities: Float32Array | None = None

    @property
    def end_ns(self) -> int:
        return self.stamp_ns + self.geometry.duration_ns


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """A scan freed of motion: all beams as seen from the base frame at one instant.

    points_m: (n, 2) end of each beam; a beam without return ends at the lidar's maximum range.
    origins_m: (n, 2) where the beam left the sensor. hit: (n,) whether something was there.
    """

    stamp_ns: int
    points_m: FloatArray
    origins_m: FloatArray
    hit: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class ImuStream:
    """stamps_ns: (n,). angular_velocity_rad_s, linear_acceleration_m_s2: (n, 3) in frame_id.

    linear_acceleration_m_s2 is specific force: at rest and level it reads +9.8 on z.
    """

    stamps_ns: IntArray
    angular_velocity_rad_s: FloatArray
    linear_acceleration_m_s2: FloatArray
    frame_id: str = "imu_link"


@dataclass(frozen=True, slots=True, eq=False)
class EncoderStream:
    """Cumulative wheel ticks: stamps_ns (n,), ticks (n, 2) int64 as (left, right).

    wheel_radius_m and track_m are the nominal values that a driver would use.
    """

    stamps_ns: IntArray
    ticks: IntArray
    ticks_per_revolution: int
    wheel_radius_m: float
    track_m: float


class ScanSource(Protocol):
    """The scans of a log, in time order, readable any number of times."""

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[Scan]: ...


@dataclass(frozen=True, slots=True, eq=False)
class Log:
    """A recording as SLAM and the checker see it: never the truth.

    odometry is ``T_odom_base`` as some driver published it. T_base_laser is 4 x 4.
    warnings tells in words what the reader found odd and mended, with counts.
    """

    name: str
    epoch: Epoch
    scans: ScanSource
    odometry: PlanarTrajectory | None
    imu: ImuStream | None
    encoders: EncoderStream | None
    T_base_laser: FloatArray
    T_base_imu: FloatArray | None = None
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class TriangleMesh:
    """vertices_m: (v, 3) in the map frame. triangles: (t, 3) indices into them."""

    vertices_m: FloatArray
    triangles: NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """The true motion at the physics rate: a whole drive, or a window of one.

    stamps_ns: (n,) true time. T_map_base as positions_m (n, 3) and quats_xyzw (n, 4);
    linear_velocity_m_s and angular_velocity_rad_s: (n, 3) of the base, in the map frame.
    wheel_angles_rad, wheel_speeds_rad_s: (n, 2) as (left, right). commands: (n, 2) as
    (forward m/s, yaw rate rad/s). wall_contact: (n,) whether the robot touched a wall.
    """

    stamps_ns: IntArray
    positions_m: FloatArray
    quats_xyzw: FloatArray
    linear_velocity_m_s: FloatArray
    angular_velocity_rad_s: FloatArray
    wheel_angles_rad: FloatArray
    wheel_speeds_rad_s: FloatArray
    commands: FloatArray
    wall_contact: BoolArray

    def __len__(self) -> int:
        return int(self.stamps_ns.size)

    def trajectory(self) -> Trajectory:
        return Trajectory(self.stamps_ns, self.positions_m, self.quats_xyzw)


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """An occupancy grid, true or estimated.

    occupancy: (rows, cols) float32 probability that a cell is occupied, ``nan`` unknown;
    row 0 holds the smallest y. origin_m: (x, y) of the outer corner of cell (0, 0).
    """

    occupancy: Float32Array
    resolution_m: float
    origin_m: tuple[float, float]
