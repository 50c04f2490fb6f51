"""From a checked ROS recording to a Log: which topics are what, and where the sensors sit."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from slamsim.core.types import (
    EncoderStream,
    Epoch,
    FloatArray,
    ImuStream,
    Log,
    PlanarTrajectory,
    Trajectory,
)
from slamsim.guard.errors import InputRefused
from slamsim.io.names import LOG
from slamsim.io.ros.bag import Bag, open_bag
from slamsim.io.ros.bag_scans import bag_scans, survey_scans
from slamsim.io.ros.bag_streams import read_chain, read_encoders, read_imu, read_odometry
from slamsim.io.ros.sources import Channel
from slamsim.io.ros.standard_types import ENCODER_TICKS
from slamsim.io.text.stamps import epoch_of
from slamsim.recording.frames import FrameTree

SCAN, IMU = "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/Imu"
ODOMETRY = "nav_msgs/msg/Odometry"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
CLOCK = "rosgraph_msgs/msg/Clock"
_BASE_FRAMES = ("base_footprint", "base_link", "base")
_ODOM_FRAME = "odom"
_TRUTH_WORDS = ("ground_truth", "groundtruth")
_OWN_METADATA = "slamsim"


def read_bag(path: Path, scan_topic: str | None = None) -> Log:
    """The log in a ROS recording; raises InputRefused naming file, topic and reason."""
    bag = open_bag(path)
    scan_channel, warnings = choose_scan(bag, scan_topic)
    topic = scan_channel.topic
    survey, times = survey_scans(bag, topic)
    odd = survey.warnings(times)
    first_ns, last_ns = int(times.stamps_ns[0]), int(times.stamps_ns[-1])
    tree = FrameTree()
    tree.add(bag.messages(_transform_topics(bag, latched=True)))
    moved: list[str] = []
    odometry, base_frame = _odometry(bag, tree, survey.frame_id, moved)
    limit, told = survey.limit(times, odometry)
    warnings += [f"{topic}: {words}" for words in (*odd, *told)] + moved
    encoders = _encoders(bag, warnings)
    imu = _imu(bag, warnings)
    if odometry is not None:
        _require_overlap(bag, odometry, first_ns, last_ns, encoders is not None, warnings)
    return Log(
        name=path.resolve().parent.name if path.name == LOG else path.stem,
        epoch=epoch_in(bag, first_ns),
        scans=bag_scans(bag, topic, times, limit),
        odometry=odometry,
        imu=imu,
        encoders=encoders,
        T_base_laser=laser_mounting_of(tree, base_frame, survey.frame_id, warnings),
        T_base_imu=None if imu is None else imu_mounting_of(tree, base_frame, imu, warnings),
        warnings=tuple(warnings),
        recorded_scans=survey.recorded,
    )


def read_bag_truth(path: Path) -> Trajectory | None:
    """``T_map_base`` from the recording's ground-truth odometry topic, None without one."""
    bag = open_bag(path)
    topics = [channel for channel in bag.of_type(ODOMETRY) if is_truth(channel)]
    if not topics:
        return None
    truth = read_odometry(bag, topics[0].topic)[0]
    return truth if len(truth) else None


def is_truth(channel: Channel) -> bool:
    """Whether a topic holds what no sensor measured."""
    return any(word in channel.topic for word in _TRUTH_WORDS)


def _estimates(bag: Bag, type_name: str, warnings: list[str]) -> Channel | None:
    """The topic of the type with the most messages, the truth left out."""
    channels = [channel for channel in bag.of_type(type_name) if not is_truth(channel)]
    if len(channels) > 1:
        warnings.append(f"of {_listing(channels)}, {channels[0].topic} is read")
    return channels[0] if channels else None


def _listing(channels: list[Channel]) -> str:
    return ", ".join(f"{channel.topic} ({channel.messages} messages)" for channel in channels)


def choose_scan(bag: Bag, wanted: str | None) -> tuple[Channel, list[str]]:
    """(the wanted topic of scans, else the largest, what was odd); InputRefused without one."""
    channels = bag.of_type(SCAN)
    if not channels:
        kinds = sorted({channel.type_name for channel in bag.channels if channel.messages})
        there = ", ".join(kind[:60] for kind in kinds[:9]) or "no message at all"
        raise InputRefused(bag.path, f"a log without scans: {SCAN} is needed, there is {there}")
    if wanted is not None:
        for channel in channels:
            if channel.topic.lstrip("/") == wanted.lstrip("/"):
                return channel, []
        raise InputRefused(bag.path, f"no scans on {wanted!r}; there is {_listing(channels)}")
    several = f"of {_listing(channels)}, {channels[0].topic} is read"
    return channels[0], [several] if len(channels) > 1 else []


def _transform_topics(bag: Bag, latched: bool) -> list[str]:
    channels = bag.of_type(*TRANSFORMS)
    return [c.topic for c in channels if c.topic.endswith("tf_static") == latched]


def _odometry(
    bag: Bag, tree: FrameTree, laser_frame: str, warnings: list[str]
) -> tuple[PlanarTrajectory | None, str]:
    """(T_odom_base, the frame it moves). The tree is completed from /tf where that is needed."""
    channel = _estimates(bag, ODOMETRY, warnings)
    trajectory: Trajectory | None = None
    if channel is not None:
        trajectory, base_frame, odd = read_odometry(bag, channel.topic)
        warnings += odd
        base_frame = base_frame or _likely_base(tree)
        if tree.between(base_frame, laser_frame) is None:
            _add_moving(bag, tree)
    else:
        _add_moving(bag, tree)
        edges = _chain(tree, laser_frame)
        base_frame = edges[-1][1] if edges else _likely_base(tree)
        trajectory = read_chain(bag, _transform_topics(bag, latched=False), edges)
    if trajectory is None or len(trajectory) == 0:
        warnings.append(
            f"a log without odometry: neither {ODOMETRY} nor transforms from {_ODOM_FRAME!r} "
            "to the robot"
        )
        return None, base_frame
    return trajectory.planar(), base_frame


def _add_moving(bag: Bag, tree: FrameTree) -> None:
    tree.add(bag.messages(_transform_topics(bag, latched=False)))


def _likely_base(tree: FrameTree) -> str:
    return next((frame for frame in _BASE_FRAMES if frame in tree), _BASE_FRAMES[0])


def _chain(tree: FrameTree, laser_frame: str) -> list[tuple[str, str]]:
    """Edges from ``odom`` down to the robot's base: the lowest frame that moves, if any does."""
    start = laser_frame if laser_frame in tree else _likely_base(tree)
    path = tree.path_up(start)
    below_odom = [i for i, (parent, _, _) in enumerate(path) if parent == _ODOM_FRAME]
    if not below_odom:
        return []
    top = below_odom[0]
    moving = [i for i in range(top + 1) if path[i][2]]
    return [(parent, child) for parent, child, _ in path[moving[0] if moving else top : top + 1]][
        ::-1
    ]


def _encoders(bag: Bag, warnings: list[str]) -> EncoderStream | None:
    channel = _estimates(bag, ENCODER_TICKS, warnings)
    if channel is None:
        return None
    encoders, odd = read_encoders(bag, channel.topic)
    warnings += odd
    return encoders


def _imu(bag: Bag, warnings: list[str]) -> ImuStream | None:
    channel = _estimates(bag, IMU, warnings)
    if channel is None:
        return None
    imu, odd = read_imu(bag, channel.topic)
    warnings += odd
    return imu


def _require_overlap(
    bag: Bag,
    odometry: PlanarTrajectory,
    first_ns: int,
    last_ns: int,
    has_encoders: bool,
    warnings: list[str],
) -> None:
    start_ns, end_ns = int(odometry.stamps_ns[0]), int(odometry.stamps_ns[-1])
    spans = f"scans {first_ns}..{last_ns} ns, odometry {start_ns}..{end_ns} ns"
    if last_ns < start_ns or first_ns > end_ns:
        if not has_encoders:
            raise InputRefused(bag.path, f"no common time: {spans}; a clock is off")
        warnings.append(f"scans and odometry have no common time: {spans}")
    elif first_ns < start_ns or last_ns > end_ns:
        warnings.append(f"odometry does not cover all scans: {spans}")


def laser_mounting_of(
    tree: FrameTree, base_frame: str, laser_frame: str, warnings: list[str]
) -> FloatArray:
    """4 x 4 T_base_laser; from another base frame, or the identity, with a warning, if need be."""
    T_base_laser = tree.between(base_frame, laser_frame)
    if T_base_laser is not None:
        return T_base_laser
    for frame in _BASE_FRAMES:
        T_base_laser = tree.between(frame, laser_frame)
        if T_base_laser is not None:
            warnings.append(
                f"no fixed transform from {base_frame!r} to {laser_frame!r}: "
                f"the one from {frame!r} is used"
            )
            return T_base_laser
    warnings.append(
        f"no fixed transform from {base_frame!r} to {laser_frame!r} in /tf_static or /tf: "
        "the laser is taken to sit at the base"
    )
    return np.eye(4)


def imu_mounting_of(
    tree: FrameTree, base_frame: str, imu: ImuStream, warnings: list[str]
) -> FloatArray | None:
    """4 x 4 T_base_imu; None, with a warning, where no fixed transform tells."""
    T_base_imu = tree.between(base_frame, imu.frame_id)
    if T_base_imu is None:
        warnings.append(f"no fixed transform from {base_frame!r} to {imu.frame_id!r}")
    return T_base_imu


def epoch_in(bag: Bag, first_ns: int) -> Epoch:
    """As our own metadata say; else UNIX by the size of the stamps; else a clock tells."""
    declared = bag.metadata.get(_OWN_METADATA, {}).get("epoch")
    if declared == "simulation":
        return "simulation"
    guessed = epoch_of(first_ns)
    return "simulation" if guessed == "unknown" and bag.of_type(CLOCK) else guessed
