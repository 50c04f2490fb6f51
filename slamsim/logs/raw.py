"""The door through which a recording enters unmended, whatever its format."""

from __future__ import annotations

from pathlib import Path

from slamsim.logs.raw_carmen import read_carmen_recording
from slamsim.logs.reader import is_carmen, is_parquet_log, recording_at
from slamsim.logs.refusing import refusing
from slamsim.recording import Recording


def read_recording(path: Path, scan_topic: str | None = None) -> Recording:
    """What the recording at path says: CARMEN, ROS 1 bag, ROS 2 recording, Parquet
    tables of a data set, or a run's folder.

    The truth in it, if any, is never read. scan_topic: of several lidars only this one. Memory
    stays bounded: from a certain size on ranges live in a temporary file. Raises NotFound, or
    InputRefused naming file, place and reason when it cannot be read at all; what only some
    messages suffer from stands in ``Recording.odd`` and ``unread``.
    """
    path = recording_at(path)
    with refusing(path, "its contents"):
        if is_carmen(path):
            return read_carmen_recording(path, scan_topic)
        if is_parquet_log(path):
            from slamsim.logs.parquet_read import read_parquet_recording

            return read_parquet_recording(path)
        from slamsim.logs.raw_bag import read_bag_recording

        return read_bag_recording(path, scan_topic)
