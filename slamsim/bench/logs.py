"""Simulated logs, one per seed, made once and kept for the next run."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from slamsim.bench.alone import Children
from slamsim.config.loading import load_model
from slamsim.config.run import RunConfig
from slamsim.console import Reporter
from slamsim.run.folder import CONFIG
from slamsim.run.recording import simulate_world
from slamsim.safe.errors import InputRefused

SIMULATED = ("seed", "world", "robot", "drive", "sensors")
"""The parts of a configuration that decide what is in a log."""


def simulated_log(config: RunConfig, folder: Path, children: Children) -> Path:
    """The run folder of this simulation under ``folder``, simulated unless it is there already.

    Raises InputRefused for one that was simulated with other settings, and what the simulation
    raises.
    """
    log = folder / f"{config.world.name}_{config.seed}"
    if log.exists():
        _require_same(config, log)
    else:
        children.run(_simulate, config, log)
    return log


@contextmanager
def kept_or_temporary(kept: Path | None) -> Iterator[Path]:
    """The folder for logs that was named, else one that is gone afterwards."""
    if kept is not None:
        yield kept
        return
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


def _simulate(config: RunConfig, folder: Path) -> None:
    simulate_world(config, folder, Reporter(quiet=True))


def _require_same(config: RunConfig, log: Path) -> None:
    if not (log / CONFIG).is_file():
        raise InputRefused(log, f"holds no {CONFIG}; is it the folder of a simulated run?")
    made = load_model(RunConfig, log / CONFIG).model_dump(include=set(SIMULATED))
    other = _first_difference(config.model_dump(include=set(SIMULATED)), made)
    if other is not None:
        raise InputRefused(log, f"was simulated with another {other}; use another folder for logs")


def _first_difference(wanted: object, made: object, at: str = "") -> str | None:
    """The key path of the first value that differs, None if none does."""
    if isinstance(wanted, Mapping) and isinstance(made, Mapping):
        for key in wanted:
            found = _first_difference(wanted[key], made.get(key), f"{at}.{key}" if at else key)
            if found is not None:
                return found
        return None
    return None if wanted == made else at
