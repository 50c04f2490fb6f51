"""Each stage made to fail in turn: what the stages before it made is there, and it is told."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from simulated import Simulated, ate_rmse_m, labyrinth, simulate
from typer.testing import CliRunner

from slamsim.cli.main import app
from slamsim.config.slam import SlamConfig
from slamsim.core.result import SlamResult
from slamsim.core.types import ScanGeometry
from slamsim.guard.errors import DiskFull
from slamsim.guard.numbers import NoSolution
from slamsim.slam.failures import Failures
from slamsim.slam.session import run_slam

SICK = ScanGeometry(-0.5 * np.pi, np.pi / 180.0, 181, 0, 0.1, 30.0)


@cache
def example() -> Simulated:
    walls, tour = labyrinth(seed=2, cells=3)
    return simulate(walls, tour, seed=2, geometry=SICK, gyro=False, max_s=30.0)


UNCALIBRATED = ("--set", "slam.calibrate_laser=false")
"""A third of the time of such a run, and no stage of those that fail here."""

STAGES = {
    "closures": "slamsim.slam.closures.closure.ClosureFinder.find",
    "solve": "slamsim.slam.backend.graph.PoseGraphSolver.solve",
    "calibrate": "slamsim.slam.backend.back_end.Recalibration",
    "refine": "slamsim.slam.backend.back_end.refine_keyframes",
    "check": "slamsim.slam.backend.back_end.tears",
    "smooth": "slamsim.slam.frontend.track.smooth",
    "map": "slamsim.run.mapping.build_grid",
    "report": "slamsim.report.pages.run.write_report",
}
"""What is made to fail to let a stage fail."""

ERRORS = [
    NoSolution("the information matrix is not positive definite at key frame 7", 7),
    np.linalg.LinAlgError("Singular matrix"),
    RuntimeError("Indeterminant linear system"),
]


def fails(monkeypatch: pytest.MonkeyPatch, stage: str, error: Exception) -> None:
    def failing(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(STAGES[stage], failing)


def result() -> SlamResult:
    return run_slam(example().log, SlamConfig(calibrate_laser=False))


@pytest.mark.long
@pytest.mark.parametrize("stage", ["closures", "solve", "calibrate", "refine", "check", "smooth"])
def test_a_stage_that_fails_leaves_the_work_of_those_before(
    monkeypatch: pytest.MonkeyPatch, stage: str
) -> None:
    error = ERRORS[len(stage) % len(ERRORS)]
    fails(monkeypatch, stage, error)
    slam = result()
    told = [one.stage for one in slam.failed]
    assert told == (["solve", "calibrate"] if stage == "solve" else [stage])  # which solves again
    assert 0 <= slam.failed[0].keyframe < len(slam.graph.keyframes)
    if isinstance(error, NoSolution):
        assert slam.failed[0].keyframe == 7
    assert slam.warnings[0].startswith(f"{stage} failed at key frame {slam.failed[0].keyframe}")
    assert len(slam.trajectory) > 250
    assert ate_rmse_m(slam.trajectory, example().truth) < 0.05
    assert (np.linalg.eigvalsh(slam.graph.covariances[1:]) > 0.0).all()


def test_all_of_them_failing_leaves_the_front_end(monkeypatch: pytest.MonkeyPatch) -> None:
    for stage in ("closures", "solve", "calibrate", "refine", "check", "smooth"):
        fails(monkeypatch, stage, ERRORS[1])
    monkeypatch.setattr("slamsim.slam.backend.back_end.variance_factor", lambda *_: 1.0 / 0.0)
    slam = result()
    told = {one.stage for one in slam.failed}
    assert told == {"closures", "solve", "calibrate", "refine", "covariances", "check", "smooth"}
    assert ate_rmse_m(slam.trajectory, example().truth) < 0.1
    assert (np.linalg.eigvalsh(slam.graph.covariances[1:]) > 0.0).all()


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    log = example().log
    assert log.odometry is not None
    lines = []
    for scan in log.scans:
        x, y, yaw = log.odometry.at(np.array([scan.stamp_ns]))[0]
        ranges = " ".join(f"{r:.3f}" if np.isfinite(r) else "81.91" for r in scan.ranges_m)
        pose = f"{x:.6f} {y:.6f} {yaw:.6f}"
        stamp = f"{1 + scan.stamp_ns * 1e-9:.6f}"
        lines.append(f"FLASER 181 {ranges} {pose} {pose} {stamp} host {stamp}\n")
    path = tmp_path / "small.clf"
    path.write_text("".join(lines))
    return path


@pytest.mark.long
@pytest.mark.parametrize("stage", [pytest.param("refine", marks=pytest.mark.slow), "map", "report"])
def test_a_run_with_a_failed_stage_is_on_disk_and_ends_with_1(
    monkeypatch: pytest.MonkeyPatch, recording: Path, tmp_path: Path, stage: str
) -> None:
    fails(monkeypatch, stage, ERRORS[0])
    out = tmp_path / "run"
    words = ["map", str(recording), "--json", "--out", str(out), *UNCALIBRATED]
    run = CliRunner().invoke(app, words)
    assert type(run.exception).__name__ == "SlamsimError"
    assert f"{stage} failed at key frame 7: the information matrix" in str(run.exception)
    report = json.loads((out / "report.json").read_text())
    told = [{"stage": stage, "keyframe": 7, "reason": str(ERRORS[0]), "times": 1}]
    assert report["failed_stages"] == told
    assert json.loads(run.stdout)["failed_stages"] == told
    assert (out / "trajectory.tum").stat().st_size > 10_000
    assert (out / "graph.g2o").is_file() and (out / "session.npz").is_file()
    assert (out / "map.pgm").is_file() == (stage != "map")
    assert (out / "report.html").is_file() == (stage == "refine")


def test_of_many_failures_of_a_stage_the_first_is_told() -> None:
    failures = Failures()
    for keyframe in (4, 9, 12):
        with failures.caught("closures", keyframe):
            raise ValueError(f"at {keyframe}")
    (told,) = failures
    words = "closures failed at key frame 4 and 2 times more: ValueError: at 4"
    assert (told.keyframe, told.times, str(told)) == (4, 3, words)


@pytest.mark.parametrize("error", [DiskFull("the disk is full"), PermissionError("no"), OSError(5)])
def test_a_disk_that_fails_ends_everything(error: Exception) -> None:
    with pytest.raises(type(error)), Failures().caught("map", 0):
        raise error
