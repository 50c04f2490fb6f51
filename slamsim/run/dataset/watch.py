"""Progress display of the production of a data set."""

from __future__ import annotations

import time
from contextlib import ExitStack
from types import TracebackType
from typing import Self

from rich.progress import BarColumn, TextColumn

from slamsim.console.reporter import Reporter
from slamsim.dataset.make.shard import Tried
from slamsim.guard.quantities import as_number, as_time


class ConsoleWatch:
    """A bar with sequences, simulated hours per hour, MB/s, time to go and failures.

    Rates are those of what this run made: sequences that were there before do not count.
    """

    def __init__(self, reporter: Reporter) -> None:
        self._reporter = reporter
        self._shown = ExitStack()
        self._begun_s = 0.0
        self._total = self._done = self._made = self._failed = 0
        self._simulated_s = self._megabytes = 0.0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """What is stopped before it begins leaves nothing to go on from."""
        self._shown.close()
        if kind is not None and self._begun_s:
            self._reporter.note("Finished sequences stay; run the same command to resume.")

    def begin(self, total: int, already: int) -> None:
        self._total, self._done = total, already
        self._begun_s = time.monotonic()
        columns = (
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            TextColumn("{task.fields[count]}"),
            TextColumn("{task.fields[told]}", style="cyan"),
        )
        self._bars = self._shown.enter_context(self._reporter.bars(*columns))
        self._task = self._bars.add_task("sequences", total=1, count="", told="")
        if already:
            self._reporter.note(f"{already} of {total} sequences are there already")
        self._show()

    def made(self, tried: Tried) -> None:
        row = tried.row or {}
        self._done += 1
        if tried.old:
            return
        self._made += 1
        self._simulated_s += float(str(row.get("quality.duration_s") or 0.0))
        self._megabytes += int(str(row.get("size_bytes") or 0)) * 1e-6
        self._show()

    def tried(self, index: int, reason: str, tries: int) -> None:
        self._reporter.warn(f"sequence {index}, try {tries}: {reason}")

    def failed(self, index: int, reason: str, command: str) -> None:
        self._failed += 1
        self._done += 1
        self._reporter.warn(f"sequence {index} failed for good: {reason}; see it by: {command}")
        self._show()

    def still(self) -> None:
        self._show()

    def catalogue(self) -> None:
        self._show()
        self._bars.add_task("catalogue", total=None, count="", told="manifest, card, figures, sums")

    def _show(self) -> None:
        elapsed_s = max(time.monotonic() - self._begun_s, 1e-3)
        told = [
            f"{as_number(self._simulated_s / elapsed_s, 3)} × real time",
            f"{as_number(self._megabytes / elapsed_s, 3)} MB/s",
            f"{as_time(elapsed_s)} gone",
        ]
        if self._made:
            to_go_s = (self._total - self._done) * elapsed_s / (self._made + self._failed)
            told.append(f"{as_time(to_go_s)} to go")
        if self._failed:
            told.append(f"{self._failed} failed")
        self._bars.update(
            self._task,
            completed=self._done,
            total=self._total,
            count=f"{self._done} of {self._total}",
            told=" · ".join(told),
        )
