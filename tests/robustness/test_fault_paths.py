"""No file makes slamsim read or write outside the folder that it came in.

What a user types is followed wherever it leads; what a file says, and what lies in a folder as a
link, is not.
"""

from __future__ import annotations

import json
import os
import shutil
import sqlite3
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from fault_path_list import ATTEMPTS
from fault_path_recordings import tables
from fault_paths import Action, Scene, acted, attempt

import slamsim

pytestmark = pytest.mark.fault

_ROOMS = ("inputs", "out", "cwd", "tmp")
"""Parts of a scene that are ours to open, and what belongs to the machine and to Python."""
_MACHINE = ("/dev", "/etc", "/proc", "/sys", "/usr", "/lib", "/var/lib")
_PYTHON = (sys.prefix, sys.base_prefix, *(sysconfig.get_paths()[key] for key in ("stdlib", "data")))
_PACKAGE = Path(slamsim.__file__).parents[1]


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Any]]:
    """All attempts, acted out in one child that would hear of every file it opens."""
    folder = tmp_path_factory.mktemp("scenes")
    (folder / "cache").mkdir()
    program = Path(__file__).parent / "fault_paths.py"
    done = subprocess.run(
        [sys.executable, str(program), str(folder)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={**os.environ, "TMPDIR": str(folder / "cache"), "XDG_CACHE_HOME": str(folder)},
    )
    assert done.returncode == 0, done.stderr[-2000:]
    lines = map(json.loads, done.stdout.splitlines())
    return {line["attempt"]: {**line, "folder": str(folder)} for line in lines}


def test_there_are_many_attempts() -> None:
    assert len(ATTEMPTS) >= 100


@pytest.mark.parametrize("words", ATTEMPTS)
def test_nothing_outside_is_opened_or_changed(words: str, told: dict[str, dict[str, Any]]) -> None:
    found = told[words]
    assert found["crossed"] == []
    assert found["changed"] == []
    assert not found["error"].startswith("odd"), found["words"]


@pytest.mark.parametrize("words", ATTEMPTS)
def test_all_that_python_opens_is_ours_or_the_machines(
    words: str, told: dict[str, dict[str, Any]]
) -> None:
    found = told[words]
    scene = Path(found["folder"]) / f"{list(ATTEMPTS).index(words):02d}"
    ours = (
        *(str(scene / room) for room in _ROOMS),
        *(str(Path(found["folder"]) / shared) for shared in ("cache", "slamsim")),
        *(str(_PACKAGE / part) for part in ("slamsim", "worlds", "configs", "tests")),
    )
    allowed = (*ours, str(scene / ".out.slamsim-lock"), *_MACHINE, *_PYTHON)
    others = [path for path in found["opened"] if not path.startswith(allowed)]
    assert others in ([], [str(scene)])  # where the folder for results is made


@pytest.mark.parametrize("how", ["Python", "SQLite", "Arrow", "a folder", "a change"])
def test_what_crosses_would_be_seen(how: str, tmp_path: Path) -> None:
    def act(scene: Scene) -> Action:
        secret = scene.outside / "scans.parquet"
        shutil.move(tables(scene.root / "made") / "scans.parquet", secret)
        with sqlite3.connect(scene.outside / "s.db3") as db:
            db.execute("create table t (x)")
        acts: dict[str, Action] = {
            "Python": secret.read_bytes,
            "SQLite": lambda: sqlite3.connect(scene.outside / "s.db3").execute("select * from t"),
            "Arrow": lambda: pq.read_table(str(secret)),
            "a folder": lambda: list(scene.outside.iterdir()),
            "a change": secret.unlink,
        }
        return acts[how]

    attempt(f"control: {how}")(act)
    here = Path.cwd()
    try:
        found = acted(f"control: {how}", tmp_path / "scene")
    finally:
        os.chdir(here)
        del ATTEMPTS[f"control: {how}"]
    assert found.crossed
