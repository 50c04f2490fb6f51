"""Which topic of several of a kind is read, and why."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from slamsim.core.types import FloatArray
from slamsim.recording import (
    RawImu,
    RawOdometry,
    RawScans,
    RawStream,
    RawTicks,
    RecordedTopic,
    Recording,
)
from slamsim.recording.frames import FrameTree, base_frame_of, mounting_beside, odometry_chain

_FUSED = re.compile(r"filter|[eu]kf|fus(ed|ion)|locali[sz]", re.IGNORECASE)
"""In the usual topic names of estimators that merge wheels and gyroscope (robot_localization)."""
CLOUD, ECHOES = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/MultiEchoLaserScan"
_KINDS: tuple[tuple[str, type[RawStream], str], ...] = (
    ("scans", RawScans, "--scan-topic"),
    ("odometry", RawOdometry, "--odom-topic"),
    ("IMU readings", RawImu, "--imu-topic"),
    ("wheel counts", RawTicks, ""),
)


@dataclass(frozen=True, slots=True)
class Choice:
    """What is read of one kind, from which topics.

    others: further topics of it; why: not these, in words.
    option: of the command line, which chooses another. notes: how what is read was made of other
    messages, topic by topic.
    """

    what: str
    topics: tuple[str, ...]
    others: tuple[str, ...] = ()
    why: str = ""
    option: str = ""
    notes: tuple[str, ...] = ()

    def __str__(self) -> str:
        beside = f" (not {', '.join(self.others)}{self.why})" if self.others else ""
        made = f" ({'; '.join(self.notes)})" if self.notes else ""
        return f"{self.what} from {' and '.join(self.topics)}{made}{beside}"


def choices(recording: Recording) -> tuple[Choice, ...]:
    """What ``clean`` reads of each kind that is there."""
    found = []
    for what, kind, option in _KINDS:
        topics = [topic.topic for topic in ranked(recording, kind)]
        if topics:
            why = _why(recording, topics) if kind is RawOdometry else ""
            used = _together(recording) if kind is RawScans and lidars(recording) else topics[:1]
            others = tuple(topic for topic in topics if topic not in used)
            made = {scans.topic: scans.note for scans in recording.scans if scans.note}
            notes = tuple(made[topic] for topic in used if topic in made)
            found.append(Choice(what, tuple(used), others, why, option, notes))
        elif kind is RawOdometry and (edges := odometry_edges(recording)):
            found.append(Choice(what, (f"the transforms {edges[0][0]} -> {edges[-1][1]}",)))
    return tuple(found)


def in_words(found: Sequence[Choice]) -> str:
    """One sentence about all of them; empty without any."""
    options = [choice.option for choice in found if choice.others and choice.option]
    hint = f"; {' or '.join(options)} chooses another" if options else ""
    return f"Reading {', '.join(map(str, found))}{hint}" if found else ""


def ranked(recording: Recording, kind: type[RawStream]) -> list[RecordedTopic]:
    """The topics of a kind that hold messages, the one to be read first.

    The one with the most messages leads, with four exceptions. Topics in the namespace of the scans
    come first, for there may be several robots. Scans that carry a pose themselves
    (CARMEN) come before others, then those of lidars that a transform places. Of odometries, one in
    a map's frame comes last, because it jumps when the map is corrected; one whose name says that
    it is fused comes after a raw one if an IMU was recorded, whose readings it would bring in a
    second time, and before it if none was.
    """
    found = [t for t in topics_of(recording) if t.messages and holds(recording, t, kind)]
    placed = {edge.child for edge in recording.transforms}
    found.sort(key=lambda topic: (-topic.messages, topic.topic.count("/"), topic.topic))
    if kind is RawScans:
        carried = {odometry.topic for odometry in recording.odometries}
        known = {scans.topic: not placed.isdisjoint(scans.frame_ids) for scans in recording.scans}
        found.sort(key=lambda topic: (topic.topic not in carried, not known.get(topic.topic)))
    else:
        robots = {_namespace(topic.topic) for topic in ranked(recording, RawScans)[:1]}
        found.sort(key=lambda topic: _namespace(topic.topic) not in robots)
    if kind is RawOdometry:
        has_imu = bool(recording.imus)
        found.sort(
            key=lambda topic: (
                topic.topic in _in_map(recording),
                _is_fused(topic.topic) == has_imu,
            )
        )
        scans = ranked(recording, RawScans)[:1]
        found.sort(key=lambda topic: topic.topic not in {each.topic for each in scans})
    return found


def holds(recording: Recording, topic: RecordedTopic, kind: type[RawStream]) -> bool:
    """Whether a topic holds streams of a kind, as others do of which scans were made."""
    if kind is RawScans and topic.type_name != kind.schema.type_name:
        return any(scans.topic == topic.topic for scans in recording.scans)
    return topic.type_name == kind.schema.type_name


def clouds_to_read(recording: Recording, scan_topics: Sequence[str]) -> tuple[str, ...]:
    """The topics of point clouds of which scans shall be made: those that are asked for, or all
    of a recording without scans."""
    there = [topic for topic in topics_of(recording) if topic.messages]
    clouds = [topic.topic for topic in there if topic.type_name == CLOUD]
    asked = {topic.lstrip("/") for topic in scan_topics}
    named = tuple(topic for topic in clouds if topic.lstrip("/") in asked)
    has_scans = any(holds(recording, topic, RawScans) for topic in there)
    return named or (() if has_scans else tuple(clouds))


def without_scans(topics: Iterable[RecordedTopic]) -> str:
    """Why the point clouds of a recording without scans are none, or what is no message of ROS, as
    the end of a sentence."""
    there = tuple(topics)
    clouds = [each for each in there if each.type_name == CLOUD and each.damage]
    return f"; {clouds[0].topic}: {clouds[0].damage}" if clouds else not_of_ros(there)


def not_of_ros(topics: Iterable[RecordedTopic]) -> str:
    """What to do about messages of other schemas (nav2d.Scan), as the end of a sentence."""
    types = {each.type_name for each in topics if each.messages and each.type_name}
    if not types or any("/" in type_name for type_name in types):
        return ""
    return (
        "; only messages of ROS, and in Foxglove's schemas LaserScan, Odometry, FrameTransform and "
        "those of cameras and clouds, are read: write others as such"
    )


def lidars(recording: Recording) -> list[RawScans]:
    """The scans of each lidar, those that are read first first."""
    order = {topic.topic: rank for rank, topic in enumerate(ranked(recording, RawScans))}
    found = [scans for scans in recording.scans if scans.topic in order and scans.frame_ids]
    return sorted(found, key=lambda scans: order[scans.topic])


def lidars_beside(recording: Recording) -> list[RecordedTopic]:
    """The topics of further lidars. In a log of CARMEN whose first lidar comes with poses, lines
    without are the same scans once more."""
    carried = {odometry.topic for odometry in recording.odometries}
    topics = ranked(recording, RawScans)
    with_poses = any(topic.topic in carried for topic in topics[:1])
    return [topic for topic in topics[1:] if topic.topic in carried or not with_poses]


def _together(recording: Recording) -> list[str]:
    """The topics of lidars that are read together, as ``mounting_beside`` lets them."""
    first, *others = lidars(recording)
    if not others:  # transforms of hours take 150 MB to look through
        return [first.topic]
    tree, base_frame = FrameTree(), base_frame_of(recording)
    tree.add(recording.transforms)
    beside = {first.topic, *(topic.topic for topic in lidars_beside(recording))}
    places: dict[str, FloatArray] = {}
    for scans in (each for each in (first, *others) if each.topic in beside):
        found = mounting_beside(tree, base_frame, scans.frame_ids[0], places)
        if not isinstance(found, str):
            places[scans.topic] = found
        elif scans is first:
            return [first.topic]
    return list(places)


def topics_of(recording: Recording) -> tuple[RecordedTopic, ...]:
    """What the file holds, of a format that does not list it the streams."""
    return recording.topics or tuple(
        RecordedTopic(each.topic, each.schema.type_name, len(each)) for each in recording.streams
    )


def _in_map(recording: Recording) -> set[str]:
    odometries = recording.odometries
    return {each.topic for each in odometries if any(f.endswith("map") for f in each.frame_ids)}


def _namespace(topic: str) -> str:
    """Of the robot, where topics are named after it: ``robot1`` of ``/robot1/scan``."""
    return topic.strip("/").partition("/")[0]


def _is_fused(topic: str) -> bool:
    return _FUSED.search(topic) is not None


def _why(recording: Recording, topics: Sequence[str]) -> str:
    """Why the first odometry is taken and none of the others."""
    first, others = topics[0], topics[1:]
    reasons = []
    if any(map(_is_fused, others)) and not _is_fused(first) and recording.imus:
        reasons.append("fused odometry would count the IMU twice")
    if _is_fused(first) and not all(map(_is_fused, others)):
        reasons.append("without an IMU, fused odometry knows the turns best")
    if _in_map(recording).intersection(others):
        reasons.append("odometry in a map's frame jumps")
    return f": {', '.join(reasons)}" if reasons else ""


def odometry_edges(recording: Recording) -> list[tuple[str, str]]:
    """(parent, child) of the transforms that are odometry, from its frame down to the base."""
    tree = FrameTree()
    tree.add(recording.transforms)
    laser_frames = [scans.frame_ids[0] for scans in recording.scans if scans.frame_ids]
    return odometry_chain(tree, laser_frames[0] if laser_frames else "")
