"""Key frames with covariances as a table: one line each, upper triangle of the covariance."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from slamsim.core.result import PoseGraph
from slamsim.core.types import FloatArray, PlanarTrajectory
from slamsim.guard.errors import InputRefused
from slamsim.guard.output import write_atomic
from slamsim.guard.unpacking import open_lines
from slamsim.io.text.tum import decimal_from_stamp_ns, stamp_ns_from_decimal

HEADER = "time_s,x_m,y_m,yaw_rad,cov_xx,cov_xy,cov_xyaw,cov_yy,cov_yyaw,cov_yawyaw"
IN_MAP = ",map_xx,map_xy,map_xyaw,map_yy,map_yyaw,map_yawyaw"
"""Follows the header where covariances relative to the map as a whole are known."""

_UPPER = np.triu_indices(3)
_POSE = 3


def write_keyframes(path: Path, graph: PoseGraph) -> None:
    """``T_map_base`` of each key frame and the covariance of a small step of the base in its own
    frame, relative to the first key frame (m^2, m rad, rad^2); and, where it is known, relative to
    the map as a whole."""
    columns, header = [graph.keyframes.poses, graph.covariances[:, *_UPPER]], HEADER
    if graph.in_map is not None:
        columns, header = [*columns, graph.in_map[:, *_UPPER]], HEADER + IN_MAP
    lines = [header]
    rows = np.column_stack(columns).tolist()
    for stamp_ns, row in zip(graph.keyframes.stamps_ns.tolist(), rows, strict=True):
        numbers = ",".join(f"{value:.12g}" for value in row)
        lines.append(f"{decimal_from_stamp_ns(stamp_ns)},{numbers}")
    write_atomic(path, ("\n".join(lines) + "\n").encode())


def read_keyframes(path: Path) -> tuple[PlanarTrajectory, FloatArray, FloatArray | None]:
    """Poses (n, 3) and both covariances (n, 3, 3), None for the second where it is not told.

    Raises InputRefused, naming the line, for anything but what ``write_keyframes`` writes."""
    stamps_ns: list[int] = []
    rows: list[list[float]] = []
    count = _POSE + len(_UPPER[0])
    for number, line in open_lines(path):
        if number == 1 and line.strip() in (HEADER, HEADER + IN_MAP):
            count = line.count(",")
            continue
        try:
            words = line.strip().split(",")
            values = [float(word) for word in words[1:]]
            if len(values) != count or not np.isfinite(values).all():
                raise ValueError(f"not {count} finite numbers after the time")
            stamps_ns.append(stamp_ns_from_decimal(words[0]))
            if len(stamps_ns) > 1 and stamps_ns[-1] <= stamps_ns[-2]:
                raise ValueError(f"{words[0]} s is not after the line before")
        except ValueError as error:
            raise InputRefused(
                path, f"is not a table of key frames ({error})", f"line {number}"
            ) from None
        rows.append(values)
    if not rows:
        raise InputRefused(path, "there is no key frame in it")
    table = np.array(rows)
    track = PlanarTrajectory(np.array(stamps_ns, dtype=np.int64), table[:, :_POSE])
    relative, in_map = table[:, _POSE : _POSE + 6], table[:, _POSE + 6 :]
    return track, _symmetric(relative), _symmetric(in_map) if in_map.size else None


def _symmetric(upper: FloatArray) -> FloatArray:
    """(n, 3, 3) from the (n, 6) of upper triangles."""
    covariances = np.zeros((len(upper), 3, 3))
    covariances[:, *_UPPER] = upper
    covariances[:, _UPPER[1], _UPPER[0]] = upper
    return covariances
