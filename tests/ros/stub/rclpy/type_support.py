"""Message types, and the packages that hold them: those that ROS has, and one without support."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

KNOWN = (
    *("sensor_msgs/msg/LaserScan", "sensor_msgs/msg/Imu", "nav_msgs/msg/Odometry"),
    *("nav_msgs/msg/OccupancyGrid", "nav_msgs/msg/Path", "tf2_msgs/msg/TFMessage"),
    *("diagnostic_msgs/msg/DiagnosticArray", "std_msgs/msg/String", "rosgraph_msgs/msg/Clock"),
    "half_built_msgs/msg/Thing",
)


class UnsupportedTypeSupport(Exception):
    """As rosidl_generator_py raises it, which is no ImportError."""


def check_is_valid_msg_type(msg_type: Any) -> None:
    if msg_type.ros_name.startswith("half_built_msgs/"):
        raise UnsupportedTypeSupport("Could not import 'rosidl_typesupport_c' for package")


def _install() -> None:
    for ros_name in KNOWN:
        package, folder, name = ros_name.split("/")
        sys.modules.setdefault(package, ModuleType(package))
        module = sys.modules.setdefault(f"{package}.{folder}", ModuleType(f"{package}.{folder}"))
        setattr(module, name, type(name, (), {"ros_name": ros_name}))


_install()
