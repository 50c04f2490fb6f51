"""The door through which every recording enters, whatever its format."""

from __future__ import annotations

from pathlib import Path

from slamsim.core.types import Log, Trajectory
from slamsim.guard.errors import InputRefused, NotFound
from slamsim.guard.files import own_file
from slamsim.io.carmen.log import read_carmen
from slamsim.io.carmen.reader import read_carmen_recording
from slamsim.io.input_errors import damaged, refusing
from slamsim.io.names import LOG, TABLES
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
            from slamsim.io.parquet.reader import read_parquet_recording

            return read_parquet_recording(path)
        from slamsim.io.ros.reader import read_bag_recording

        return read_bag_recording(path, scan_topic)


_CARMEN_SUFFIXES = (".clf", ".log")
_BAG_SUFFIXES = (".mcap", ".db3", ".bag")
_COMPRESSIONS = (".gz", ".bz2")
_KNOWN = (
    "a log is .clf or .log (CARMEN, also .gz and .bz2), .mcap, .db3, .bag, "
    "or a folder: rosbag2 with metadata.yaml, one ROS 1 bag, or Parquet with scans.parquet"
)


def read_log(path: Path, scan_topic: str | None = None) -> Log:
    """The log at path: CARMEN, ROS 1 bag, ROS 2 recording, a folder of Parquet tables as data sets
    have it, or a run's folder that holds one.

    The truth in it, if any, is never read. scan_topic chooses one of several lidars; without it
    the one with the most scans is taken and ``Log.warnings`` says so. Raises NotFound, or
    InputRefused naming file, place and reason.
    """
    path = recording_at(path)
    with refusing(path, "its contents"):
        if is_carmen(path):
            return read_carmen(path, scan_topic)
        if is_parquet_log(path):
            from slamsim.io.parquet.reader import read_parquet

            return read_parquet(path)
        from slamsim.io.ros.bag_log import read_bag

        return read_bag(path, scan_topic)


def read_truth(path: Path) -> Trajectory | None:
    """``T_map_base`` as the simulator recorded it, or None for a log without truth."""
    path = recording_at(path)
    if is_carmen(path) or is_parquet_log(path):
        return None
    from slamsim.io.ros.bag_log import read_bag_truth

    with refusing(path, "its truth"):
        return read_bag_truth(path)


def is_carmen(path: Path) -> bool:
    """Whether the name is that of a CARMEN log."""
    name = path.with_suffix("") if path.suffix.lower() in _COMPRESSIONS else path
    return path.is_file() and name.suffix.lower() in _CARMEN_SUFFIXES


def is_parquet_log(path: Path) -> bool:
    """Whether a folder holds a recording as Parquet tables."""
    return path.is_dir() and (path / "scans.parquet").is_file()


def recording_at(path: Path) -> Path:
    """The recording that a path means; InputRefused when it can be none."""
    if not path.exists():
        raise NotFound(f"{path}: there is no such file or folder")
    if path.is_dir():
        for name in (".", LOG):
            if (path / name / "metadata.yaml").is_file():
                return own_file(path, name)
        for name in (".", TABLES):
            if is_parquet_log(path / name):
                return own_file(path, name)
        bags = [file for file in path.iterdir() if file.suffix == ".bag"]
        if len(bags) == 1:
            return own_file(path, bags[0].name)
        if any(file.suffix in (".mcap", ".db3") for file in path.iterdir()):
            raise damaged(path, "there is no metadata.yaml in this folder")
        raise InputRefused(path, f"there is no metadata.yaml in this folder; {_KNOWN}")
    if not is_carmen(path) and path.suffix.lower() not in _BAG_SUFFIXES:
        raise InputRefused(path, f"{path.suffix or 'no suffix'} is no known kind of log; {_KNOWN}")
    return path
