"""Writes the files of a run's folder."""

from __future__ import annotations

from pathlib import Path

from slamsim.core.result import SlamResult
from slamsim.core.types import Grid, Trajectory
from slamsim.evaluate.budget import at_instants
from slamsim.guard.output import write_atomic
from slamsim.io.text.g2o import write_g2o
from slamsim.io.text.keyframes import write_keyframes
from slamsim.io.text.tum import write_tum
from slamsim.slam.mapping.map_files import map_files

TRAJECTORY, ODOMETRY, TRUTH = "trajectory.tum", "odometry.tum", "ground_truth.tum"
PARTS, KEYFRAMES, STATES = "parts", "keyframes.csv", "states.csv"
SAVED_MAP = "session.npz"
RECORDING, REPORT, REPORT_JSON = "run.rrd", "report.html", "report.json"


def write_truth(folder: Path, truth: Trajectory) -> None:
    """``ground_truth.tum``: ``T_map_base``."""
    write_tum(folder / TRUTH, truth)


def write_slam(folder: Path, result: SlamResult, *, sure: bool = True) -> None:
    """Trajectories and graph in the forms that other tools read.

    ``parts/``: what each part of SLAM made of the key frames, before the parts after it. sure:
    whether its covariances say anything, or no file is to claim them.
    """
    write_tum(folder / TRAJECTORY, result.trajectory)
    write_tum(folder / ODOMETRY, result.odometry)
    (folder / PARTS).mkdir()
    for name, part in result.parts.items():
        write_tum(
            folder / PARTS / f"{name}.tum", at_instants(part, result.graph.keyframes.stamps_ns)
        )
    if sure:
        write_keyframes(folder / KEYFRAMES, result.graph)
    write_g2o(folder / "graph.g2o", result.graph)


def write_map(folder: Path, grid: Grid) -> None:
    """``map.pgm`` and ``map.yaml`` as ROS map_server reads them, and ``map.png``."""
    for name, data in map_files(grid).items():
        write_atomic(folder / name, data)
