"""Writes an edited recording as a copy of its source file, in any format."""

from __future__ import annotations

import re
from pathlib import Path

from slamsim.guard.errors import SlamsimError
from slamsim.io.bag2.writer import write_recording
from slamsim.io.copy.rewrite import Copied, rewrite_recording
from slamsim.io.formats.parquet import PARQUET
from slamsim.io.formats.ros import is_ros
from slamsim.io.open import recording_at
from slamsim.recording import Recording

_TABLES = re.compile(r"(scans|imu|encoders|joints|odometry|transforms)(_\d+)?\.parquet")
"""What ``read_recording`` takes out of a folder of Parquet tables."""


class Lossy(SlamsimError):
    """The format of the copy cannot hold everything that the recording holds."""


def require_lossless(path: Path) -> None:
    """Raises Lossy, naming what a copy of this recording could not hold."""
    if lost := lost_in_copy(path):
        raise Lossy(
            f"{path}: a copy in rosbag2 cannot hold {', '.join(lost)}; "
            "with --lossy it is written without"
        )


def lost_in_copy(path: Path) -> tuple[str, ...]:
    """What of a recording has no place in the format of its copy."""
    path = recording_at(path)
    if not PARQUET.is_at(path):
        return ()
    names = sorted(file.name for file in path.iterdir() if not file.name.startswith("."))
    return tuple(name for name in names if not _TABLES.fullmatch(name))


def copy_recording(path: Path, read: Recording, edited: Recording, folder: Path) -> Copied:
    """Write ``edited``, made of ``read``, which was read from path, into a new or empty folder.

    A ROS recording is copied as ``rewrite_recording`` does. A CARMEN log becomes a rosbag2
    recording that carries the log itself as an attachment, so that no line is lost; Parquet tables
    become one without what ``lost_in_copy`` names. Raises as ``rewrite_recording`` does.
    """
    path = recording_at(path)
    if is_ros(path):
        return rewrite_recording(path, read, edited, folder)
    attached = [path] if path.is_file() else []
    write_recording(edited, folder, attached)
    return Copied(attached=tuple(file.name for file in attached), lost=lost_in_copy(path))
