"""How far the odometry of a depth camera drifts in a simulated drive."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from slamsim.config.loading import load_run_config
from slamsim.config.run import RunConfig
from slamsim.console.reporter import Reporter
from slamsim.guard.errors import SlamsimError
from slamsim.io.names import LOG
from slamsim.run.cameras.odometry import camera_odometry
from slamsim.run.recording import record
from slamsim.run.stages import Stages

Figures = dict[str, object]

WORLD, CAMERA = "gallery", "realsense_d435"
"""Textures as they are by default."""
SECONDS = 25.0
"""Some 10 m with turns."""


def measure_odometry(config: RunConfig, reporter: Reporter) -> Figures:
    """What the path is off at its end, in percent of its length, and how many images were lost."""
    length = f"drive.route.max_duration_s={SECONDS}"
    driven = load_run_config(WORLD, CAMERA, (length,), config.seed)
    with TemporaryDirectory() as folder:
        record(driven, Path(folder), Stages(reporter))
        path = camera_odometry(Path(folder) / LOG, Path(folder) / "odometry", reporter)
    if path.errors is None:
        raise SlamsimError(f"the drive through {WORLD} has no truth")
    return {
        "odometry_drift_percent": path.errors.drift_percent,
        "odometry_ate_m": path.errors.ate_rmse_m,
        "odometry_lost_images": path.lost_frames,
    }
