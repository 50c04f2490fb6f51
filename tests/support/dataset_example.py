"""Small sequences of data sets, for tests."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

from slamsim.config.loading import load_run_config
from slamsim.dataset.make.produce import produce
from slamsim.dataset.recipe.sequence import FormatName, LogFormat, SequenceFacts, SequenceSpec

SMALL = (
    "sensors.lidar.rate_hz=10",
    "sensors.lidar.beam_count=271",
    "sensors.lidar.angle_step_deg=1.0",
)


def small_spec(
    *overrides: str,
    seconds: float = 6.0,
    formats: tuple[FormatName, ...] = get_args(LogFormat),
    world: str = "tiny",
    seed: int = 7,
) -> SequenceSpec:
    given = (*SMALL, f"drive.route.max_duration_s={seconds:g}", *overrides)
    config = load_run_config(world, None, given, seed)
    return SequenceSpec(0, "train/000000", "train", 0, config, formats, {})


def produced(folder: Path, *overrides: str, seconds: float = 6.0) -> SequenceFacts:
    return produce(small_spec(*overrides, seconds=seconds), folder)
