"""Data of a run that the Rerun recording and the report show, as plain values, and its numbers as
written to ``report.json``."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

import numpy as np

from slamsim.check.findings import CheckReport, Finding
from slamsim.check.wording import finding_json, warning
from slamsim.core.geometry import inverse
from slamsim.core.landmarks import Landmark
from slamsim.core.layers import NO_LAYERS, MapLayers
from slamsim.core.result import Calibrated, SlamResult
from slamsim.core.types import (
    BoolArray,
    FloatArray,
    Grid,
    IntArray,
    Log,
    PlanarTrajectory,
    Trajectory,
    TriangleMesh,
)
from slamsim.core.weighing import all_weighed
from slamsim.evaluate.grid import occupied
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
        """What is wrong with the recording itself, a sentence each, but for what was told, and
        done about, when it was read: as many messages of the same stream."""
        found = () if self.checked is None else self.checked.faults
        return tuple(warning(fault) for fault in found if not self._is_told(fault))

    @property
    def warnings(self) -> tuple[str, ...]:
        """All that may be wrong, the gravest first."""
        return all_weighed(self.result, (*self.doubts, *self.log.warnings))

    def _is_told(self, fault: Finding) -> bool:
        counted = re.match(r"[\d,]+ of [\d,]+ ", fault.words)
        begin = f"{fault.subject}: {counted[0]}" if counted else ""
        return bool(begin) and any(words.startswith(begin) for words in self.log.warnings)

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
    """(m,) evenly spread indices into ``count`` items, the first and the last always among them."""
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


_PATH_STEP_M = 0.1
"""Poses nearer than this to the last counted one do not lengthen a path, or noise would."""


def report_json(view: RunView) -> dict[str, object]:
    """Numbers under stable keys that carry their units; None where unknown.

    A number that is not finite is given as None, for JSON has none such.
    """
    result, grid = view.result, view.grid
    rows, columns = grid.occupancy.shape
    numbers: dict[str, object] = {
        "name": view.log.name,
        "verdict": view.verdict,
        **view.scores.numbers(),
        "path_length_m": path_length_m(_best_path(view)),
        "duration_s": view.duration_s,
        "scans": max(view.log.recorded_scans, len(view.log.scans)),
        "scans_used": len(result.trajectory),
        "keyframes": len(result.graph.keyframes),
        "loop_closures": result.closures_accepted,
        "loop_closures_rejected": result.closures_rejected,
        "match_quality_mean": _mean(result.match_quality),
        "degenerate_share": _mean(result.degenerate),
        "map_resolution_m": grid.resolution_m,
        "map_rows": rows,
        "map_columns": columns,
        "realtime_factor": realtime_factors(view),
        "seconds": dict(view.seconds),
        "slam_seconds": dict(result.seconds),
        "peak_memory_mb": view.peak_memory_mb,
        "error_budget": view.scores.budget_numbers(),
        "calibration": _calibration_json(result.calibration),
        "relations": view.scores.relation_numbers(),
        "sources": view.log.sources,
        "warnings": list(view.warnings),
        "checks": [] if view.checked is None else [*map(finding_json, view.checked.findings)],
        "command": view.command,
    }
    if result.calibration_beside:
        numbers["calibration_beside"] = {
            topic: _calibration_json(found) for topic, found in result.calibration_beside.items()
        }
    if result.landmarks:
        numbers["tags"] = [_tag_json(one) for one in result.landmarks]
    layers = view.layers
    if layers.obstacles is not None:
        numbers["obstacle_cells"] = int(np.count_nonzero(occupied(layers.obstacles.grid)))
        numbers |= {} if view.obstacles is None else view.obstacles.numbers()
    if layers.semantic is not None:
        numbers["semantic_cells"] = int(np.count_nonzero(layers.semantic.labels >= 0))
        numbers["semantic_images"] = layers.semantic.images
    return {key: _finite(value) for key, value in numbers.items()}


def _calibration_json(found: Mapping[str, Calibrated]) -> dict[str, object]:
    return {name: asdict(one) for name, one in found.items()}


def _tag_json(tag: Landmark) -> dict[str, object]:
    x_m, y_m, yaw_rad = tag.T_map_tag.tolist()
    return {
        "number": tag.number,
        "x_m": x_m,
        "y_m": y_m,
        "yaw_deg": math.degrees(yaw_rad),
        "covariance_m_rad": tag.covariance.tolist(),
        "seen": tag.seen,
        "doubted": tag.doubted,
        "surveyed": tag.is_surveyed,
    }


def realtime_factors(view: RunView) -> dict[str, float | None]:
    """Seconds of recording per second of work, for ``simulate``, ``slam`` and ``total``."""
    spent = {stage: view.seconds.get(stage) for stage in ("simulate", "slam", "total")}
    return {stage: view.duration_s / s if s else None for stage, s in spent.items()}


def path_length_m(trajectory: PlanarTrajectory) -> float:
    """Length of the path in steps of 0.1 m or more, so that noise at rest does not add up."""
    points = trajectory.poses[:, :2]
    if len(points) == 0:
        return 0.0
    length_m, last = 0.0, points[0]
    for point in points:
        step_m = math.hypot(point[0] - last[0], point[1] - last[1])
        if step_m >= _PATH_STEP_M:
            length_m, last = length_m + step_m, point
    return length_m


def _best_path(view: RunView) -> PlanarTrajectory:
    errors = view.scores.trajectory
    return view.result.trajectory if errors is None else errors.truth


def _mean(values: FloatArray | BoolArray) -> float | None:
    return float(np.mean(values)) if values.size else None


def _finite(value: object) -> object:
    if isinstance(value, dict):
        return {key: _finite(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_finite(inner) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
