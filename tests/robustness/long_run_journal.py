"""What the long runs leave: one JSON line for each case, so that a run can be taken up again."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from fault_judge import Verdict

from slamsim.console.reporter import Reporter


@dataclass(frozen=True, slots=True)
class Row:
    """One row of the table at the end. met: whether the target was reached, None without one."""

    name: str
    figure: str
    target: str = ""
    met: bool | None = None


class Journal:
    """Appends to a file of JSON lines, each with the ``name`` of its case.

    A line that a kill cut off is passed over, its case counts as not done.
    """

    def __init__(self, path: Path, reporter: Reporter) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self.lines: dict[str, dict[str, Any]] = {}
        if path.is_file():
            for line in path.read_text(encoding="utf-8").splitlines():
                self._take(line)
        self._file = path.open("a", encoding="utf-8")
        self._file.write("\n" if path.stat().st_size else "")
        self._reporter = reporter

    def _take(self, line: str) -> None:
        try:
            values = json.loads(line)
            self.lines[values["name"]] = values
        except (ValueError, TypeError, KeyError):
            return

    @property
    def names(self) -> frozenset[str]:
        """Of the cases that are there."""
        return frozenset(self.lines)

    def add(self, case: Verdict | dict[str, Any]) -> None:
        """A case that is done."""
        values = asdict(case) if isinstance(case, Verdict) else case
        self.lines[values["name"]] = values
        self._file.write(json.dumps(values) + "\n")
        self._file.flush()

    def verdicts(self, prefix: str | tuple[str, ...]) -> list[Verdict]:
        """Of the cases whose names begin so."""
        return [Verdict(**v) for name, v in self.lines.items() if name.startswith(prefix)]

    @contextmanager
    def progress(self, title: str, total: int, done: int = 0) -> Iterator[Callable[[], None]]:
        """A bar; the block calls what it is given after each case."""
        with self._reporter.stage(title, "cases/s") as listen:
            count = done

            def told() -> None:
                nonlocal count
                count += 1
                listen(count, total)

            yield told


def shown(rows: Sequence[Row]) -> dict[str, str]:
    """For a table."""
    words = {None: "", True: "  met", False: "  MISSED"}
    return {
        row.name: f"{row.figure}{f'  (target {row.target})' if row.target else ''}{words[row.met]}"
        for row in rows
    }
