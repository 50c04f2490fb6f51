"""The demonstration of the rotation bug, whole, on a short drive."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from slamsim.config.loading import load_run_config
from slamsim.console.reporter import Reporter
from slamsim.report.viewer.show import check_recording
from slamsim.run.demo import FAULT, rotation_bug


@pytest.mark.slow
def test_the_rotation_bug_is_shown_named_and_repaired(tmp_path: Path) -> None:
    settings = ["sensors.lidar.rate_hz=10", "drive.route.max_path_length_m=15"]
    config = load_run_config("labyrinth", overrides=settings, seed=3)
    folder = tmp_path / "demo"
    numbers = rotation_bug(config, folder, Reporter(quiet=True))
    assert numbers["faults"] == [FAULT]
    assert numbers["faults_left"] == []
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert page.count("<svg") >= 5
    assert FAULT in page
    for run in ("torn", "repaired"):
        report = json.loads((folder / run / "report.json").read_text(encoding="utf-8"))
        assert report["ate_rmse_m"] == numbers[f"{run}_ate_rmse_m"]
    seen = check_recording(folder / "run.rrd")
    assert not seen.errors
    assert len(seen.views) == 4
