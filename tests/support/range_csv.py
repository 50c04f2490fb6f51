"""A planar format in one module: a CSV file of poses and ranges.

The first line has first angle, angle between beams and largest range; each further line a stamp in
seconds, the pose x, y, yaw of the robot, and the ranges, empty where nothing came back. The laser
sits at the base. ``import range_csv`` is all that it takes to read such files; in the package the
module would lie in ``slamsim/io/formats``.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from slamsim.core.geometry import xyzw_from_yaw
from slamsim.guard.errors import InputRefused
from slamsim.guard.unpacking import open_lines
from slamsim.io.formats import Contents, Format, Truth, register
from slamsim.io.text.tum import stamp_ns_from_decimal
from slamsim.recording import RawOdometry, RawScans, Recording, ScanLayout, TransformEdge
from slamsim.recording.cleaning.rising_stamps import epoch_of

NAME = "range csv"
_BASE, _LASER = "base_link", "laser"


def read_range_csv(path: Path) -> Recording:
    """What the file says, nothing changed. Raises InputRefused, naming the line."""
    lines = csv.reader(line for _, line in open_lines(path))
    first_rad, step_rad, range_max_m = map(float, next(lines))
    stamps, poses, rows = list[int](), list[list[float]](), list[np.ndarray]()
    for number, words in enumerate(lines, start=2):
        try:
            stamps.append(stamp_ns_from_decimal(words[0]))
            poses.append([float(word) for word in words[1:4]])
            rows.append(np.array([float(word or "inf") for word in words[4:]], dtype=np.float32))
        except (ValueError, IndexError) as error:
            raise InputRefused(path, str(error), f"line {number}") from error
    stamps_ns, path_m = np.array(stamps, dtype=np.int64), np.array(poses)
    layout = ScanLayout(
        first_rad, first_rad + step_rad * (len(rows[0]) - 1), step_rad, 0.0, 0.0, 0.0, range_max_m
    )
    layout_of = np.zeros(len(rows), dtype=np.int32)
    scans = RawScans("ranges", (_LASER,), stamps_ns, None, (layout,), layout_of, rows)
    none = np.full((len(rows), 3), np.nan)
    positions_m, quats_xyzw = path_m * [1.0, 1.0, 0.0], xyzw_from_yaw(path_m[:, 2])
    odometry = RawOdometry(
        *("ranges", ("odom",), stamps_ns, None, (_BASE,), positions_m, quats_xyzw, none, none),
        yaws_rad=path_m[:, 2],
    )
    laser = (stamps_ns[:1], None, np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]]))
    mounting = TransformEdge("ranges", _BASE, _LASER, True, *laser)
    epoch = epoch_of(stamps[0])
    return Recording(path.stem, NAME, (scans, odometry), (mounting,), epoch=epoch)


def _read(path: Path, _truth: Truth) -> Contents:
    return Contents(read_range_csv(path))


RANGE_CSV = Format(NAME, 4, _read, (".csv",), is_packable=True, about_files=".csv (of ranges)")
register(RANGE_CSV)
