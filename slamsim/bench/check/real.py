"""Recordings of real robots: their own faults, and injected ones."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from slamsim.bench.check.outcome import CheckOutcome, Json, outcome_of
from slamsim.bench.check.trials import CheckTrial, clean_trial, fault_trials
from slamsim.io.open import read_recording
from slamsim.recording import Recording
from slamsim.recording.edits.base import CannotEdit
from slamsim.run.naming import recording_name
from slamsim.sensors.faults.apply import injected
from slamsim.sensors.faults.base import Fault


def recordings_at(path: Path) -> tuple[Path, ...]:
    """The recording itself, or all that lie in a folder of recordings.

    A folder with ``metadata.yaml``, or one named ``log`` in it, is one recording.
    """
    if not path.is_dir() or any((path / name).exists() for name in ("metadata.yaml", "log")):
        return (path,)
    return tuple(sorted(one for one in path.rglob("*") if _may_be_recording(one)))


def run_recording(path: Path, faults: Sequence[Fault]) -> Json:
    """As it is, and with each fault on top; what it says as it is counts as no invention."""
    recording = read_recording(path)
    as_it_is = _checked(clean_trial(), recording)
    faulty = [_on_top(trial, recording, as_it_is) for trial in fault_trials(faults)]
    told = replace(as_it_is, sort="real")
    return {
        "drive": recording_name(str(path)),
        "world": "real",
        "lidar": recording.format,
        "outcomes": [one.as_json() for one in (told, *faulty)],
    }


def _checked(trial: CheckTrial, recording: Recording) -> CheckOutcome:
    return outcome_of(trial, lambda faults: injected(recording, faults, seed=0), {})


def _on_top(trial: CheckTrial, recording: Recording, as_it_is: CheckOutcome) -> CheckOutcome:
    """What a recording has anyhow cannot be found anew."""
    if set(as_it_is.said) & {fault.expects for fault in trial.faults}:
        return outcome_of(trial, _has_it_already, {})
    outcome = _checked(trial, recording)
    return replace(outcome, also=_joined(outcome.also, as_it_is.said))


def _has_it_already(faults: Sequence[Fault]) -> Recording:
    raise CannotEdit(f"it has {' and '.join(fault.expects for fault in faults)} already")


def _joined(one: Iterable[str], other: Iterable[str]) -> tuple[str, ...]:
    return tuple(sorted({*one, *other}))


_SUFFIXES = (".mcap", ".bag", ".db3", ".clf", ".log", ".gz", ".bz2")


def _may_be_recording(path: Path) -> bool:
    return path.is_file() and path.suffix.lower() in _SUFFIXES
