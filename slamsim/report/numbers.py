"""All numbers of a run, as written to ``report.json``."""

from __future__ import annotations

import math
from dataclasses import asdict

import numpy as np

from slamsim.check.wording import finding_json
from slamsim.core.landmarks import Landmark
from slamsim.core.types import BoolArray, FloatArray, PlanarTrajectory
from slamsim.evaluate.grid import occupied
from slamsim.report.run_view import RunView

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
        "calibration": {name: asdict(one) for name, one in result.calibration.items()},
        "relations": view.scores.relation_numbers(),
        "sources": view.log.sources,
        "warnings": [*view.doubts, *view.log.warnings, *result.warnings],
        "checks": [] if view.checked is None else [*map(finding_json, view.checked.findings)],
        "command": view.command,
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
