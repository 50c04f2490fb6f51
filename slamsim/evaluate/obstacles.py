"""How much of what stands in the way, and the lidar's plane does not meet, a layer shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.core.geometry import transform_points, wrap_angle
from slamsim.core.layers import ObstacleLayer
from slamsim.core.types import BoolArray, FloatArray, Grid
from slamsim.evaluate.grid import (
    cell_centres,
    nearest_m,
    occupied,
    share,
    tolerance_m,
    wall_surface,
)
from slamsim.evaluate.visibility import seen_from


@dataclass(frozen=True, slots=True)
class ObstacleScores:
    """hidden_recall: of the true surface that only the body would meet, in the camera's view and
    behind nothing, the share that the layer shows within one cell; lidar_recall: that the lidar's
    map shows. hidden_cells: how many these are.
    precision: share of the layer's cells within one cell of something true. None: of nothing.
    """

    hidden_cells: int
    hidden_recall: float | None
    lidar_recall: float | None
    precision: float | None
    false_cells: int

    def numbers(self) -> dict[str, float | int | None]:
        """Under the keys of ``report.json``."""
        return {
            "obstacle_hidden_cells": self.hidden_cells,
            "obstacle_hidden_recall": self.hidden_recall,
            "obstacle_lidar_recall": self.lidar_recall,
            "obstacle_precision": self.precision,
            "obstacle_false_cells": self.false_cells,
        }


def score_obstacles(
    layer: ObstacleLayer,
    lidar: Grid,
    true_body: Grid,
    true_plane: Grid,
    T_truth_estimate: FloatArray,
) -> ObstacleScores:
    """lidar: the map. true_body: 1 where anything stands in the robot's way at any height,
    true_plane: at the lidar's height. T_truth_estimate: (3,) from the trajectories. Raises
    BadNumbers for an alignment that is none."""
    near_m = tolerance_m(true_body)
    plane = cell_centres(true_plane, true_plane.occupancy == 1.0)
    surface = cell_centres(true_body, wall_surface(true_body.occupancy))
    hidden = surface[nearest_m(surface, plane) > near_m]
    hidden = hidden[_in_view(hidden, layer, true_body, T_truth_estimate)]
    shown, mapped = (
        transform_points(T_truth_estimate, cell_centres(grid, occupied(grid)))
        for grid in (layer.grid, lidar)
    )
    body = cell_centres(true_body, true_body.occupancy == 1.0)
    is_true = nearest_m(shown, body) <= near_m
    return ObstacleScores(
        len(hidden),
        share(nearest_m(hidden, shown) <= near_m),
        share(nearest_m(hidden, mapped) <= near_m),
        share(is_true),
        int(np.count_nonzero(~is_true)),
    )


def _in_view(
    points_m: FloatArray, layer: ObstacleLayer, body: Grid, T_truth_estimate: FloatArray
) -> BoolArray:
    """Which points lie ahead of the camera in some image, near enough, and behind nothing."""
    found = np.zeros(len(points_m), dtype=np.bool_)
    places_m = transform_points(T_truth_estimate, layer.views[:, :2])
    for place_m, heading_rad in zip(places_m, layer.views[:, 2] + T_truth_estimate[2], strict=True):
        away_m = points_m - place_m
        off_rad = wrap_angle(np.arctan2(away_m[:, 1], away_m[:, 0]) - heading_rad)
        ahead_m = np.hypot(*away_m.T) * np.cos(off_rad)
        found |= (np.abs(off_rad) < layer.half_angle_rad) & (ahead_m < layer.max_depth_m)
    seen = seen_from(body, places_m, layer.max_depth_m)
    cells = np.floor((points_m - body.origin_m) / body.resolution_m).astype(np.int64)
    return found & seen[cells[:, 1], cells[:, 0]]
