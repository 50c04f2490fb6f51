"""Hostile files of every format: refused with one sentence, or read right.

``long_run.py corpus`` measures time and memory, and types them at the command line.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from fault_corpus import CORPUS, fault_of, typed, verdicts, warmed_up

pytestmark = pytest.mark.fault

TYPED = (
    "YAML: alias bomb",
    pytest.param("PNG of 100,000 by 100,000", marks=pytest.mark.slow),
)


@pytest.mark.long
@pytest.mark.parametrize(
    "every",
    [
        pytest.param(3, id="a third of each format"),
        pytest.param(1, marks=pytest.mark.slow, id="all"),
    ],
)
def test_hostile_files_are_refused_or_read_right(every: int, tmp_path: Path) -> None:
    assert len({hostile.name for hostile in CORPUS}) == len(CORPUS) >= 120
    warmed_up(tmp_path)
    found = list(verdicts(CORPUS[::every], tmp_path / "corpus"))
    wrong = {hostile.name: fault_of(hostile, verdict) for hostile, verdict in found}
    assert {name: why for name, why in wrong.items() if why} == {}


@pytest.mark.parametrize("name", TYPED)
def test_a_command_refuses_them_too(name: str, tmp_path: Path) -> None:
    (hostile,) = (hostile for hostile in CORPUS if hostile.name == name)
    verdict = typed(hostile, tmp_path)
    assert verdict.outcome == "refused", verdict.detail
    assert hostile.words in verdict.detail
