"""The values that cross a stage, and the conventions that hold everywhere.

Frames are right-handed: x forward, y left, z up (REP 103); the tree is
map -> odom -> base_footprint -> base_link -> sensors (REP 105). ``base`` below
always means ``base_footprint``. A transform is named ``T_target_source``: it takes
coordinates in ``source`` to coordinates in ``target``, so that
``T_map_base @ T_base_laser`` cancels by eye. A planar transform is an array
``(x_m, y_m, yaw_rad)``; a spatial one is a 4 x 4 matrix.

Units are SI. Time is an integer count of nanoseconds. All stamps are instants of
acquisition, on the clock of the log. No return is ``inf``, invalid is ``nan``.

Every constructor here raises BadNumbers for what no stage can work with: numbers that are not
finite or beyond ``safe.numbers.MOST``, stamps out of order, arrays of another shape or type. So
no stage has to ask again, and none can pass on what it must not.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from slamsim.core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from slamsim.core.trajectory import OutsideTimeRange, PlanarPoses, PlanarTrajectory, Trajectory
from slamsim.guard import numbers

__all__ = [
    "GRAVITY_M_S2",
    "BoolArray",
    "Cloud",
    "Drive",
    "EncoderStream",
    "Epoch",
    "Float32Array",
    "FloatArray",
    "Grid",
    "ImuStream",
    "IntArray",
    "Log",
    "OutsideTimeRange",
    "PlanarPoses",
    "PlanarTrajectory",
    "Scan",
    "ScanGeometry",
    "ScanSource",
    "Trajectory",
    "TriangleMesh",
]

Epoch = Literal["simulation", "unix", "unknown"]

MOST_BEAMS, MOST_BEAM_NS = 1_000_000, 1_000_000_000

GRAVITY_M_S2 = 9.80665
"""Standard gravity, down along z: what the physics falls with and a resting robot feels."""

_DRIVE_COLUMNS = {
    "positions_m": 3,
    "linear_velocity_m_s": 3,
    "angular_velocity_rad_s": 3,
    "wheel_angles_rad": 2,
    "wheel_speeds_rad_s": 2,
    "commands": 2,
}


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

    def __post_init__(self) -> None:
        numbers.require_angle("the first angle of a scan", self.angle_min_rad)
        numbers.require_angle("the angle between beams", self.angle_step_rad)
        numbers.require_whole("the number of beams", self.beam_count, 1, MOST_BEAMS)
        numbers.require_whole("the ns between beams", self.beam_dt_ns, -MOST_BEAM_NS, MOST_BEAM_NS)
        numbers.require_number("the least range (m)", self.range_min_m, 0.0)
        numbers.require_number("the largest range (m)", self.range_max_m, self.range_min_m)
        alike = self.beam_count > 1 and self.angle_step_rad == 0.0
        if alike or self.range_max_m == self.range_min_m:
            raise numbers.BadNumbers(f"beams without an angle or a range between them: {self}")

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

    def __post_init__(self) -> None:
        numbers.require_whole("the stamp of a scan (ns)", self.stamp_ns)
        numbers.require_array("the ranges of a scan", self.ranges_m, (self.geometry.beam_count,))
        if self.intensities is not None:
            numbers.require_array("the intensities", self.intensities, self.ranges_m.shape)

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

    def __post_init__(self) -> None:
        numbers.require_whole("the stamp of a cloud (ns)", self.stamp_ns)
        numbers.require_finite("the points of a cloud", self.points_m, (None, 2))
        numbers.require_finite("the origins of a cloud", self.origins_m, self.points_m.shape)
        numbers.require_array("the hits of a cloud", self.hit, (len(self.points_m),), "b")


@dataclass(frozen=True, slots=True, eq=False)
class ImuStream:
    """stamps_ns: (n,). angular_velocity_rad_s, linear_acceleration_m_s2: (n, 3) in frame_id.

    linear_acceleration_m_s2 is specific force: at rest and level it reads +9.8 on z.
    """

    stamps_ns: IntArray
    angular_velocity_rad_s: FloatArray
    linear_acceleration_m_s2: FloatArray
    frame_id: str = "imu_link"

    def __post_init__(self) -> None:
        numbers.require_stamps("an IMU", self.stamps_ns, rising=False)
        shape = (self.stamps_ns.size, 3)
        numbers.require_finite("the turning of an IMU", self.angular_velocity_rad_s, shape)
        numbers.require_finite("the forces of an IMU", self.linear_acceleration_m_s2, shape)


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

    def __post_init__(self) -> None:
        numbers.require_stamps("wheel encoders", self.stamps_ns, rising=False)
        numbers.require_counts("the ticks of wheels", self.ticks, (self.stamps_ns.size, 2))
        numbers.require_whole("the ticks of one revolution", self.ticks_per_revolution, 1)
        numbers.require_size("the radius of the wheels (m)", self.wheel_radius_m)
        numbers.require_size("the track of the wheels (m)", self.track_m)


class ScanSource(Protocol):
    """The scans of a log, in time order, readable any number of times."""

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[Scan]: ...


@dataclass(frozen=True, slots=True, eq=False)
class Log:
    """A recording as SLAM and the checker see it: never the truth.

    odometry is ``T_odom_base`` as some driver published it. T_base_laser is 4 x 4.
    sources: which topics these were read from, in words. warnings: what was odd, and what was done
    about it. recorded_scans: with those left out, or 0.
    """

    name: str
    epoch: Epoch
    scans: ScanSource
    odometry: PlanarTrajectory | None
    imu: ImuStream | None
    encoders: EncoderStream | None
    T_base_laser: FloatArray
    T_base_imu: FloatArray | None = None
    sources: str = ""
    warnings: tuple[str, ...] = ()
    recorded_scans: int = 0

    def __post_init__(self) -> None:
        for what, stream in (("the IMU", self.imu), ("the wheel encoders", self.encoders)):
            if stream is not None:
                numbers.require_stamps(f"{what} of {self.name}", stream.stamps_ns)
        numbers.require_mount("T_base_laser", self.T_base_laser)
        if self.T_base_imu is not None:
            numbers.require_mount("T_base_imu", self.T_base_imu)


@dataclass(frozen=True, slots=True, eq=False)
class TriangleMesh:
    """vertices_m: (v, 3) in the map frame. triangles: (t, 3) indices into them."""

    vertices_m: FloatArray
    triangles: NDArray[np.int32]

    def __post_init__(self) -> None:
        numbers.require_finite("the vertices of a mesh", self.vertices_m, (None, 3))
        numbers.require_array("the triangles of a mesh", self.triangles, (None, 3), "i")
        numbers.require_indices("a triangle of a mesh", self.triangles, len(self.vertices_m))


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

    def __post_init__(self) -> None:
        numbers.require_stamps("a drive", self.stamps_ns)
        for name, columns in _DRIVE_COLUMNS.items():
            numbers.require_finite(f"{name} of a drive", getattr(self, name), (len(self), columns))
        numbers.require_unit_quaternions("quats_xyzw of a drive", self.quats_xyzw, len(self))
        numbers.require_array("wall_contact of a drive", self.wall_contact, (len(self),), "b")

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

    def __post_init__(self) -> None:
        numbers.require_array("the occupancy of a grid", self.occupancy, (None, None))
        numbers.require_whole("the number of cells of a grid", self.occupancy.size, 1)
        numbers.require_size("the resolution of a grid (m)", self.resolution_m)
        for value in self.origin_m:
            numbers.require_number("the origin of a grid (m)", value)
        if (self.occupancy < 0.0).any() or (self.occupancy > 1.0).any():
            raise numbers.BadNumbers("the occupancy of a grid is from 0 to 1, or nan for unknown")
