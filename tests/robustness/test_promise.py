"""Whatever is typed among files of the user, and however it ends: not one of them is changed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import promise
import pytest
from fault_disk import require_watching
from promise_arguments import Command
from promise_endings import Ended, Ending
from promise_oracle import Before, Judge

pytestmark = pytest.mark.fault

JOBS = 2


@pytest.mark.long
@pytest.mark.parametrize(
    "seeds", [range(8, 16), pytest.param(range(40), marks=pytest.mark.slow)], ids=str
)
def test_commands_at_random_change_nothing_that_is_not_theirs(seeds: range) -> None:
    require_watching()
    found = list(promise.lines_of(seeds, None, jobs=JOBS, slow=False))
    broken = [f"{promise.repeat(line)}\n  {line}" for line in found if line["broken"]]
    assert not broken, "\n".join(broken)
    assert len(found) == len(seeds)
    codes = {line["code"] for line in found}
    assert codes > {0, 1, 3, -9}, "the commands succeed, are refused and are killed"


def _sealed(folder: Path) -> None:
    """As slamsim leaves a folder."""
    folder.mkdir()
    (folder / ".slamsim").write_text("ours\n")
    (folder / "map.png").write_text("old\n")
    lines = subprocess.run(
        ["sha256sum", ".slamsim", "map.png"], cwd=folder, capture_output=True, check=True
    ).stdout
    (folder / "SHA256SUMS").write_bytes(lines)


def _tree(tmp_path: Path) -> Path:
    for name in ("work/outputs", "outside", "home", "tmp"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "work" / "poetry.lock").write_text("mine\n")
    (tmp_path / "work" / "log.mcap").write_text("a recording\n")
    (tmp_path / "outside" / "notes.txt").write_text("mine\n")
    (tmp_path / "work" / "link").symlink_to("../outside")
    _sealed(tmp_path / "work" / "run")
    return tmp_path


def _rewritten(path: Path) -> None:
    """The same bytes at another time: it was written, and what was lost between nobody knows."""
    state = path.stat()
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns + 1))


def _led_elsewhere(link: Path) -> None:
    link.unlink()
    link.symlink_to(".")


_HARM: dict[str, Callable[[Path], object]] = {
    "a neighbour is emptied": lambda root: (root / "work/poetry.lock").write_text(""),
    "a neighbour is gone": lambda root: (root / "work/poetry.lock").unlink(),
    "a neighbour is renamed": lambda root: (root / "work/poetry.lock").rename(root / "work/p.old"),
    "a neighbour is written again": lambda root: _rewritten(root / "work/poetry.lock"),
    "its mode is another": lambda root: (root / "work/poetry.lock").chmod(0o600),
    "through a link": lambda root: (root / "work/link/notes.txt").write_text("theirs\n"),
    "a link leads elsewhere": lambda root: _led_elsewhere(root / "work/link"),
    "the input": lambda root: (root / "work/log.mcap").write_text("another\n"),
    "something new beside it": lambda root: (root / "work/out.lock").write_text("lock\n"),
    "something at home": lambda root: (root / "home/.slamsimrc").write_text("new\n"),
    "a temporary file": lambda root: (root / "tmp/tmp123").mkdir(),
    "another run": lambda root: (root / "work/run/map.png").write_text("new\n"),
    "its lock stays": lambda root: (root / "work/.out.slamsim-lock").write_text("{}\n"),
}


@pytest.mark.parametrize("harm", _HARM.values(), ids=_HARM)
def test_the_judge_sees_every_harm(harm: Callable[[Path], object], tmp_path: Path) -> None:
    root = _tree(tmp_path)
    command = Command("map", ["log.mcap", "--out", "out"], folder="out", overwrite=True)
    before = Before.of(root)
    judge = Judge(root, command, before, set())
    ended = Ended(3, "slamsim: log.mcap: damaged\n")
    assert not list(judge.broken(ended, Ending(), before.there))
    harm(root)
    assert list(judge.broken(ended, Ending(), Before.of(root).there))


@pytest.mark.parametrize(
    ("ended", "ending"),
    (
        (Ended(99, ""), Ending()),
        (Ended(143, ""), Ending()),
        (Ended(1, "Traceback (most recent call last):\n"), Ending()),
        (Ended(0, "", hung=True), Ending()),
        (Ended(0, "", left=True), Ending("SIGTERM", 1.0)),
    ),
)
def test_the_judge_sees_how_it_ended(ended: Ended, ending: Ending, tmp_path: Path) -> None:
    before = Before.of(_tree(tmp_path))
    judge = Judge(tmp_path, Command("config"), before, set())
    assert not list(judge.broken(Ended(0, ""), Ending(), before.there))
    assert list(judge.broken(ended, ending, before.there))


@pytest.mark.parametrize("note", ("", "notes.txt"))
@pytest.mark.parametrize("overwrite", (True, False))
def test_a_run_is_replaced_only_if_all_in_it_is_slamsims(
    note: str, overwrite: bool, tmp_path: Path
) -> None:
    root = _tree(tmp_path)
    run = root / "work" / "run"
    if note:
        (run / note).write_text("mine\n")
    before = Before.of(root)
    command = Command("map", ["log.mcap", "--out", "run"], folder="run", overwrite=overwrite)
    for path in run.iterdir():
        path.unlink()
    run.rmdir()
    _sealed(run)
    found = list(
        Judge(root, command, before, set()).broken(Ended(0, ""), Ending(), Before.of(root).there)
    )
    assert bool(found) == (bool(note) or not overwrite)


def test_a_line_repeats_its_case() -> None:
    line = json.loads('{"name": "seed 7"}')
    assert promise.repeat(line, slow=True).endswith("promise.py --seeds 7:8 --slow")
    assert sys.executable in promise.repeat(line)
