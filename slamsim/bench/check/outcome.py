"""Result of the checker on one trial, as storable numbers and names."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from pydantic import TypeAdapter

from slamsim.bench.check.trials import CheckTrial
from slamsim.bench.check.truth import Truth
from slamsim.check.check import check_recording
from slamsim.check.findings import CheckReport, Finding
from slamsim.check.wording import JSON_VERDICTS
from slamsim.recording import Recording
from slamsim.recording.edits.base import CannotEdit
from slamsim.sensors.faults.base import Fault

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
