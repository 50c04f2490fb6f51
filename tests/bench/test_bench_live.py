"""The bench of live robots, stopped while a robot lives."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from slamsim.bench.live import measure_live
from slamsim.config.loading import load_run_config
from slamsim.console.reporter import Reporter


class Stopped(BaseException):
    """As a signal is raised."""


@pytest.mark.long
def test_a_robot_ends_before_the_processes_that_it_writes_to(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def stop(done: float, of: float) -> None:
        raise Stopped

    @contextmanager
    def stage(title: str, unit: str) -> Iterator[Callable[[float, float], None]]:
        yield stop

    reporter = Reporter(quiet=True)
    monkeypatch.setattr(reporter, "stage", stage)
    with pytest.raises(Stopped):
        measure_live(load_run_config("tiny", None, ()), 60.0, reporter)
    left = [thread for thread in threading.enumerate() if not thread.daemon]
    assert left == [threading.current_thread()]
