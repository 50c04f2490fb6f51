"""The map while the robot drives: drawn key frame by key frame, and anew where they have moved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slamsim.config.slam import MappingConfig
from slamsim.core.geometry import between, compose
from slamsim.core.types import Cloud, FloatArray, Grid, IntArray, PlanarTrajectory
from slamsim.slam.frontend.tracking import Step
from slamsim.slam.mapping.grid import Canvas

EVIDENCE = 5.0
"""A key frame stands for the scans until the next, of which there are at least so many: 5 Hz and
a metre or 30 degrees at usual speeds. Without this a cell is sure only after as many key frames."""
REDRAWN_PER_STEP = 4
"""Clouds drawn anew at each scan, beside the new one: at 10 Hz a map of 400 key frames is right
again ten seconds after a loop was closed, and no scan waits for it."""


class GrowingMap:
    """An occupancy grid of the scans that became key frames.

    When the back end moves them, a second canvas is begun, a few clouds at a time; it takes the
    place of the first once it holds all of them.
    """

    def __init__(self, config: MappingConfig) -> None:
        self._config = config = _weighed(config)
        self._clouds: list[Cloud] = []
        self._first_index: int | None = None
        self._placed: list[FloatArray] = []
        self._canvas = Canvas(config)
        self._next: Canvas | None = None
        self._redrawn = 0
        self.version = 0
        """Grows with each change of what ``grid`` gives."""

    def __len__(self) -> int:
        return len(self._clouds)

    @property
    def poses(self) -> FloatArray:
        """(n, 3) T_map_base of the key frames as known by now."""
        return np.array(self._placed).reshape(-1, 3)

    def add(self, step: Step) -> None:
        """What the next scan showed."""
        if step.cloud is not None and step.keyframe is not None and np.isfinite(step.T_map_base[0]):
            if self._first_index is None:
                self._first_index = step.keyframe
            self._clouds.append(_compact(step.cloud))
            self._placed.append(step.T_map_base)
            self._canvas.draw(step.cloud, step.T_map_base)
            self.version += 1
        if self._next is not None:
            self._redraw(self._next)

    def move(self, indices: IntArray, poses: FloatArray) -> None:
        """indices: (k,) of the key frames that the back end kept. poses: (k, 3) T_map_base of them.

        Those between two kept ones go with the first of the two.
        """
        if self._first_index is None or not len(indices):
            return
        kept = indices - self._first_index
        inside = (kept >= 0) & (kept < len(self._placed))
        kept, poses = kept[inside], poses[inside]
        if not len(kept):
            return
        before = self.poses
        holder = np.maximum(np.searchsorted(kept, np.arange(len(before)), side="right") - 1, 0)
        moved = compose(poses[holder], between(before[kept[holder]], before))
        self._placed = list(moved)
        self._next, self._redrawn = Canvas(self._config), 0

    def grid(self) -> Grid:
        """As drawn by now. Raises SlamsimError while there is nothing."""
        return self._canvas.grid()

    def settle(self, trajectory: PlanarTrajectory) -> None:
        """Draw all anew from the final ``T_map_base`` of the scans."""
        stamps_ns = np.array([cloud.stamp_ns for cloud in self._clouds], dtype=np.int64)
        self._placed = list(trajectory.at(stamps_ns))
        self._next, self._redrawn = Canvas(self._config), 0
        while self._next is not None:
            self._redraw(self._next)

    def _redraw(self, canvas: Canvas) -> None:
        end = min(self._redrawn + REDRAWN_PER_STEP, len(self._clouds))
        for number in range(self._redrawn, end):
            canvas.draw(_whole(self._clouds[number]), self._placed[number])
        self._redrawn = end
        if end == len(self._clouds):
            self._canvas, self._next = canvas, None
            self.version += 1


def _weighed(config: MappingConfig) -> MappingConfig:
    """With the evidence of each beam multiplied, in log odds."""
    share = {name: getattr(config, name) for name in ("hit_probability", "miss_probability")}
    odds = {name: (value / (1.0 - value)) ** EVIDENCE for name, value in share.items()}
    return config.model_copy(update={name: o / (1.0 + o) for name, o in odds.items()})


def _compact(cloud: Cloud) -> Cloud:
    """With a quarter of the memory: to a micrometre, which no cell shows."""
    return replace(
        cloud,
        points_m=cloud.points_m.astype(np.float32),
        origins_m=cloud.origins_m.astype(np.float32),
    )


def _whole(cloud: Cloud) -> Cloud:
    return replace(
        cloud,
        points_m=cloud.points_m.astype(np.float64),
        origins_m=cloud.origins_m.astype(np.float64),
    )
