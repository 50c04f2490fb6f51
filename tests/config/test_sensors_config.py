"""Sensor configurations: the presets as shipped, derived numbers, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from pydantic import ValidationError

from slamsim.config.sensors import SensorsConfig

PRESETS = Path(__file__).parents[2] / "configs" / "sensors"


def preset(name: str) -> SensorsConfig:
    return SensorsConfig.model_validate(yaml.safe_load((PRESETS / f"{name}.yaml").read_text()))


@pytest.mark.parametrize(
    ("name", "rate_hz", "beams", "swept_deg", "beam_dt_ns", "range_max_m"),
    [
        ("utm_30lx", 40.0, 1081, 270.0, 17_361, 30.0),
        ("urg_04lx", 10.0, 683, 239.765625, 97_656, 5.6),
        ("rplidar_a2", 10.0, 400, 359.1, 250_000, 12.0),
        ("lds_01", 5.0, 360, 359.0, 555_556, 3.5),
        ("sick_lms200", 75.0, 181, 180.0, 37_037, 80.0),
    ],
)
def test_presets_are_the_devices(
    name: str, rate_hz: float, beams: int, swept_deg: float, beam_dt_ns: int, range_max_m: float
) -> None:
    lidar = preset(name).lidar
    assert (lidar.rate_hz, lidar.beam_count, lidar.range_max_m) == (rate_hz, beams, range_max_m)
    assert (beams - 1) * lidar.angle_step_deg == pytest.approx(swept_deg)
    assert lidar.beam_dt_ns == beam_dt_ns
    assert lidar.beam_dt_ns * (beams - 1) < 1e9 / rate_hz


def test_every_preset_is_tested_and_the_default_is_the_utm_30lx() -> None:
    names = {path.stem for path in PRESETS.glob("*.yaml")}
    assert names == {"utm_30lx", "urg_04lx", "rplidar_a2", "lds_01", "sick_lms200"}
    assert preset("utm_30lx") == SensorsConfig()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({"lidar": {"beam_count": 1441}}, "at most 1440 beams fit"),
        ({"lidar": {"range_min_m": 5.0, "range_max_m": 5.0}}, "must exceed range_min_m"),
        ({"lidar": {"rate_hz": 0}}, "greater than 0.01"),
        ({"lidar": {"nosie": {}}}, "Extra inputs"),
        ({"lidar": {"noise": {"constant_m": -0.01}}}, "greater than or equal to 0"),
        ({"lidar": {"dropout": {"probability": 1.5}}}, "less than or equal to 1"),
        ({"imu": {"rate_hz": "200"}}, "valid number"),
        ({"imu": {"gyro": {"scale_error": [0.0, 0.0]}}}, "Field required"),
        ({"encoders": {"ticks_per_revolution": 0}}, "greater than or equal to 1"),
        ({"encoders": {"clock": {"latency_s": -1.0}}}, "greater than or equal to 0"),
        ({"encoders": {"clock": {"jitter_s": float("nan")}}}, "finite number"),
    ],
)
def test_what_cannot_be_is_refused(data: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        SensorsConfig.model_validate(data)
