"""Simulated logs, one per seed, made once and kept for the next run."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from pydantic import ValidationError

from slamsim.bench.alone import Children
from slamsim.config.run import RunConfig
from slamsim.console.reporter import Reporter
from slamsim.guard.errors import InputRefused
from slamsim.guard.yaml import load_yaml
from slamsim.run.recording import simulate_world
from slamsim.simulation.own_files import CONFIG

SIMULATED = ("seed", "world", "robot", "drive", "sensors", "faults")
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


def simulation_of(log: Path) -> RunConfig:
    """The configuration that a simulated log was made with; only the simulation's part counts,
    so that a log outlives changes to SLAM's settings.

    Raises InputRefused where there is none, or one that is understood no more.
    """
    if not (log / CONFIG).is_file():
        raise InputRefused(log, f"holds no {CONFIG}; is it the folder of a simulated run?")
    data = load_yaml(log / CONFIG).data
    kept = {key: data[key] for key in SIMULATED if key in data} if isinstance(data, dict) else data
    try:
        return RunConfig.model_validate(kept)
    except ValidationError as error:
        fault = error.errors()[0]
        at = ".".join(map(str, fault["loc"]))
        raise InputRefused(log / CONFIG, f"{at}: {fault['msg']}; simulate it anew") from None


def _require_same(config: RunConfig, log: Path) -> None:
    parts = set(SIMULATED)
    made = simulation_of(log).model_dump(include=parts)
    other = _first_difference(config.model_dump(include=parts), made)
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
