"""The commands that write runs and sequences, as ``fault_stages`` has them.

What is computed between the writes (physics, sensing, SLAM, figures) is done once and replayed.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

from dataset_example import SMALL, small_spec
from fault_stages import Stage, folder_of

from slamsim.config.loading import load_run_config
from slamsim.config.run import RunConfig
from slamsim.console.reporter import Reporter
from slamsim.core.progress import Progress, silent
from slamsim.core.result import SlamResult
from slamsim.core.types import Log
from slamsim.dataset.make import produce
from slamsim.dataset.make.formats import Formats
from slamsim.dataset.recipe.sequence import FormatName
from slamsim.guard.output import partial_folder
from slamsim.io import LOG
from slamsim.io.bag2.writer import write_recording
from slamsim.io.open import read_recording
from slamsim.io.salvage.source import damaged_recording
from slamsim.recording import Recording
from slamsim.report.pages import run
from slamsim.report.run_view import RunView
from slamsim.run import mapping, recording
from slamsim.run.mapping import map_world
from slamsim.run.recording import export_world, simulate_world
from slamsim.run.recovering import recover_log
from slamsim.simulation.header import log_header
from slamsim.simulation.log_writer import LogWriter
from slamsim.simulation.recorder import DriveRecorder
from slamsim.simulation.simulate import Simulation
from slamsim.slam.mapping.saved_map import SavedMap


@cache
def _config() -> RunConfig:
    return load_run_config("tiny", None, (*SMALL, "drive.route.max_duration_s=3"), 7)


@cache
def _reporter() -> Reporter:
    return Reporter(quiet=True)


@cache
def _ride() -> tuple[produce._PlannedRun, list[Any]]:
    """A drive and all that was sensed of it."""
    planned = produce._PlannedRun.planned(small_spec(seconds=3.0).config)
    return planned, list(planned.moments())


def _simulated(config: RunConfig, log: Path, progress: Progress = silent) -> Simulation:
    planned, moments = _ride()
    with LogWriter(log, log_header(planned.robot, config)) as writer:
        for readings, window in moments:
            writer.write(readings, window)
    return Simulation(planned.world, planned.robot, planned.run.outcome)


@contextmanager
def _replayed(owner: object, *names: str) -> Iterator[None]:
    """Pure functions answer as they did when first asked."""
    if not names:
        yield
        return
    key = (getattr(owner, "__name__", ""), names[0])
    true = getattr(owner, names[0])

    def replay(*given: Any, **named: Any) -> Any:
        if key not in _ANSWERS:
            _ANSWERS[key] = true(*given, **named)
        return _ANSWERS[key]

    with patch.object(owner, names[0], replay), _replayed(owner, *names[1:]):
        yield


_ANSWERS: dict[object, Any] = {}


def _simulate(out: Path) -> None:
    with patch.object(recording, "simulate", _simulated):
        simulate_world(_config(), out, _reporter(), overwrite=True)


_true_scored = mapping._scored


def _scored(log: Log, *given: Any) -> RunView:
    """The scores of the first run, about the log of this one."""
    if "view" not in _ANSWERS:
        _ANSWERS["view"] = _true_scored(log, *given)
    view: RunView = replace(_ANSWERS["view"], log=log)
    return view


_true_slam = mapping._slam


def _slam(log: Log, *given: Any) -> tuple[SlamResult, SavedMap]:
    """What the first run made of its log, said of the log of this one."""
    if "slam" not in _ANSWERS:
        _ANSWERS["slam"] = _true_slam(log, *given)
    result, saved = _ANSWERS["slam"]
    return replace(result, log=log), saved


def _map(out: Path) -> None:
    with (
        patch.object(recording, "simulate", _simulated),
        patch.object(mapping, "require_finished"),
        _replayed(mapping, "_checked"),
        patch.object(mapping, "_slam", _slam),
        patch.object(mapping, "_scored", _scored),
        _replayed(run, "report_html"),
    ):
        map_world(_config(), out, _reporter(), overwrite=True)


def _world(out: Path) -> None:
    export_world(_config(), out, overwrite=True)


def _sequence(out: Path) -> None:
    planned, moments = _ride()
    with (
        patch.object(produce._PlannedRun, "planned", lambda config: planned),
        patch.object(produce._PlannedRun, "moments", lambda self: iter(moments)),
        partial_folder(out, overwrite=True) as folder,
    ):
        produce.produce(small_spec(seconds=3.0), folder)


@cache
def _recorded() -> Recording:
    with TemporaryDirectory() as folder:
        _simulated(_config(), Path(folder) / LOG)
        return read_recording(Path(folder) / LOG)


def _copy(out: Path) -> None:
    """As ``slamsim fix`` writes it."""
    with partial_folder(out) as folder:
        write_recording(_recorded(), folder)


_cut_place = TemporaryDirectory()


@cache
def _cut() -> Path:
    """The file of a recording whose writer was killed."""
    log, file = Path(_cut_place.name) / LOG, Path(_cut_place.name) / "cut.mcap"
    _simulated(_config(), log)
    data = next(log.glob("*.mcap")).read_bytes()
    file.write_bytes(data[: len(data) * 3 // 4])
    return file


def _recover(out: Path) -> None:
    recover_log(damaged_recording(_cut()), out, _reporter(), overwrite=True)


def _format(name: FormatName, out: Path) -> None:
    """One format of a sequence alone."""
    planned, moments = _ride()
    spec, header = small_spec(formats=(name,)), log_header(planned.robot, _config())
    recorder = DriveRecorder(spec.name, header)
    with partial_folder(out) as folder, Formats(spec, folder) as formats:
        for readings, window in moments:
            part = recorder.take([readings], [window]).recording
            formats.write(part, readings.scans.true_stamps_ns, window)


_VARIES = ("run.rrd", "SHA256SUMS")
"""Rerun notes when it recorded."""

COMMANDS = (
    Stage("simulate", _simulate),
    Stage("map", _map, varies=_VARIES),
    Stage("map replaced", _map, partial(folder_of, "old"), varies=_VARIES),
    Stage("world", _world),
    Stage("fix", _copy),
    Stage("recover", _recover),
    Stage("a sequence in all formats", _sequence),
)
FORMATS = tuple(
    Stage(f"the format {name}", partial(_format, name))
    for name in ("parquet", "tum", "kitti", "carmen")
)
