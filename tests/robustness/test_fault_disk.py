"""The n-th thing that is asked of the disk fails, or the process dies there: one of each kind of
call, and in the slow tests every one.

After each: nothing half-written under a final name, what stood there before stands or the new is
whole, the exit code and one sentence tell, and the same command again succeeds with equal bytes.
With commands too: ``python tests/robustness/long_run.py disk``.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from fault_disk import KILL, Call, Kill, require_watching, watched
from fault_nth import FAULTS

from slamsim.guard.output import partial_folder, write_atomic

pytestmark = pytest.mark.fault


def struck(every: int, *plans: str) -> int:
    """How many strikes there were; fails with each promise that was broken."""
    require_watching()
    program = str(Path(__file__).with_name("fault_nth.py"))
    done = subprocess.run(
        [sys.executable, program, str(every), *plans],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
    )
    *broken, counts = done.stdout.splitlines() or ["{}"]
    assert not broken and done.returncode == 0, "\n".join([*broken, done.stderr[-2000:]])
    return int(json.loads(counts)["struck"])


@pytest.mark.long
def test_each_kind_of_call_of_all_that_writes() -> None:
    """Six kinds at least of each stage: four of folders and files, two of formats, two of sets."""
    plans = ("folders:full,broken,killed", "writers:full", "sets:full,killed")
    assert struck(0, *plans) >= 6 * (3 * 4 + 2 + 2 * 2)


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("group", ["folders", "writers", "sets"])
def test_every_call_and_every_fault(group: str, fault: str) -> None:
    assert struck(1, f"{group}:{fault}") > 30


def test_what_is_asked_of_the_disk_is_seen_in_order(tmp_path: Path) -> None:
    require_watching()

    def work() -> None:
        write_atomic(tmp_path / "file", b"data")

    calls = watched(work, tmp_path, lambda number, call: None).calls
    unfinished = calls[1].path
    assert re.fullmatch(r"\.file\.slamsim-[0-9a-f]{16}", unfinished)
    assert calls == [
        Call("mkdir", "."),
        Call("open", unfinished),
        Call("write", unfinished),
        Call("fsync", unfinished),
        Call("close", unfinished),
        Call("rename", "file"),
        Call("fsync", "."),
    ]


def test_a_folder_gets_its_name_when_all_of_it_is_on_the_disk(tmp_path: Path) -> None:
    """The order that a power cut would need: contents, folders, new name, the folder above."""
    require_watching()

    def work() -> None:
        with partial_folder(tmp_path / "run") as folder:
            (folder / "log").mkdir()
            (folder / "log" / "data").write_bytes(b"data")
            (folder / "map.pgm").write_bytes(b"map")

    outcome = watched(work, tmp_path, lambda number, call: None)
    calls, synced = outcome.calls, set[str]()
    named = calls.index(Call("rename", "run"))
    for call in calls[:named]:
        if call.kind == "fsync":
            synced.add(call.path)
        elif call.kind in ("write", "open", "mkdir", "rename"):
            synced -= {call.path, str(Path(call.path).parent)}
    (new,) = {call.path for call in calls if call.kind == "mkdir" and call.path.endswith("/new")}
    inside = {"", "/.slamsim", "/SHA256SUMS", "/log", "/log/data", "/map.pgm"}
    assert {f"{new}{name}" for name in inside} <= synced
    assert Call("fsync", ".") in calls[named:]
    assert (outcome.code, outcome.told) == (0, "")


def test_where_two_names_cannot_be_exchanged_one_run_is_there_all_the_same(tmp_path: Path) -> None:
    """A file system without the call: the process killed before each of the renames."""
    require_watching()

    def work() -> None:
        with partial_folder(final, overwrite=True) as folder:
            (folder / "data").write_text("new")

    for number in range(4):
        place = tmp_path / str(number)
        final = place / "run"
        with partial_folder(final) as folder:
            (folder / "data").write_text("old")
        renames = iter(range(10))

        def refused(_: int, call: Call, kill: int = number) -> int | Kill | None:
            if call.kind == "exchange":
                return 22
            renamed = call.kind == "rename" and Path(call.path).name in ("run", "old", "new")
            return KILL if renamed and next(renames) == kill else None  # noqa: B023

        outcome = watched(work, place, refused)
        assert outcome.code == (0 if number == 3 else -9)
        with partial_folder(place / "other"):  # another name of the same folder
            pass
        with partial_folder(final, overwrite=True):
            assert (final / "data").read_text() == ("old" if number < 2 else "new")
        assert sorted(path.name for path in place.iterdir()) == ["other", "run"]
