"""Key frames with covariances as a table: one line each, upper triangle of the covariance."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from slamsim.core.result import PoseGraph
from slamsim.core.types import FloatArray, PlanarTrajectory
from slamsim.guard.errors import InputRefused
from slamsim.guard.output import write_atomic
from slamsim.guard.text import open_lines
from slamsim.io.text.stamps import decimal_from_stamp_ns, stamp_ns_from_decimal

HEADER = "time_s,x_m,y_m,yaw_rad,cov_xx,cov_xy,cov_xyaw,cov_yy,cov_yyaw,cov_yawyaw"
_UPPER = np.triu_indices(3)


def write_keyframes(path: Path, graph: PoseGraph) -> None:
    """``T_map_base`` of each key frame and the covariance of a small step of the base in its own
    frame, relative to the first key frame (m^2, m rad, rad^2)."""
    lines = [HEADER]
    rows = np.column_stack([graph.keyframes.poses, graph.covariances[:, *_UPPER]]).tolist()
    for stamp_ns, row in zip(graph.keyframes.stamps_ns.tolist(), rows, strict=True):
        numbers = ",".join(f"{value:.12g}" for value in row)
        lines.append(f"{decimal_from_stamp_ns(stamp_ns)},{numbers}")
    write_atomic(path, ("\n".join(lines) + "\n").encode())


def read_keyframes(path: Path) -> tuple[PlanarTrajectory, FloatArray]:
    """Poses (n, 3) and covariances (n, 3, 3). Raises InputRefused, naming the line, for anything
    but what ``write_keyframes`` writes."""
    stamps_ns: list[int] = []
    rows: list[list[float]] = []
    for number, line in open_lines(path):
        if number == 1 and line.strip() == HEADER:
            continue
        try:
            words = line.strip().split(",")
            values = [float(word) for word in words[1:]]
            if len(values) != 9 or not np.isfinite(values).all():
                raise ValueError("not nine finite numbers after the time")
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
    covariances = np.zeros((len(table), 3, 3))
    covariances[:, *_UPPER] = table[:, 3:]
    covariances[:, _UPPER[1], _UPPER[0]] = table[:, 3:]
    return PlanarTrajectory(np.array(stamps_ns, dtype=np.int64), table[:, :3]), covariances
