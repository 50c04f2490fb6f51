"""Progress, tables and messages shown to the user while a command runs."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager

from rich.console import Console, ConsoleOptions, RenderableType
from rich.logging import RichHandler
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from slamsim.core.progress import Progress as Listener
from slamsim.core.progress import silent
from slamsim.guard.errors import printable


class _PlainConsole(Console):
    """Only what rich itself makes up obeys the terminal: names may come from anybody's file."""

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterable[Segment]:
        for segment in super().render(renderable, options):
            if segment.control:
                yield segment
            else:
                text = "\n".join(map(printable, segment.text.split("\n")))
                yield Segment(text, segment.style)


class _Once(logging.Filter):
    """The same warning, of a file that several parts of a command read, is told once."""

    def __init__(self) -> None:
        super().__init__()
        self._told: set[str] = set()

    def filter(self, record: logging.LogRecord) -> bool:
        told = record.getMessage() in self._told
        self._told.add(record.getMessage())
        return not told


class _RateColumn(ProgressColumn):
    """Units of work per second of wall time; for simulated seconds that is the real-time factor."""

    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        unit = str(task.fields.get("unit", ""))
        return Text("" if speed is None else f"{speed:.4g} {unit}", style="cyan")


class Reporter:
    """Bars and tables on stderr, or nothing; machine-readable results on stdout."""

    def __init__(self, *, quiet: bool = False, as_json: bool = False) -> None:
        self._quiet = quiet or as_json
        self._as_json = as_json
        self._console = _PlainConsole(
            stderr=True, quiet=self._quiet, highlight=False, markup=False, emoji=False
        )
        handler = RichHandler(console=self._console, show_time=False, show_path=False)
        handler.addFilter(_Once())
        logging.basicConfig(
            level=logging.ERROR if self._quiet else logging.WARNING,
            format="%(message)s",
            handlers=[handler],
        )
        if not self._quiet:
            logging.getLogger("slamsim").setLevel(logging.INFO)

    def without_result(self) -> Reporter:
        """The same for a part of a command, whose result is not the command's."""
        return Reporter(quiet=self._quiet)

    @contextmanager
    def stage(self, title: str, unit: str) -> Iterator[Listener]:
        """A progress bar for one stage; unit is what it counts in each second, as in 'scans/s'."""
        if self._quiet:
            yield silent
            return
        columns = (
            TextColumn("{task.description:<10}", markup=False),
            BarColumn(bar_width=30),
            TextColumn("{task.percentage:>4.0f} %"),
            _RateColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(compact=True),
        )
        with Progress(*columns, console=self._console) as bars:
            task = bars.add_task(title, total=None, unit=unit)

            def listen(done: float, total: float) -> None:
                bars.update(task, completed=done, total=total)

            yield listen
            total = bars.tasks[0].total or 1.0
            bars.update(task, completed=total, total=total)

    def bars(self, *columns: ProgressColumn) -> Progress:
        """Bars of the caller's own making, on stderr, or nothing where all is quiet."""
        return Progress(*columns, console=self._console, disable=self._quiet)

    def say(self, sentence: str) -> None:
        self._console.print(sentence, soft_wrap=True)

    def warn(self, sentence: str) -> None:
        self._console.print(Text(f"! {sentence}", style="yellow"))

    def table(self, title: str, rows: Mapping[str, str]) -> None:
        """A closing table of name and value."""
        table = Table(title=title, show_header=False, title_justify="left", title_style="bold")
        table.add_column(style="dim")
        table.add_column()
        for name, value in rows.items():
            table.add_row(Text(name), Text(value))
        self._console.print(table)

    def show(self, picture: RenderableType) -> None:
        """Whatever ``rich`` can draw."""
        self._console.print(picture)

    def result(self, values: Mapping[str, object]) -> None:
        """The same numbers as JSON on stdout, where ``--json`` was asked for."""
        if self._as_json:
            sys.stdout.write(json.dumps(values, indent=2, allow_nan=False) + "\n")
