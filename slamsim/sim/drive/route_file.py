"""Route files of users: poses or twists, as YAML or CSV."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from slamsim.config.base import Config
from slamsim.config.loading import load_model
from slamsim.config.world import FARTHEST_M
from slamsim.core.types import FloatArray
from slamsim.guard.errors import InputRefused
from slamsim.guard.limits import LIMITS
from slamsim.guard.unpacking import open_lines

POSE_COLUMNS = (("x_m", "y_m"), ("x_m", "y_m", "yaw_rad"), ("x_m", "y_m", "yaw_deg"))
TWIST_COLUMNS = ("t_s", "v_m_s", "w_rad_s")


@dataclass(frozen=True, slots=True, eq=False)
class PoseRoute:
    """Places to drive to in turn: points_m (n, 2) in the map frame; yaws_rad (n,), nan for any."""

    points_m: FloatArray
    yaws_rad: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class TwistRoute:
    """Rows of (t_s, v_m_s, w_rad_s), (n, 3), the times growing from 0; the last row is the end."""

    twists: FloatArray


class PoseRow(Config):
    """A place to drive to, in the map frame."""

    x_m: float = Field(ge=-1e5, le=1e5)
    """Position."""
    y_m: float = Field(ge=-1e5, le=1e5)
    """Position."""
    yaw_deg: float | None = Field(default=None, ge=-360.0, le=360.0)
    """Heading to turn to there; without one, any."""


class TwistRow(Config):
    """A command, held until the next row's time."""

    t_s: float = Field(ge=0.0, le=1e6)
    """Time since the end of the first standstill."""
    v_m_s: float = Field(ge=-100.0, le=100.0)
    """Forward speed."""
    w_rad_s: float = Field(ge=-100.0, le=100.0)
    """Turning rate."""


class RouteFile(Config):
    """Either poses or twists."""

    poses: Annotated[tuple[PoseRow, ...], Field(strict=False, max_length=LIMITS.route_rows)] = ()
    """Places to drive to, straight from one to the next."""
    twists: Annotated[tuple[TwistRow, ...], Field(strict=False, max_length=LIMITS.route_rows)] = ()
    """Commands over time; the last row only tells when the route ends."""

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if bool(self.poses) == bool(self.twists):
            raise ValueError("a route file holds either poses or twists, and at least one row")
        return self


def read_route(path: Path) -> PoseRoute | TwistRoute:
    """The route in a .csv file, or else a YAML file; raises NotFound or InputRefused."""
    if path.suffix.lower() == ".csv":
        return _read_csv(path)
    file = load_model(RouteFile, path)
    if file.poses:
        yaws = [math.nan if row.yaw_deg is None else row.yaw_deg for row in file.poses]
        return PoseRoute(np.array([(p.x_m, p.y_m) for p in file.poses]), np.radians(yaws))
    return _checked(np.array([(t.t_s, t.v_m_s, t.w_rad_s) for t in file.twists]), path)


def _read_csv(path: Path) -> PoseRoute | TwistRoute:
    lines = (
        (number, [word.strip() for word in line.split(",")])
        for number, line in open_lines(path)
        if line.strip() and not line.lstrip().startswith("#")
    )
    number, header = next(lines, (1, []))
    columns = tuple(header)
    if columns not in (*POSE_COLUMNS, TWIST_COLUMNS):
        raise InputRefused(
            path,
            "the first line must name the columns: x_m,y_m or x_m,y_m,yaw_rad or x_m,y_m,yaw_deg "
            "or t_s,v_m_s,w_rad_s",
            f"line {number}",
        )
    most = LIMITS.route_rows
    rows = [_row(words, len(columns), path, number) for number, words in islice(lines, most + 1)]
    if not rows:
        raise InputRefused(path, "has 0 rows below the names of its columns")
    if len(rows) > most:
        reason = f"has more than {most:,} rows, a route has at most {most:,}"
        raise InputRefused(path, reason, limit="route_rows")
    table = np.array(rows)
    if np.abs(table).max() > FARTHEST_M and columns != TWIST_COLUMNS:
        raise InputRefused(path, f"a pose lies beyond {FARTHEST_M:g} m")
    if columns == TWIST_COLUMNS:
        return _checked(table, path)
    yaws = table[:, 2] if len(columns) == 3 else np.full(len(table), math.nan)
    return PoseRoute(table[:, :2], np.radians(yaws) if "yaw_deg" in columns else yaws)


def _row(words: list[str], count: int, path: Path, number: int) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    if len(values) != count or not all(math.isfinite(value) for value in values):
        raise InputRefused(path, f"expected {count} finite numbers", f"line {number}")
    return values


def _checked(twists: FloatArray, path: Path) -> TwistRoute:
    if twists[0, 0] != 0.0 or np.any(np.diff(twists[:, 0]) <= 0.0) or len(twists) < 2:
        raise InputRefused(path, "twists need at least 2 rows with t_s growing from 0")
    return TwistRoute(twists)
