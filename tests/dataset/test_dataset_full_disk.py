"""Data sets on a disk that is full: a small one of memory, which only root may mount."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from dataset_run import make, start, tree

from slamsim.dataset.make.engines.local import LocalEngine
from slamsim.dataset.make.make import make_dataset
from slamsim.dataset.recipe.loading import load_recipe

COUNT = 4
DISK_BYTES = 512_000_000
"""So ample for so few sequences that no plan is made first."""
PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(os.geteuid() != 0, reason="only root may mount a disk"),
]


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "none", str(folder)]
    mounted = subprocess.run(command, check=False, capture_output=True, text=True)
    if mounted.returncode:
        pytest.skip(f"no disk can be mounted here: {mounted.stderr.strip()}")
    yield folder
    subprocess.run(["umount", "-l", folder], check=True)


def _fill(disk: Path, pages_left: int) -> Path:
    """All of it but so many pages."""
    filler = disk / "filler"
    with filler.open("wb") as file:
        free_pages = os.statvfs(disk).f_bavail - pages_left
        os.posix_fallocate(file.fileno(), 0, free_pages * PAGE_BYTES)
    return filler


def _flood(disk: Path) -> Path:
    """All of it, while others write to it, too."""
    filler = disk / "filler"
    with filler.open("wb", buffering=0) as file:
        for part in (bytes(1 << 20), bytes(PAGE_BYTES)):
            with suppress(OSError):
                while file.write(part):
                    pass
    return filler


@pytest.mark.parametrize("pages", [0, 1, 2, 4, 7, 8, 13, 14, 15, 16])
def test_whatever_there_is_no_room_for_the_run_says_so_and_the_next_one_goes_on(
    pages: int, disk: Path, tmp_path: Path
) -> None:
    """Lock, identity, a sequence, the log, the row of a shard: each is the first without room."""
    (orders := tmp_path / "orders").mkdir()
    make(tmp_path / "undisturbed", orders, COUNT)
    whole, out = tree(tmp_path / "undisturbed"), disk / "set"
    filler = _fill(disk, pages)
    with start(out, orders, COUNT, 1, 0.0) as process:
        _, told = process.communicate()
    assert process.returncode == 75
    assert told.startswith(f"slamsim: {out}") and told.count("\n") == 1
    assert "No space left on device" in told
    assert tree(out).items() <= whole.items()
    filler.unlink()
    make(out, orders, COUNT)
    assert tree(out) == whole
    assert [path.name for path in disk.iterdir()] == ["set"]


def test_a_disk_too_small_for_the_plan_is_refused_before_anything_is_written(disk: Path) -> None:
    done = _making(disk / "set", 10_000)
    _, told = done.communicate()
    assert done.returncode == 75
    assert "are needed, 512 MB are free" in told and told.count("\n") == 1
    assert not list(disk.iterdir())


def _amid_a_sequence(out: Path) -> bool:
    return bool(list(out.glob(".slamsim-*/*/log")))


def _amid_the_shards(out: Path) -> bool:
    return bool(list(out.glob("shards/*.parquet")))


def _amid_the_catalogue(out: Path) -> bool:
    return (out / "manifest.parquet").exists()


def test_a_disk_that_others_fill_meanwhile_costs_nothing(disk: Path, tmp_path: Path) -> None:
    make_dataset(load_recipe("tiny"), COUNT, str(tmp_path / "undisturbed"), LocalEngine(2))
    whole, out = tree(tmp_path / "undisturbed"), disk / "set"
    for moment in (_amid_a_sequence, _amid_the_shards, _amid_the_catalogue):
        done = _making(out, COUNT)
        _wait_for(moment, out, done)
        filler = _flood(disk)
        _, told = done.communicate()
        assert (done.returncode, told.count("\n")) == (75, 1), told
        assert told.startswith(f"slamsim: {out}") and "No space left on device" in told
        assert tree(out).items() <= whole.items()
        filler.unlink()
    done = _making(out, COUNT)
    assert done.communicate()[1] == "" and done.returncode == 0
    assert tree(out) == whole


def _making(out: Path, count: int) -> subprocess.Popen[str]:
    code = "from slamsim.entry import main; main()"
    words = ["dataset", "make", "tiny", "-n", str(count), "--out", str(out), "--quiet"]
    return subprocess.Popen([sys.executable, "-c", code, *words], stderr=subprocess.PIPE, text=True)


def _wait_for(moment: Callable[[Path], bool], out: Path, process: subprocess.Popen[str]) -> None:
    while not moment(out) and process.poll() is None:
        time.sleep(0.002)
