"""A drive in a process of its own: the same bytes, and no process left behind."""

from __future__ import annotations

import os
import signal
import threading
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from drive_worlds import hall

from slamsim.config.drive import DriveConfig
from slamsim.config.robot import RobotConfig
from slamsim.core.types import Drive
from slamsim.guard.errors import SlamsimError
from slamsim.process.children import MEMORY, peak_memory_mb
from slamsim.process.worker import WorkerDied, Workers
from slamsim.sim.drive.process import DriveProcess
from slamsim.sim.drive.route import plan_route
from slamsim.sim.drive.run import DriveRun
from slamsim.sim.robot.model import build_robot

CONFIG = DriveConfig.model_validate(
    {"route": {"max_duration_s": 6.0}, "physics": {"window_s": 1.0}}
)
WORLD = hall(3.0, visits=[(2.0, 2.0), (-2.0, -1.0)])
ROBOT = build_robot(RobotConfig())
ROUTE = plan_route(WORLD, ROBOT, CONFIG)


def children() -> set[int]:
    task = Path(f"/proc/{os.getpid()}/task")
    found = (thread / "children" for thread in task.iterdir())
    return {int(pid) for path in found for pid in path.read_text().split()}


def test_the_windows_are_those_of_a_drive_in_this_process() -> None:
    here = DriveRun(WORLD, ROBOT, ROUTE, CONFIG)
    told: list[float] = []
    with DriveProcess() as process:
        with pytest.raises(RuntimeError, match="outcome"):
            _ = process.outcome
        there = process.drive(
            WORLD, ROBOT, ROUTE, CONFIG, lambda done, total: told.append(done / total)
        )
        for one, other in zip(here, there, strict=True):
            for column in fields(Drive):
                np.testing.assert_array_equal(
                    getattr(one, column.name), getattr(other, column.name)
                )
        assert process.outcome == here.outcome
    assert told == sorted(told)
    assert told[-1] <= 1.0


def test_giving_up_half_way_leaves_no_process_behind() -> None:
    before = children()
    with DriveProcess() as process:
        next(process.drive(WORLD, ROBOT, ROUTE, CONFIG))
        assert len(children() - before) == 1
    assert children() == before


def test_a_killed_engine_is_told() -> None:
    before = children()
    with DriveProcess() as process:
        windows = process.drive(WORLD, ROBOT, ROUTE, CONFIG)
        next(windows)
        (child,) = children() - before
        os.kill(child, signal.SIGKILL)
        with pytest.raises(SlamsimError, match="was ended by SIGKILL"):
            list(windows)


@pytest.mark.parametrize("before_it_begins", [True, False])
def test_a_stopped_engine_is_told(before_it_begins: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slamsim.process.children.HALTED_S", 1.0)
    before = children()
    with DriveProcess() as process:
        (child,) = children() - before
        windows = process.drive(WORLD, ROBOT, ROUTE, CONFIG)
        if before_it_begins:
            os.kill(child, signal.SIGSTOP)
        else:
            next(windows)
            os.kill(child, signal.SIGSTOP)
        with pytest.raises(SlamsimError, match=r"process was stopped \(SIGSTOP\) and did not go"):
            list(windows)
    assert children() == before


def test_an_engine_that_goes_on_in_time_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slamsim.process.children.HALTED_S", 1000.0)
    before = children()
    with DriveProcess() as process:
        (child,) = children() - before
        os.kill(child, signal.SIGSTOP)
        threading.Timer(1.5, os.kill, (child, signal.SIGCONT)).start()
        count = sum(1 for _ in process.drive(WORLD, ROBOT, ROUTE, CONFIG))
        assert count > 0 and process.outcome.finished


def stop_myself() -> None:
    os.kill(os.getpid(), signal.SIGSTOP)


@pytest.mark.long
def test_a_stopped_worker_is_told_and_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slamsim.process.children.HALTED_S", 1.0)
    with Workers(1) as workers:
        with pytest.raises(WorkerDied, match="was stopped"):
            workers.submit(stop_myself, 100.0).result()
        assert workers.submit(os.getpid, 100.0).result() > 0


def test_the_memory_of_the_process_is_its_own_and_counts_while_it_runs() -> None:
    held = np.ones(40_000_000)  # 320 MB, which a started process has before it becomes another
    before = children()
    with DriveProcess() as process:
        windows = process.drive(WORLD, ROBOT, ROUTE, CONFIG)
        next(windows)
        (pid,) = children() - before
        theirs_mb = peak_memory_mb(pid)
        assert 10.0 < theirs_mb < held.nbytes * 1e-6
        assert MEMORY.peak_mb() > peak_memory_mb() - 1.0
        assert MEMORY.peak_mb() >= theirs_mb + held.nbytes * 1e-6
        list(windows)
    assert peak_memory_mb(pid) == 0.0
