"""The part of a recording that a user asks for: topics and the robot's frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from slamsim.guard.errors import OverrideRefused, nearest_name, shown
from slamsim.recording import RawImu, RawOdometry, RawScans, RawStream, Recording
from slamsim.recording.choice import holds, ranked, topics_of
from slamsim.recording.frame_graph import FrameGraph
from slamsim.recording.frames import frame_name


@dataclass(frozen=True, slots=True)
class Selection:
    """scans, odometry, imu: topics, of the others of the kind none is read; empty: any.

    base_frame: whose poses are estimated, empty for what odometry moves. cloud_height_m: lowest and
    highest return of point clouds that are read as scans, above the base frame.
    """

    scans: tuple[str, ...] = ()
    odometry: str = ""
    imu: str = ""
    base_frame: str = ""
    cloud_height_m: tuple[float, float] | None = None


EVERYTHING = Selection()


def selected(recording: Recording, wanted: Selection, path: Path) -> Recording:
    """What is wanted of a recording; of each kind the stream that is read comes first.

    Raises OverrideRefused for a topic that is not there or of another type, naming the nearest,
    and for a base frame to which no transforms lead.
    """
    of_kind: tuple[tuple[type[RawStream], str, tuple[str, ...]], ...] = (
        (RawScans, "--scan-topic", wanted.scans),
        (RawOdometry, "--odom-topic", (wanted.odometry,) if wanted.odometry else ()),
        (RawImu, "--imu-topic", (wanted.imu,) if wanted.imu else ()),
    )
    for kind, option, topics in of_kind:
        if topics:
            found = [_found(recording, kind, option, topic, path) for topic in topics]
            recording = _without_others(recording, kind, found)
    for kind, _, _ in of_kind:
        order = [topic.topic for topic in ranked(recording, kind)]
        streams = sorted(recording.of(kind), key=lambda each: order.index(each.topic))
        recording = recording.with_streams(kind, streams)
    if not wanted.base_frame:
        return recording
    return replace(recording, base_frame=_base(recording, frame_name(wanted.base_frame), path))


def _found(
    recording: Recording, kind: type[RawStream], option: str, wanted: str, path: Path
) -> str:
    """The topic of a kind as the file names it."""
    needed = kind.schema.type_name
    topics = [topic for topic in topics_of(recording) if topic.messages]
    there = [(t.topic, needed if holds(recording, t, kind) else t.type_name) for t in topics]
    spare = [each.stream for each in recording.unread if each.stream is not None]
    there += [(stream.topic, stream.schema.type_name) for stream in spare]
    right = [topic for topic, type_name in there if type_name == needed]
    asked = f"{option} {shown(wanted, 200)}"
    meant = [each for each in there if each[0].lstrip("/") == wanted.lstrip("/")]
    for topic, type_name in meant:
        if type_name == needed:
            return topic
    if not right:
        raise OverrideRefused(asked, f"{path} holds no {needed} at all")
    listing = ", ".join(right[:9])
    if meant:
        raise OverrideRefused(asked, f"holds {meant[0][1]}, {needed} is needed, as on {listing}")
    near = nearest_name(wanted, right, 0.0)
    reason = f"{path} has no such topic; the nearest of {needed} is {near}"
    raise OverrideRefused(asked, reason if len(right) == 1 else f"{reason}, of {listing}")


def _without_others(recording: Recording, kind: type[RawStream], chosen: list[str]) -> Recording:
    """Without the other topics of a kind, and with what else their messages carry.

    Odometry beside that of the scans (CARMEN) is read where it is chosen, or where the scans that
    are left carry none.
    """
    named = {each.topic for each in topics_of(recording) if holds(recording, each, kind)}
    dropped = named.difference(chosen)
    if kind is RawScans:
        streams = tuple(each for each in recording.streams if each.topic not in dropped)
    else:
        streams = tuple(
            each
            for each in recording.streams
            if not (isinstance(each, kind) and each.topic in dropped)
        )
    spare = tuple(each for each in recording.unread if each.stream is not None)
    if not any(isinstance(each, RawOdometry) for each in streams):
        streams += tuple(each.stream for each in spare if each.stream is not None)
    is_used = {each.topic for each in streams}
    return replace(
        recording,
        streams=streams,
        transforms=tuple(each for each in recording.transforms if each.topic not in dropped),
        unread=tuple(each for each in recording.unread if each.topic not in dropped | is_used),
        anomalies=tuple(
            words for words in recording.anomalies if words.partition(": ")[0] not in dropped
        ),
        topics=tuple(each for each in recording.topics if each.topic not in dropped),
    )


def _base(recording: Recording, frame: str, path: Path) -> str:
    """The frame, if scans and odometry are joined to it."""
    option = f"--base-frame {shown(frame, 200)}"
    graph = FrameGraph(recording.transforms)
    moved = [odometry.child_frame_ids[0] for odometry in recording.odometries[:1]]
    laser = [scans.frame_ids[0] for scans in recording.scans[:1]]
    if frame not in graph and frame not in moved + laser:
        near = graph.nearest(frame) or next(iter(moved), "")
        told = f"; the nearest is {near}" if near else ", and names no other one"
        raise OverrideRefused(option, f"{path} has no such frame{told}")
    for other in filter(None, (*moved, *laser)):
        if other != frame and not graph.connects(frame, other):
            reason = f"no transforms of {path} join {frame} to {other}"
            raise OverrideRefused(option, f"{reason}, only to {graph.listed(frame)}")
    return frame
