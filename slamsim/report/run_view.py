"""Data of a run that the Rerun recording and the report show, as plain values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from slamsim.check.findings import CheckReport
from slamsim.check.wording import warning
from slamsim.core.geometry import inverse
from slamsim.core.layers import NO_LAYERS, MapLayers
from slamsim.core.result import SlamResult
from slamsim.core.types import FloatArray, Grid, IntArray, Log, Trajectory, TriangleMesh
from slamsim.evaluate.obstacles import ObstacleScores
from slamsim.evaluate.score import Scores


@dataclass(frozen=True, slots=True, eq=False)
class RunView:
    """One run as a person sees it; truth, walls and true grid are None where they are unknown.

    scores must come from these very values. seconds: wall-clock time per stage, of which
    ``simulate`` (driving, sensing and writing the log), ``slam`` and ``total`` give the real-time
    factors; the rest is shown as it is named. command: how to reproduce the run. config_yaml:
    the resolved configuration. checked: what a quick look at the
    recording itself found. verdict: on the map, in one sentence. sure: whether the covariances of
    key frames say anything of where they are. layers: what images add to the map; obstacles: how
    true that is, where the world is known; label_names: what labels mean, where that is known.
    """

    log: Log
    result: SlamResult
    grid: Grid
    scores: Scores = field(default_factory=Scores)
    truth: Trajectory | None = None
    walls: TriangleMesh | None = None
    truth_grid: Grid | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)
    peak_memory_mb: float | None = None
    command: str = ""
    config_yaml: str = ""
    checked: CheckReport | None = None
    verdict: str = ""
    sure: bool = True
    layers: MapLayers = NO_LAYERS
    obstacles: ObstacleScores | None = None
    label_names: Mapping[int, str] = field(default_factory=dict)

    @property
    def mapped(self) -> bool:
        """Whether there is an estimate beside the odometry: SLAM was asked for one."""
        return self.result.trajectory is not self.result.odometry

    @property
    def doubts(self) -> tuple[str, ...]:
        """What is wrong with the recording itself, a sentence each."""
        return () if self.checked is None else tuple(map(warning, self.checked.faults))

    @property
    def begin_ns(self) -> int:
        """The earliest instant of anything that is shown over time: shown as zero."""
        streams = (self.result.trajectory, self.log.odometry, self.log.imu, self.log.encoders)
        stamps_ns = [s.stamps_ns[0] for s in streams if s is not None and s.stamps_ns.size]
        return int(min(stamps_ns, default=0))

    @property
    def duration_s(self) -> float:
        stamps_ns = self.result.trajectory.stamps_ns
        return float(stamps_ns[-1] - stamps_ns[0]) * 1e-9 if stamps_ns.size else 0.0

    @property
    def lidar_range_m(self) -> float:
        """How far the lidar sees; without any scan, without end."""
        first = next(iter(self.log.scans), None)
        return math.inf if first is None else first.geometry.range_max_m

    @property
    def truth_in_map(self) -> FloatArray:
        """``T_map_truth`` (3,): where the true world lies in the map; identity without truth."""
        errors = self.scores.trajectory
        return np.zeros(3) if errors is None else inverse(errors.T_truth_estimate)


def thinned(count: int, at_most: int) -> IntArray:
    """Evenly spread indices into ``count`` items, the first and the last always among them."""
    if count <= at_most:
        return np.arange(count, dtype=np.int64)
    return np.unique(np.linspace(0, count - 1, at_most).round().astype(np.int64))


def wall_outline(mesh: TriangleMesh, height_m: float) -> FloatArray:
    """(n, 2, 2) segments in which a horizontal plane cuts the walls.

    A vertex in the plane counts as below it, so that every triangle is cut in two points or
    not at all.
    """
    corners = mesh.vertices_m[mesh.triangles]
    above = corners[:, :, 2] > height_m
    cut = above.any(axis=1) & ~above.all(axis=1)
    corners, above = corners[cut], above[cut]
    # Turn each triangle so that its first corner is alone on its side of the plane.
    alone = np.where(above.sum(axis=1) == 1, above.argmax(axis=1), above.argmin(axis=1))
    order = (alone[:, None] + np.arange(3)) % 3
    corners = np.take_along_axis(corners, order[:, :, None], axis=1)
    first, others = corners[:, :1], corners[:, 1:]
    fraction = (height_m - first[:, :, 2:]) / (others[:, :, 2:] - first[:, :, 2:])
    return np.asarray(first[:, :, :2] + fraction * (others[:, :, :2] - first[:, :, :2]))


def outline_height_m(view: RunView) -> float:
    """The height of the lidar, at which the walls are cut."""
    return float(view.log.T_base_laser[2, 3])
