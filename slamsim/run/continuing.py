"""Continues the map of an earlier run."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slamsim.core.result import SlamResult
from slamsim.core.types import Cloud, FloatArray, Log
from slamsim.guard.errors import NotFound, OverrideRefused, shown
from slamsim.guard.files import own_file
from slamsim.run.folder import SAVED_MAP
from slamsim.slam.mapping.saved_map import SavedMap, read_saved_map


@dataclass(frozen=True, slots=True, eq=False)
class Earlier:
    """The map of an earlier run. start: (3,) T_map_base in it at the first scan, if known."""

    run: Path
    saved: SavedMap
    start: FloatArray | None

    def unjoined(self, saved: SavedMap, result: SlamResult, log: Log) -> str:
        """What to tell of a drive that shares nothing with the earlier ones, else nothing."""
        if len(saved) > len(result.graph.keyframes):  # joined
            return ""
        return (
            f"nothing of {self.run} was recognised: the two maps are not joined, and this folder "
            f"holds the new one alone; --start x,y,yaw_deg says where the drive began{again(log)}"
        )


def again(log: Log) -> str:
    """How to drive a second time where a simulated recording was made: another seed is another
    world."""
    if log.epoch != "simulation":
        return ""
    return (
        "; a second drive through one simulated world keeps its --seed and takes another "
        "--drive-seed: slamsim simulate WORLD --drive-seed 1"
    )


def read_earlier(run: Path, start: FloatArray | None) -> Earlier:
    """The map to go on with. start: (3,) x, y in metres and yaw in radians, if it is known.

    Raises NotFound, or InputRefused for a map that is damaged.
    """
    file = own_file(run, SAVED_MAP)
    if run.is_dir() and not file.is_file():
        raise NotFound(f"{run}: holds no {SAVED_MAP}; is it the folder of a mapped run?")
    return Earlier(run, read_saved_map(file if run.is_dir() else run), start)


def chosen_earlier(run: Path | None, start: str | None) -> Earlier | None:
    """What ``--continue`` and ``--start`` name. Raises as ``read_earlier`` and ``start_pose``."""
    if run is None:
        refuse_earlier(None, start)
        return None
    return read_earlier(run, start_pose(start))


def refuse_earlier(run: Path | None, start: str | None) -> None:
    """Raises OverrideRefused if one of the options is given where it has no meaning."""
    if run is not None:
        raise OverrideRefused("--continue", "needs a recording, not a world")
    if start is not None:
        raise OverrideRefused("--start", "needs --continue: it is a pose in that map")


def start_pose(typed: str | None) -> FloatArray | None:
    """(3,) of "x,y,yaw_deg", None for nothing. Raises OverrideRefused."""
    if typed is None:
        return None
    try:
        numbers = [float(word) for word in typed.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 3 or not all(math.isfinite(number) for number in numbers):
        raise OverrideRefused(
            "--start", f"{shown(typed)} is not x,y,yaw_deg: three numbers, as in 1.5,-2,90"
        )
    return np.array([numbers[0], numbers[1], math.radians(numbers[2])])


def clouds_before(saved: SavedMap, result: SlamResult) -> Iterator[tuple[Cloud, FloatArray]]:
    """What the key frames of earlier drives saw, and from where (3,), if they belong to the map."""
    earlier = len(saved) - len(result.graph.keyframes)
    for keyframe, T_map_base in zip(saved.keyframes[:earlier], saved.poses, strict=False):
        ends = keyframe.beams_m.astype(np.float64)
        origins = np.repeat(keyframe.origin_m[None], len(ends), axis=0)
        hit = np.ones(len(ends), dtype=np.bool_)
        yield Cloud(keyframe.stamp_ns, ends, origins, hit), T_map_base
