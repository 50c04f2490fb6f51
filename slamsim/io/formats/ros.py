"""ROS 1 bags and ROS 2 recordings, in MCAP and in SQLite."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from slamsim.io.formats import Contents, Format, Survey, Truth, register
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
    return ROS2.is_at(path) or ROS1.is_at(path)


def _rosbag2(folder: Path) -> Path | None:
    return folder if (folder / "metadata.yaml").is_file() else None


def _only_bag(folder: Path) -> Path | None:
    bags = [file for file in folder.iterdir() if file.suffix == ".bag"] if folder.is_dir() else []
    return bags[0] if len(bags) == 1 else None


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
    about_folders="one ROS 1 bag",
    in_folder=_only_bag,
    has_truth=True,
    checksums=_checksums,
    sampled=_survey,
    sliced=_sliced,
)
register(ROS2)
register(ROS1)
