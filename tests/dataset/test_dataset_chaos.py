"""A long production among murderers: every two seconds a worker dies, now and then the run."""

from __future__ import annotations

import random
import signal
import subprocess
import time
from pathlib import Path

import pytest
from dataset_run import SHARD, end, make, start, tree, workers_of

from slamsim.dataset.make.engines.local import LocalEngine

SHARDS = 500
SECONDS = 0.02
KILL_EVERY_S = 2.0
LEAST_MADE = 50
"""New sequences between two murders: a slow machine still gets on."""
KILLS_OF_A_RUN = 6


@pytest.mark.slow
def test_what_is_left_is_what_an_undisturbed_run_leaves(tmp_path: Path) -> None:
    count, orders, folder = SHARDS * SHARD, tmp_path / "orders", tmp_path / "set"
    orders.mkdir()
    make(tmp_path / "undisturbed", orders, count, LocalEngine(2))
    chance, killed, runs = random.Random(1), 0, 0
    while True:
        runs += 1
        with start(folder, orders, count, 3, SECONDS) as process:
            for _ in range(KILLS_OF_A_RUN):
                if _ended_before_more(process, folder):
                    break
                end(chance.choice(workers_of(process.pid) or [process.pid]), signal.SIGKILL)
                killed += 1
            end(process.pid, signal.SIGKILL)
        if process.returncode == 0:
            break
    assert killed > 10 and runs > 2
    assert make(folder, orders, count, LocalEngine(2)).failures == ()  # the unluckiest
    assert tree(folder) == tree(tmp_path / "undisturbed")


def _ended_before_more(process: subprocess.Popen[str], folder: Path) -> bool:
    """Wait for the next murder."""
    begin_s, before = time.monotonic(), _made(folder)
    while process.poll() is None:
        time.sleep(0.2)
        if time.monotonic() > begin_s + KILL_EVERY_S and _made(folder) >= before + LEAST_MADE:
            return False
    return True


def _made(folder: Path) -> int:
    return len(list(folder.glob("t*/*"))) + len(list(folder.glob("val/*")))
