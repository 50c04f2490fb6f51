"""Writes a recording as a rosbag2 folder with one MCAP file, whatever format it came from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from slamsim.core.types import Float32Array, IntArray
from slamsim.guard.errors import SlamsimError
from slamsim.io.bag2.folder import BagFolder, TopicKind
from slamsim.io.ros.encoding import Outgoing, outgoing
from slamsim.recording import RawScans, Recording
from slamsim.recording.edits.frames import with_odometry_edge


def as_ros(recording: Recording) -> Recording:
    """A CARMEN log in the words of REP 105 and REP 117; anything else as it is.

    Its laser lines carry the pose, which ROS asks the transform tree for, and write their
    maximum where nothing came back, which ROS takes for a wall.
    """
    if recording.format != "carmen":
        return recording
    found = recording.changed(RawScans, _without_maximum)
    for odometry in recording.odometries[:1]:
        found = with_odometry_edge(found, odometry)
    return found


def _without_maximum(scans: RawScans) -> RawScans:
    limits_m = [scans.layout(scan).range_max_m for scan in range(len(scans))]
    rows = [_freed(row, limit) for row, limit in zip(scans.ranges_m, limits_m, strict=True)]
    as_array = isinstance(scans.ranges_m, np.ndarray)
    return replace(scans, ranges_m=np.array(rows) if as_array and rows else rows)


def _freed(ranges_m: Float32Array, limit_m: float) -> Float32Array:
    return np.where(ranges_m >= np.float32(limit_m), np.float32(np.inf), ranges_m)


_WINDOW_BYTES = 32 << 20
_LARGEST_SECOND = 2**31 - 1


def write_recording(recording: Recording, folder: Path, attached: Sequence[Path] = ()) -> None:
    """Write into a folder, new or empty, what a recording holds.

    What ROS says in other words than the recording's format is written in these. attached: files
    that travel along in the MCAP file.

    Every stream keeps its order: a message that was received before the one above it is written
    as received with that one. Of several frames that the messages of one stream name, the
    first is written. Call it inside ``partial_folder``: after an exception the folder is
    unfinished. Raises SlamsimError for stamps that ROS 2 cannot write.
    """
    recording = as_ros(recording)
    streams = _named([o for o in outgoing(recording) if o.log_ns.size])
    _require_stamps(recording)
    kinds = {o.topic: TopicKind(o.topic, o.type_name, o.latched) for o in streams}
    custom = {"epoch": recording.epoch}
    with BagFolder(folder, list(kinds.values()), custom, attached) as bag:
        for begin_ns, end_ns in _windows(streams):
            batches = []
            for stream in streams:
                first, end = np.searchsorted(stream.log_ns, [begin_ns, end_ns]).tolist()
                if first < end:
                    rows = stream.rows(np.arange(first, end))
                    batches.append(bag.batch(stream.topic, stream.log_ns[first:end], rows))
            bag.write(batches)


def _windows(streams: list[Outgoing]) -> Iterator[tuple[int, int]]:
    """(begin, end) of log time, end excluded, that hold about as many bytes each."""
    if not streams:
        return
    log_ns = np.concatenate([stream.log_ns for stream in streams])
    sizes = np.repeat([o.message_bytes for o in streams], [o.log_ns.size for o in streams])
    order = np.argsort(log_ns, kind="stable")
    filled = np.cumsum(sizes[order]) // _WINDOW_BYTES
    first = np.flatnonzero(np.diff(filled, prepend=-1))
    begins = np.unique(log_ns[order][first])
    ends = np.append(begins[1:], int(log_ns.max()) + 1)
    yield from zip(begins.tolist(), ends.tolist(), strict=True)


def _named(streams: list[Outgoing]) -> list[Outgoing]:
    """Topics as ROS names them, each of one type: CARMEN has one line for scan and odometry."""
    taken: dict[str, str] = {}
    named = []
    for stream in streams:
        topic = stream.topic if stream.topic.startswith("/") else f"/{stream.topic}"
        if taken.setdefault(topic, stream.type_name) != stream.type_name:
            topic = f"{topic}/{stream.type_name.rsplit('/', maxsplit=1)[-1].lower()}"
            taken[topic] = stream.type_name
        named.append(replace(stream, topic=topic))
    return named


def _require_stamps(recording: Recording) -> None:
    stamps: list[tuple[str, IntArray]] = [
        (stream.topic, stream.stamps_ns) for stream in recording.streams
    ]
    for topic, stamps_ns in stamps:
        if stamps_ns.size and np.abs(stamps_ns).max() > _LARGEST_SECOND * 1_000_000_000:
            raise SlamsimError(
                f"{topic}: a stamp of {np.abs(stamps_ns).max() / 1e9:.0f} s cannot be written, "
                f"ROS 2 counts to {_LARGEST_SECOND} s"
            )
