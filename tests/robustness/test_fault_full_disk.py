"""A full disk, for each writer: one sentence, exit code 75, and nothing under the final name."""

from __future__ import annotations

from pathlib import Path

import pytest
from fault_disk import limited
from fault_nth import vouched
from fault_recorded import COMMANDS, FORMATS
from fault_stages import FOLDERS, SETS, WRITERS, Stage, contents

pytestmark = pytest.mark.fault
EVERY = (*FOLDERS, *WRITERS, *SETS, *FORMATS, *COMMANDS)


@pytest.mark.parametrize("stage", EVERY, ids=lambda stage: stage.name)
def test_files_that_may_not_grow(stage: Stage, tmp_path: Path) -> None:
    out = stage.prepared(tmp_path / "undisturbed")
    before = contents(out)
    stage.work(out)
    largest = max((path.stat().st_size for path in out.rglob("*") if path.is_file()), default=2)
    for limit in (0, largest // 2):
        out = stage.prepared(tmp_path / str(limit))
        outcome = limited(lambda out=out: stage.work(out), limit)  # type: ignore[misc]
        assert outcome.code == 75, outcome.told
        assert outcome.told.startswith("slamsim: ") and outcome.told.count("\n") == 1
        assert str(out) in outcome.told
        assert contents(out) == before or (stage.in_parts and not vouched(out))
        if not stage.in_parts:
            assert [path.name for path in out.parent.iterdir()] == (["out"] if before else [])
