"""A production that is ended at random moments, again and again, leaves what an undisturbed one
leaves; ``python tests/robustness/long_run.py kills`` does the same to whole commands."""

from __future__ import annotations

import random
import signal
import subprocess
import time
from contextlib import suppress
from pathlib import Path

import pytest
from dataset_run import SHARD, end, make, runs, start, tree, workers_of
from waiting import TIMEOUT_S, wait_for

from slamsim.dataset.make.engines.local import WorkEngine

pytestmark = pytest.mark.fault

COUNT = 6 * SHARD
WORKING_S = 4.0
ENDINGS = (signal.SIGKILL, signal.SIGTERM, signal.SIGKILL, signal.SIGINT, signal.SIGKILL)


def made(folder: Path) -> dict[str, bytes]:
    """The finished sequences."""
    marks = folder.glob("*/*/sequence.json")
    return {str(path.parent.relative_to(folder)): path.read_bytes() for path in marks}


def test_nothing_that_was_finished_is_lost_and_the_end_is_the_same(
    one_worker: WorkEngine, tmp_path: Path
) -> None:
    orders, folder, chance = tmp_path / "orders", tmp_path / "set", random.Random(1)
    orders.mkdir()
    make(tmp_path / "undisturbed", orders, COUNT, one_worker)
    for number in ENDINGS:
        before = made(folder)
        with start(folder, orders, COUNT, 2, 0.1) as process:
            _wait_for_more(folder, len(before), process)
            time.sleep(chance.uniform(0.0, 0.3))
            workers = workers_of(process.pid)
            end(process.pid, number)
            process.wait(TIMEOUT_S)
        wait_for(lambda: not any(map(runs, workers)))  # noqa: B023
        after = made(folder)
        assert before.items() <= after.items()
    assert make(folder, orders, COUNT, one_worker).failures == ()
    assert tree(folder) == tree(tmp_path / "undisturbed")


def _wait_for_more(folder: Path, than: int, process: subprocess.Popen[str]) -> None:
    with suppress(subprocess.TimeoutExpired):
        end_s = time.monotonic() + WORKING_S
        while len(made(folder)) <= than and time.monotonic() < end_s:
            process.wait(0.05)
