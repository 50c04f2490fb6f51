"""ROS 2 message types: the standard ones (as of Jazzy) and our own, made anew for each use.

A fresh store per file keeps what one file defines from another.
"""

from __future__ import annotations

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

ENCODER_TICKS = "slamsim_msgs/msg/EncoderTicks"

_ENCODER_TICKS_DEFINITION = """\
std_msgs/Header header
int64 left
int64 right
uint32 ticks_per_revolution
float64 wheel_radius_m
float64 track_m
"""


def ros2_types() -> Typestore:
    """The standard types and EncoderTicks: cumulative ticks, and what turns them into metres."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(_ENCODER_TICKS_DEFINITION, ENCODER_TICKS))
    return store
