"""Launches the node: ``ros2 launch FILE scan_topic:=/scan record:=true``.

``ros2`` runs this with the Python of ROS, in which slamsim need not be installed: nothing of it is
imported here.
"""

from __future__ import annotations

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

PARAMETERS = {
    "scan_topic": "",
    "odom_topic": "",
    "imu_topic": "",
    "map_topic": "",
    "publish_tf": True,
    "config": "",
    "output_folder": "",
    "overwrite": False,
    "record": False,
    "use_sim_time": False,
}
PYTHON = DeclareLaunchArgument(
    "python", default_value="python3", description="the Python in which slamsim is installed"
)
FINISHING_S = "120"
"""After Ctrl-C: checksums of a long recording; ros2 launch would ask again after five seconds."""


def generate_launch_description() -> LaunchDescription:
    """An argument for each parameter of the node, and the node."""
    arguments = [
        DeclareLaunchArgument(name, default_value=str(default).lower())
        for name, default in PARAMETERS.items()
    ]
    values = {
        name: ParameterValue(LaunchConfiguration(name), value_type=type(default))
        for name, default in PARAMETERS.items()
    }
    node = Node(
        executable=LaunchConfiguration("python"),
        arguments=["-m", "slamsim.ros"],
        name="slamsim",
        output="screen",
        parameters=[values],
        sigterm_timeout=FINISHING_S,
    )
    return LaunchDescription([PYTHON, *arguments, node])
