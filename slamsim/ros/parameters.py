"""The parameters of the node, known without ROS."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class NodeParameters:
    """Each with the sentence that ``ros2 param describe`` tells."""

    scan_topic: str = field(default="", metadata={"help": "scans to map; empty: by type"})
    odom_topic: str = field(default="", metadata={"help": "odometry to read; empty: by type"})
    imu_topic: str = field(default="", metadata={"help": "IMU to read; empty: by type"})
    map_topic: str = field(
        default="",
        metadata={"help": "where the map is published; empty: /map, or /slamsim/map beside one"},
    )
    publish_tf: bool = field(
        default=True, metadata={"help": "publish map -> odom, unless the robot has a map frame"}
    )
    config: str = field(default="", metadata={"help": "YAML with settings; empty: defaults"})
    output_folder: str = field(
        default="", metadata={"help": "for map and recordings; empty: outputs/robot_live"}
    )
    overwrite: bool = field(default=False, metadata={"help": "replace an older output folder"})
    record: bool = field(default=False, metadata={"help": "record what is read, as rosbag2"})
