"""Processes that work for this one, and what becomes of them."""

from __future__ import annotations

import os
import signal

from waiting import wait_for

from slamsim.process.worker import Worker, fair_share_bytes


def test_a_process_that_dies_with_nothing_to_do_is_replaced() -> None:
    worker = Worker(fair_share_bytes(2))
    try:
        first = worker.run(os.getpid, 60.0)
        os.kill(first, signal.SIGKILL)
        wait_for(lambda: worker._pool is not None and not worker._pool.active)
        assert worker.run(os.getpid, 60.0) != first
    finally:
        worker.stop()
        worker.close()
