"""Trials of each drive (healthy, with one fault or two, over fault sizes), and what the checker
says."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter

from slamsim.bench.check.truth import Truth
from slamsim.check.check import check_recording
from slamsim.check.findings import CheckReport, Finding
from slamsim.check.registry import registry
from slamsim.check.wording import JSON_VERDICTS
from slamsim.core.randomness import random_stream
from slamsim.guard.errors import SlamsimError, did_you_mean, shown
from slamsim.io.open import read_recording
from slamsim.recording import Recording
from slamsim.recording.edits.base import CannotEdit
from slamsim.run.naming import recording_name
from slamsim.sensors.faults.base import Fault
from slamsim.sensors.faults.registry import injected

Json = dict[str, object]


@dataclass(frozen=True, slots=True)
class Measured:
    """An estimate that the checker gave: check and subject as in the finding."""

    check: str
    subject: str
    verdict: str
    value: float
    sigma: float
    unit: str
    bound: float | None


@dataclass(frozen=True, slots=True)
class CheckOutcome:
    """One trial.

    expects: what had to be said. also: what might be said besides. said: the names of all that
    was found bad. untold: questions that could not be answered. truth: what estimates should be,
    by check, as far as it is known. skipped: why there was no such trial; nothing is said then.
    """

    trial: str
    sort: str
    expects: tuple[str, ...]
    also: tuple[str, ...]
    said: tuple[str, ...]
    untold: tuple[str, ...]
    measured: tuple[Measured, ...]
    truth: Truth
    seconds: float
    skipped: str = ""

    @property
    def named(self) -> bool:
        """Whether everything that is wrong was said."""
        return set(self.expects) <= set(self.said)

    @property
    def invented(self) -> tuple[str, ...]:
        """What was said though it is not so."""
        return tuple(sorted(set(self.said) - set(self.expects) - set(self.also)))

    def with_truth(self) -> Iterator[tuple[Measured, float]]:
        """What was measured, where the truth is known."""
        return pairs_with_truth(self.measured, self.truth)

    def as_json(self) -> Json:
        return asdict(self)

    @staticmethod
    def from_json(data: object) -> CheckOutcome:
        """Raises ValidationError for what ``as_json`` did not give."""
        return _OUTCOME.validate_python(data)


_OUTCOME = TypeAdapter(CheckOutcome)


def pairs_with_truth(
    measured: Iterable[Measured], truth: Mapping[str, float]
) -> Iterator[tuple[Measured, float]]:
    """Measurements whose truth is known, beside it."""
    for each in measured:
        if each.check in truth and np.isfinite(each.sigma):
            yield each, truth[each.check]


def measured_in(report: CheckReport) -> tuple[Measured, ...]:
    """All sizes that a report states."""
    return tuple(filter(None, map(_measured, report.findings)))


def outcome_of(
    trial: CheckTrial, with_faults: Callable[[Sequence[Fault]], Recording], truth: Truth
) -> CheckOutcome:
    """Inject and check. with_faults: gives the recording with faults, or raises CannotEdit."""
    try:
        recording = with_faults(trial.faults)
    except CannotEdit as error:
        return _outcome(trial, truth, CheckReport("", ()), 0.0, str(error))
    begun_s = time.perf_counter()
    report = check_recording(recording)
    return _outcome(trial, truth, report, time.perf_counter() - begun_s)


def _outcome(
    trial: CheckTrial, truth: Truth, report: CheckReport, seconds: float, skipped: str = ""
) -> CheckOutcome:
    return CheckOutcome(
        truth=truth,
        trial=trial.name,
        sort=trial.sort,
        expects=tuple(sorted({fault.expects for fault in trial.faults})),
        also=tuple(sorted({name for fault in trial.faults for name in fault.also})),
        said=tuple(sorted({finding.fault for finding in report.faults if finding.fault})),
        untold=tuple(f.check for f in report.findings if f.verdict == "inconclusive"),
        measured=measured_in(report),
        seconds=seconds,
        skipped=skipped,
    )


def _measured(finding: Finding) -> Measured | None:
    estimate = finding.estimate
    if estimate is None:
        return None
    return Measured(
        finding.check,
        finding.subject,
        JSON_VERDICTS[finding.verdict],
        estimate.value,
        estimate.sigma,
        estimate.unit,
        estimate.bound,
    )


CLEAN = "clean"


@dataclass(frozen=True, slots=True)
class CheckTrial:
    """Faults to put into a drive, and what sort of trial it is: clean, fault, pair or curve."""

    sort: str
    faults: tuple[Fault, ...]

    @property
    def name(self) -> str:
        """Unique among the trials of a drive."""
        if self.sort == "curve":
            return ",".join(f"{fault.name}:{fault.size:g}" for fault in self.faults)
        return "+".join(fault.name for fault in self.faults) or CLEAN


def clean_trial() -> CheckTrial:
    return CheckTrial("clean", ())


def fault_trials(faults: Sequence[Fault]) -> list[CheckTrial]:
    return [CheckTrial("fault", (fault,)) for fault in faults]


def require_known_names(faults: Sequence[Fault]) -> None:
    """Raises SlamsimError for a fault that names another which no question can report."""
    known = registry().faults
    for fault in faults:
        for name in (fault.expects, *fault.also, *fault.hides):
            if name not in known:
                raise SlamsimError(
                    f"the fault {fault.name} expects {shown(name)}, "
                    f"which the checker cannot report{did_you_mean(name, known)}"
                )


def curve_trials(faults: Sequence[Fault]) -> list[CheckTrial]:
    """Each fault with each of its sizes."""
    return [CheckTrial("curve", (f.with_size(size),)) for f in faults for size in f.sizes]


def pair_trials(faults: Sequence[Fault], count: int, seed: int) -> list[CheckTrial]:
    """So many random pairs whose faults can both be told, as far as there are any."""
    pairs = [pair for pair in itertools.combinations(faults, 2) if Fault.told_apart(*pair)]
    rng = random_stream(seed, "bench check", "pairs")
    chosen = rng.choice(len(pairs), size=min(count, len(pairs)), replace=False) if pairs else ()
    return [CheckTrial("pair", pairs[int(one)]) for one in chosen]


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
