"""A long production among murderers: every two seconds a worker dies, now and then the run."""

from __future__ import annotations

import random
import signal
import time
from pathlib import Path

import pytest
from dataset_run import SHARD, end, make, start, tree, workers_of

from slamsim.dataset.engines.local import LocalEngine

SHARDS = 500
SECONDS = 0.02
RUN_KILLED_EVERY_S = 30.0


@pytest.mark.slow
def test_what_is_left_is_what_an_undisturbed_run_leaves(tmp_path: Path) -> None:
    count, orders, folder = SHARDS * SHARD, tmp_path / "orders", tmp_path / "set"
    orders.mkdir()
    make(tmp_path / "undisturbed", orders, count, LocalEngine(2))
    chance, killed, runs = random.Random(1), 0, 0
    while True:
        runs += 1
        begin_s = time.monotonic()
        with start(folder, orders, count, 3, SECONDS) as process:
            while process.poll() is None:
                time.sleep(2.0)
                if workers := workers_of(process.pid):
                    end(chance.choice(workers), signal.SIGKILL)
                    killed += 1
                if time.monotonic() - begin_s > RUN_KILLED_EVERY_S:
                    end(process.pid, signal.SIGKILL)
        if process.returncode == 0:
            break
    assert killed > 5 and runs > 1
    assert make(folder, orders, count, LocalEngine(2)).failures == ()  # the unluckiest
    assert tree(folder) == tree(tmp_path / "undisturbed")
