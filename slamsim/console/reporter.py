"""What a command shows: results on stdout, progress and warnings on stderr.

On a terminal, tables and bars are drawn; anything else (a file, a pipe) gets plain lines, one for
each row, as wide as they are.
"""

from __future__ import annotations

import json
import logging
import math
import os
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy

from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskProgressColumn,
    TextColumn,
)
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from slamsim.core.progress import Progress as Listener
from slamsim.core.progress import silent
from slamsim.guard.errors import printable
from slamsim.guard.files import discard
from slamsim.guard.quantities import as_number, as_time

Cell = tuple[tuple[str, str], ...]
"""(text, style) of each line of a cell."""

_UNWRAPPED = 100_000
"""Columns of what is no screen."""


class _PlainConsole(Console):
    """Only what rich itself makes up obeys the terminal: names may come from a stranger's file."""

    def __init__(self, *, stderr: bool, quiet: bool) -> None:
        stream = sys.stderr if stderr else sys.stdout
        self.is_screen = stream is not None and stream.isatty()
        plain = bool(os.environ.get("NO_COLOR"))
        super().__init__(
            stderr=stderr,
            quiet=quiet,
            highlight=False,
            markup=False,
            emoji=False,
            width=None if self.is_screen else _UNWRAPPED,
            color_system=None if plain else "auto",
            force_terminal=False if plain else None,
        )

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterable[Segment]:
        for segment in super().render(renderable, options):
            if segment.control:
                yield segment
            else:
                text = "\n".join(map(printable, segment.text.split("\n")))
                yield Segment(text, segment.style)

    def on_broken_pipe(self) -> None:
        """Who read this has seen enough: the command goes on, and its exit code is its own."""
        self.quiet = True
        discard(self.file)


def write_result(text: str) -> None:
    """Text for other programs on stdout; that a reader has gone is no error."""
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError:
        discard(sys.stdout)


class _Log(logging.Handler):
    """Log messages among the warnings; the same one, of a file that several parts of a command
    read, is told once."""

    def __init__(self, console: Console) -> None:
        super().__init__()
        self._console = console
        self._told: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        words = self.format(record)
        if words not in self._told:
            self._told.add(words)
            _tell(self._console, words, record.levelno >= logging.WARNING)


def _show_log(console: Console, level: int) -> None:
    """Show what slamsim logs there from now on, unless the program has set up logging itself; its
    root logger is not ours to change."""
    ours = logging.getLogger("slamsim")
    for shown in [each for each in ours.handlers if isinstance(each, _Log)]:
        ours.removeHandler(shown)
    if logging.getLogger().handlers:
        return
    handler = _Log(console)
    handler.setLevel(level)
    ours.addHandler(handler)
    ours.setLevel(min(level, logging.WARNING))


def _tell(console: Console, words: str, is_warning: bool) -> None:
    console.print(Text(f"! {words}", "yellow") if is_warning else Text(words, "dim"))


class RateColumn(ProgressColumn):
    """Units of work per second of wall time; for simulated seconds that is the real-time factor."""

    def render(self, task: Task) -> Text:
        speed, unit = task.speed, task.fields.get("unit")
        if task.finished_time:  # of all that was counted: rich knows the last half minute alone
            speed = task.fields.get("counted", task.completed) / task.finished_time
        return Text(f"{as_number(speed, 3)} {unit}" if speed and unit else "", style="cyan")


class TimeColumn(ProgressColumn):
    """How long it has taken, and how long it may still take."""

    def render(self, task: Task) -> Text:
        elapsed_s = (task.finished_time if task.finished else task.elapsed) or 0.0
        left_s = None if task.finished else task.time_remaining
        return Text(as_time(elapsed_s) + (f", {as_time(left_s)} left" if left_s else ""))


class Reporter:
    """Results on stdout, bars and warnings on stderr, or nothing of it; with ``--json`` the results
    as JSON alone."""

    def __init__(self, *, quiet: bool = False, as_json: bool = False) -> None:
        self._quiet = quiet or as_json
        self._as_json = as_json
        self._results = _PlainConsole(stderr=False, quiet=self._quiet)
        self._console = _PlainConsole(stderr=True, quiet=self._quiet)
        self._bars_shown = 0
        _show_log(self._console, logging.ERROR if self._quiet else logging.INFO)

    def without_result(self) -> Reporter:
        """The same for a part of a command, whose result is not the command's."""
        part = copy(self)
        part._as_json = False
        return part

    @contextmanager
    def stage(self, title: str, unit: str = "") -> Iterator[Listener]:
        """A progress bar for one stage; unit is what it counts in each second, as in 'scans/s'."""
        if self._quiet:
            yield silent
            return
        columns = (
            TextColumn("{task.description:<10}", markup=False),
            BarColumn(bar_width=30),
            TaskProgressColumn("{task.percentage:>4.0f} %", markup=False),
            TimeColumn(),
            RateColumn(),
        )
        with self.bars(*columns) as bars:
            task = bars.add_task(title, total=None, unit=unit)

            def listen(done: float, total: float) -> None:
                bars.update(task, completed=done, total=total if math.isfinite(total) else None)

            yield listen
            shown = bars.tasks[0]
            total = shown.total or shown.completed or 1.0
            bars.update(task, completed=total, total=total, counted=shown.completed)

    @contextmanager
    def bars(self, *columns: ProgressColumn) -> Iterator[Progress]:
        """Bars of the caller's own making, on stderr, or nothing where all is quiet."""
        bars = Progress(*columns, console=self._console, disable=self._quiet, redirect_stdout=False)
        self._bars_shown += 1
        try:
            with bars:
                yield bars
        finally:
            self._bars_shown -= 1

    def note(self, sentence: str) -> None:
        """What the command is about to do."""
        _tell(self._console, sentence, is_warning=False)

    def warn(self, sentence: str) -> None:
        _tell(self._console, sentence, is_warning=True)

    def say(self, sentence: str) -> None:
        """A line of the result."""
        self._out.print(sentence, soft_wrap=True)

    def table(self, title: str, rows: Mapping[str, str]) -> None:
        """A closing table of name and value."""
        cells = [(((name, "dim"),), ((value, ""),)) for name, value in rows.items()]
        self.rows(Text(title, "bold"), cells)

    def rows(self, title: Text, rows: Sequence[tuple[Cell, ...]]) -> None:
        """A table without a head; where there is no screen, a line for each row."""
        if not self._out.is_screen:
            self.say(title.plain)
            cells = [[" ".join(" ".join(t for t, _ in c).split()) for c in row] for row in rows]
            for line in aligned(cells):
                self.say(line)
            return
        table = Table(title=title, show_header=False, title_justify="left")
        for row in rows:
            table.add_row(*(Text("\n").join(Text(*part) for part in cell) for cell in row))
        self._out.print(table)

    def result(self, values: Mapping[str, object]) -> None:
        """The same numbers as JSON on stdout, where ``--json`` was asked for."""
        if self._as_json:
            write_result(json.dumps(values, indent=2, allow_nan=False) + "\n")

    @property
    def _out(self) -> _PlainConsole:
        """Where results go: above the bars, where these are drawn on the same screen."""
        drawn = self._bars_shown and self._console.is_screen and self._results.is_screen
        return self._console if drawn else self._results


def aligned(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Each row on one line, its cells below those of the row before."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for cells in rows:
        padded = (f"{cell:<{width}}" for cell, width in zip(cells, widths, strict=True))
        yield f"  {'  '.join(padded).rstrip()}"
