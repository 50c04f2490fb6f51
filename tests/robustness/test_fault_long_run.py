"""The long runs go on where they stopped, try again what failed, tell what missed its target."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path

import fault_mutations
import pytest
from fault_judge import Verdict
from fault_log_reads import relations
from fault_mutations import Ground
from fault_seeds import Seed
from long_run_journal import Journal, Row, shown

from slamsim.console.reporter import Reporter
from slamsim.guard.errors import InputRefused

pytestmark = pytest.mark.fault


def write_line(folder: Path) -> Path:
    (folder / "a.relations").write_text("1.5 2.5 0.1 0.2 0.0 0.0 0.0 0.3\n")
    return folder / "a.relations"


def journal(folder: Path) -> Journal:
    return Journal(folder / "out" / "runs.jsonl", Reporter(quiet=True))


def test_a_run_is_taken_up_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seed = Seed("lines", write_line, relations)
    monkeypatch.setattr(fault_mutations, "SEEDS", (seed,))
    chosen = Namespace(count=12, campaign=3, formats="", case="")
    table = fault_mutations.run(chosen, journal(tmp_path))
    assert [row.met for row in table if row.target] == [True] * 6

    path = tmp_path / "out" / "runs.jsonl"
    lines = path.read_text().splitlines()
    assert len(lines) == 12
    failed = lines[2].replace('"refused"', '"odd"').replace('"other"', '"odd"')
    path.write_text("\n".join([*lines[:2], failed, *lines[3:9], lines[9][:20]]))
    asked: list[str] = []

    def counted(*args: object) -> Iterator[Verdict]:
        for verdict in verdicts(*args):  # type: ignore[arg-type]
            asked.append(verdict.name)
            yield verdict

    verdicts = fault_mutations.verdicts
    monkeypatch.setattr(fault_mutations, "verdicts", counted)
    assert fault_mutations.run(chosen, journal(tmp_path)) == table
    assert asked == [f"3/lines/{number}" for number in (2, 9, 10, 11)]


def test_a_case_is_the_same_again_and_alone(tmp_path: Path) -> None:
    made = Ground.of(Seed("lines", write_line, relations), tmp_path / "a")
    donors = [b"donor"]
    for number in range(20):
        found = []
        for _ in range(2):
            tried = fault_mutations.mutation(made, number, 1, donors)
            try:
                found.append(tried.run())
            except InputRefused as refusal:
                found.append(str(refusal))
        assert found[0] == found[1]


def test_what_missed_its_target_is_shown() -> None:
    rows = [Row("a", "1"), Row("b", "2", "2", True), Row("c", "3", "0", False)]
    assert shown(rows) == {"a": "1", "b": "2  (target 2)  met", "c": "3  (target 0)  MISSED"}
