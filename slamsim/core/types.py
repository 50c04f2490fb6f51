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
finite or beyond ``guard.numbers.MOST``, stamps out of order, arrays of another shape or type. So
no stage has to ask again, and none can pass on what it must not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from slamsim.core.arrays import BoolArray, Float32Array, FloatArray, IntArray, Samples
from slamsim.core.scans import Cloud, Scan, ScanBeside, ScanGeometry, ScanSource
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
    "Occluded",
    "OutsideTimeRange",
    "PlanarPoses",
    "PlanarTrajectory",
    "Scan",
    "ScanBeside",
    "ScanGeometry",
    "ScanSource",
    "Trajectory",
    "TriangleMesh",
]

Epoch = Literal["simulation", "unix", "unknown"]

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


@dataclass(frozen=True, slots=True, eq=False)
class ImuStream(Samples):
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
class EncoderStream(Samples):
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


class Occluded(Protocol):
    """Whether anything lies between."""

    def __call__(
        self, origins_m: FloatArray, directions: Float32Array, distances_m: Float32Array
    ) -> BoolArray:
        """(n,) whether rays from (n, 3) points of the map frame along (n, 3) unit directions meet
        anything within (n,) distances."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Drive(Samples):
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

    OCCUPIED_ABOVE: ClassVar[float] = 0.65
    FREE_BELOW: ClassVar[float] = 0.25
    """The thresholds of ROS's map_saver: what is drawn, scored and driven on."""

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
