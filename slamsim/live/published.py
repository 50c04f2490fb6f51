"""What SLAM made of a live robot's messages, as ROS messages (CDR)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from slamsim.core.types import FloatArray, Grid
from slamsim.io.bag2.writer import TopicKind
from slamsim.io.ros.message_types import ros2_types
from slamsim.recording.schemas import TRANSFORMS

MAP, PATH, DIAGNOSTICS = "/map", "/path", "/slamsim/diagnostics"
SLAM_TOPICS = (
    TopicKind(MAP, "nav_msgs/msg/OccupancyGrid", latched=True),
    TopicKind(PATH, "nav_msgs/msg/Path", latched=True),
    TopicKind(DIAGNOSTICS, "diagnostic_msgs/msg/DiagnosticArray"),
)
MAP_FRAME = "map"


class SlamMessages:
    """Makes them; one for each thread. odom_frame: in which the robot's odometry is."""

    def __init__(self, odom_frame: str = "odom") -> None:
        self._odom_frame, self._types = odom_frame, ros2_types()

    def map_odom(self, stamp_ns: int, T_map_odom: FloatArray) -> bytes:
        """T_map_odom: (3,), as tf2_msgs/TFMessage."""
        x_m, y_m, yaw_rad = T_map_odom.tolist()
        transform = self._new(
            "geometry_msgs/msg/Transform",
            translation=self._new("geometry_msgs/msg/Vector3", x=x_m, y=y_m, z=0.0),
            rotation=self._rotation(yaw_rad),
        )
        stamped = self._new(
            "geometry_msgs/msg/TransformStamped",
            header=self._header(stamp_ns, MAP_FRAME),
            child_frame_id=self._odom_frame,
            transform=transform,
        )
        return self._cdr(TRANSFORMS, transforms=[stamped])

    def grid(self, stamp_ns: int, grid: Grid) -> bytes:
        """As nav_msgs/OccupancyGrid: per cent, -1 unknown."""
        rows, columns = grid.occupancy.shape
        x_m, y_m = (float(value) for value in grid.origin_m)
        info = self._new(
            "nav_msgs/msg/MapMetaData",
            map_load_time=self._time(stamp_ns),
            resolution=float(grid.resolution_m),
            width=columns,
            height=rows,
            origin=self._pose(x_m, y_m, 0.0),
        )
        per_cent = np.where(np.isnan(grid.occupancy), -1.0, np.rint(100.0 * grid.occupancy))
        data = per_cent.astype(np.int8).ravel()
        header = self._header(stamp_ns, MAP_FRAME)
        return self._cdr("nav_msgs/msg/OccupancyGrid", header=header, info=info, data=data)

    def path(self, stamp_ns: int, poses: FloatArray) -> bytes:
        """poses: (n, 3) T_map_base, as nav_msgs/Path."""
        header = self._header(stamp_ns, MAP_FRAME)
        stamped = [
            self._new("geometry_msgs/msg/PoseStamped", header=header, pose=self._pose(*pose))
            for pose in poses.tolist()
        ]
        return self._cdr("nav_msgs/msg/Path", header=header, poses=stamped)

    def twist(self, stamp_ns: int, v_m_s: float, w_rad_s: float, *, stamped: bool) -> bytes:
        """As geometry_msgs/Twist, or stamped as geometry_msgs/TwistStamped."""
        kinds = "geometry_msgs/msg/Vector3", "geometry_msgs/msg/Twist"
        linear = self._new(kinds[0], x=v_m_s, y=0.0, z=0.0)
        parts = {"linear": linear, "angular": self._new(kinds[0], x=0.0, y=0.0, z=w_rad_s)}
        if not stamped:
            return self._cdr(kinds[1], **parts)
        twist, header = self._new(kinds[1], **parts), self._header(stamp_ns, "")
        return self._cdr("geometry_msgs/msg/TwistStamped", header=header, twist=twist)

    def goal(self, stamp_ns: int, pose: tuple[float, float, float]) -> bytes:
        """pose: x_m, y_m, yaw_rad in the map, as geometry_msgs/PoseStamped."""
        header = self._header(stamp_ns, MAP_FRAME)
        return self._cdr("geometry_msgs/msg/PoseStamped", header=header, pose=self._pose(*pose))

    def diagnostics(self, stamp_ns: int, ok: bool, said: str, values: Mapping[str, str]) -> bytes:
        """As diagnostic_msgs/DiagnosticArray of one status."""
        pairs = [
            self._new("diagnostic_msgs/msg/KeyValue", key=k, value=v) for k, v in values.items()
        ]
        status = self._new(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=0 if ok else 1,
            name="slamsim",
            message=said,
            hardware_id="",
            values=pairs,
        )
        header = self._header(stamp_ns, "")
        return self._cdr("diagnostic_msgs/msg/DiagnosticArray", header=header, status=[status])

    def _new(self, type_name: str, **fields: Any) -> Any:
        return self._types.types[type_name](**fields)

    def _cdr(self, type_name: str, **fields: Any) -> bytes:
        return bytes(self._types.serialize_cdr(self._new(type_name, **fields), type_name))

    def _time(self, stamp_ns: int) -> Any:
        sec, nanosec = divmod(stamp_ns, 1_000_000_000)
        return self._new("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)

    def _header(self, stamp_ns: int, frame_id: str) -> Any:
        return self._new("std_msgs/msg/Header", stamp=self._time(stamp_ns), frame_id=frame_id)

    def _rotation(self, yaw_rad: float) -> Any:
        half = 0.5 * yaw_rad
        z, w = math.sin(half), math.cos(half)
        return self._new("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=z, w=w)

    def _pose(self, x_m: float, y_m: float, yaw_rad: float) -> Any:
        position = self._new("geometry_msgs/msg/Point", x=x_m, y=y_m, z=0.0)
        orientation = self._rotation(yaw_rad)
        return self._new("geometry_msgs/msg/Pose", position=position, orientation=orientation)
