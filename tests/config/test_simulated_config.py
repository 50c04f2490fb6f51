"""How a recording was simulated is told by the file beside it, also by one of another version."""

from __future__ import annotations

from pathlib import Path

import pytest

from slamsim.config.dump import dump_commented_yaml
from slamsim.config.loading import load_run_config, load_simulated_config
from slamsim.config.slam import SlamConfig
from slamsim.guard.errors import SlamsimError


def test_settings_of_slam_that_are_no_more_do_not_matter(tmp_path: Path) -> None:
    made = load_run_config("tiny", overrides=["sensors.lidar.rate_hz=7"], seed=5)
    file = tmp_path / "config.yaml"
    text = dump_commented_yaml(made.model_copy(update={"slam": SlamConfig()}))
    file.write_text(text.replace("\nslam:\n", "\nslam:\n  knob_of_old: 3\n"))
    found = load_simulated_config(file)
    assert (found.seed, found.sensors.lidar.rate_hz) == (5, 7.0)
    assert found.robot == made.robot
    assert found.slam == SlamConfig()


def test_settings_of_the_sensors_do_matter(tmp_path: Path) -> None:
    file = tmp_path / "config.yaml"
    file.write_text("sensors:\n  lidar:\n    rate: 7\n")
    with pytest.raises(SlamsimError, match="rate"):
        load_simulated_config(file)
