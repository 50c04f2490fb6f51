"""ROS 2 message types: the standard ones (as of Jazzy) and our own."""

from __future__ import annotations

from functools import cache

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

FRAME_TRUTH = "slamsim_msgs/msg/FrameTruth"

_FRAME_TRUTH_DEFINITION = """\
std_msgs/Header header
int64 instant_ns
float64 exposure_s
float64 gain
int64[] row_instants_ns
float64[] positions_m
float64[] quats_xyzw
"""


@cache
def ros2_types() -> Typestore:
    """The standard types and two of our own, to which nothing is ever added: what a file defines
    is put into a store of its own (``message_types.py``).

    EncoderTicks: cumulative ticks, and what turns them into metres. FrameTruth: of an image, true
    instants and poses of its rows in the map (one row for all with a global shutter).
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(_FRAME_TRUTH_DEFINITION, FRAME_TRUTH))
    store.register(get_types_from_msg(_ENCODER_TICKS_DEFINITION, ENCODER_TICKS))
    return store
