"""ROS 1 bags and ROS 2 recordings, in MCAP and in SQLite."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

from slamsim.io.formats import Contents, Format, Survey, Truth, register
from slamsim.io.ros.parts import METADATA, part_files
from slamsim.recording import Recording
from slamsim.recording.clouds import CloudsWanted


def _read(path: Path, truth: Truth) -> Contents:
    from slamsim.io.ros.reader import read_ros

    return read_ros(path, truth)


def _survey(path: Path) -> Survey:
    from slamsim.io.ros.reader import survey_ros

    return survey_ros(path)


def _sliced(path: Path, recording: Recording, wanted: CloudsWanted) -> Recording:
    from slamsim.io.ros.clouds import with_slices

    return with_slices(path, recording, wanted)


def is_ros(path: Path) -> bool:
    """Whether a path is a recording of ROS 1 or 2."""
    return any(each.is_at(path) for each in (ROS2, ROS1, PARTS))


def _rosbag2(folder: Path) -> Path | None:
    return folder if (folder / METADATA).is_file() else None


def _parts(folder: Path) -> Path | None:
    """Several files of ROS 2 without metadata.yaml; whether they are one is seen when opened."""
    is_one = folder.is_dir() and _rosbag2(folder) is None and len(part_files(folder)) > 1
    return folder if is_one else None


def _checksums(path: Path) -> str:
    from slamsim.io.ros.bag import open_bag
    from slamsim.io.ros.sources import Bag1Source, McapSource

    with open_bag(path) as bag:
        if isinstance(bag.source, McapSource):
            return _of_mcap(bag.source.unchecked)
        if isinstance(bag.source, Bag1Source):
            return "chunks that are packed with bz2 have checksums, and they hold; others have none"
    return "nothing: SQLite recordings have no checksums, but their pages hang together"


def _of_mcap(unchecked: Counter[str]) -> str:
    lacking = [f"{what} ({count}x)" for what, count in sorted(unchecked.items()) if count]
    if not lacking:
        return "all that is in the MCAP files has checksums, and they hold"
    return f"checksums hold where there are any; without: {', '.join(lacking)}"


ROS2 = Format(
    name="ros 2",
    rank=1,
    read=_read,
    suffixes=(".mcap", ".db3"),
    is_packable=True,
    about_files=".mcap, .db3 (also .gz, .bz2 and .zst)",
    about_folders="rosbag2 with metadata.yaml",
    in_folder=_rosbag2,
    has_truth=True,
    checksums=_checksums,
    sampled=_survey,
    sliced=_sliced,
)
ROS1 = Format(
    name="ros 1",
    rank=3,
    read=_read,
    suffixes=(".bag",),
    is_packable=True,
    about_files=".bag (also packed)",
    has_truth=True,
    checksums=_checksums,
    sampled=_survey,
    sliced=_sliced,
)
PARTS = replace(
    ROS2,
    name="parts of ros 2",
    rank=4,
    suffixes=(),
    about_files="",
    about_folders="the numbered .mcap or .db3 files of one",
    in_folder=_parts,
)
register(ROS2)
register(ROS1)
register(PARTS)
