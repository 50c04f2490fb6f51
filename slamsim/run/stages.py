"""Shared parts of the stages of a run: progress, timing, reporting."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from slamsim.console.reporter import Reporter
from slamsim.core.progress import Progress
from slamsim.core.result import FailedStage


@dataclass(frozen=True, slots=True)
class Report:
    """The numbers of a run under stable, unit-bearing keys, and what a person should be told.

    weighed: the warnings that matter most, in order of weight; warnings has all. verdict: how good
    a map is, how sure, and what to look at. failed: stages of SLAM whose work is missing from the
    result. unjoined: why a map does not continue the one that it should, if so.
    """

    numbers: dict[str, object]
    warnings: tuple[str, ...] = ()
    weighed: tuple[str, ...] = ()
    verdict: str = ""
    mapped: bool = False
    failed: tuple[FailedStage, ...] = ()
    unjoined: str = ""


@dataclass(frozen=True, slots=True)
class Stages:
    """Shows each stage to the user and keeps how long it took."""

    reporter: Reporter
    seconds: dict[str, float] = field(default_factory=dict)
    started_s: float = field(default_factory=time.perf_counter)

    @contextmanager
    def stage(self, name: str, unit: str = "") -> Iterator[Progress]:
        """One stage; unit is what its progress counts in each second of work."""
        begun_s = time.perf_counter()
        with self.reporter.stage(name, unit) as progress:
            yield progress
        self.seconds[name] = time.perf_counter() - begun_s

    def so_far(self) -> dict[str, float]:
        """Seconds of each stage that is over, and the ``total``."""
        return {**self.seconds, "total": time.perf_counter() - self.started_s}
