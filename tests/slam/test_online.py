"""A session beside its back end: as good as in line, and not to be brought down."""

from __future__ import annotations

import os
import signal
import time
from functools import cache

import numpy as np
import pytest
from limited_child import running
from simulated import Simulated, ate_rmse_m, labyrinth, simulate
from waiting import wait_for

from slamsim.config.slam import SlamConfig
from slamsim.core.geometry import between
from slamsim.core.result import SlamResult
from slamsim.core.types import PlanarTrajectory
from slamsim.slam.frontend.tracking import Step
from slamsim.slam.online.async_back_end import MAX_RESTARTS, AsyncBackEnd
from slamsim.slam.online.replay import replay
from slamsim.slam.session import SlamSession, open_session, run_slam


@cache
def example() -> Simulated:
    walls, tour = labyrinth(seed=2, cells=3)
    return simulate(walls, tour, seed=2, max_s=30.0)


def opened() -> SlamSession:
    log = example().log
    return open_session(SlamConfig(), log.T_base_laser, log.T_base_imu)


def beside(session: SlamSession) -> AsyncBackEnd:
    assert isinstance(session.keeper, AsyncBackEnd)
    return session.keeper


def drive(session: SlamSession, scans: slice = slice(None)) -> list[Step]:
    """The example's scans, as slowly as the back end needs to keep near."""
    steps = []
    for scan, samples in list(replay(example().log))[scans]:
        step = session.step(scan, samples)
        assert step is not None
        steps.append(step)
        while beside(session).process_id is not None and beside(session).behind > 5:
            time.sleep(0.01)
            beside(session).correction()
    return steps


def is_alive(process: int | None) -> bool:
    if process is None:
        return False
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def live(steps: list[Step]) -> PlanarTrajectory:
    stamps_ns = np.array([step.stamp_ns for step in steps])
    return PlanarTrajectory(stamps_ns, np.array([step.T_map_base for step in steps]))


@cache
def driven() -> tuple[list[Step], SlamResult]:
    """All of the example on line."""
    with opened() as session:
        return drive(session), session.finish()


@pytest.mark.long
def test_on_line_is_as_good_as_over_the_whole_log() -> None:
    steps, result = driven()
    whole = run_slam(example().log, SlamConfig(calibrate_laser=False))  # as on line
    assert np.array_equal(result.trajectory.stamps_ns, whole.trajectory.stamps_ns)
    # On line nobody knows the gyroscope's bias before the robot has stood for a while.
    off = between(whole.trajectory.poses, result.trajectory.poses)[15:]
    assert np.hypot(off[:, 0], off[:, 1]).max() < 0.01 and np.abs(off[:, 2]).max() < 0.005
    assert result.closures_accepted > 0
    assert ate_rmse_m(live(steps), example().truth) < 0.02


@pytest.mark.long
def test_steps_tell_smooth_odometry_quality_and_covariances() -> None:
    steps, _ = driven()
    odom = np.array([step.T_odom_base for step in steps])
    assert np.abs(np.diff(odom[:, :2], axis=0)).max() < 0.06  # half a metre per second
    assert all(step.status == "tracking" and step.match_quality > 0.5 for step in steps[1:])
    assert all(step.degenerate_directions.shape[1] == 3 for step in steps)
    for step in steps[20:]:
        assert np.linalg.eigvalsh(step.covariance).min() > -1e-12
        carried = between(np.zeros(3), step.T_map_odom)
        assert np.isfinite(carried).all()


@pytest.mark.long
def test_a_killed_back_end_is_told_and_begun_again_with_all_it_knew() -> None:
    with opened() as session:
        drive(session, slice(150))
        before = beside(session)
        assert before.process_id is not None
        os.kill(before.process_id, signal.SIGKILL)
        steps = drive(session, slice(150, None))
        events = [event for step in steps for event in step.events]
        result = session.finish()
    assert len(events) == 1 and "begun again" in events[0].words
    assert result.closures_accepted > 0
    assert ate_rmse_m(result.trajectory, example().truth) < 0.01


@pytest.mark.long
def test_a_stopped_back_end_is_begun_again_at_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slamsim.process.children.HALTED_S", 1.0)
    with opened() as session:
        drive(session, slice(50))
        process = beside(session).process_id
        assert process is not None
        os.kill(process, signal.SIGSTOP)
        result = session.finish()
    assert "begun again" in " ".join(event.words for event in result.events)
    assert ate_rmse_m(result.trajectory, example().truth) < 0.01


def test_a_back_end_that_keeps_dying_leaves_the_odometry() -> None:
    with opened() as session:
        for number in range(MAX_RESTARTS + 1):
            process = beside(session).process_id
            assert process is not None
            os.kill(process, signal.SIGKILL)
            while beside(session).process_id == process:
                drive(session, slice(number, number + 1)) if len(session) <= number else None
                beside(session).correction()
        assert beside(session).process_id is None
        steps = drive(session, slice(MAX_RESTARTS + 1, 60))
        assert all(step.status == "tracking" for step in steps)
        result = session.finish()
    assert any("not begun again" in event.words for event in result.events)
    assert np.isfinite(result.trajectory.poses).all()


def test_closing_in_the_middle_leaves_no_process() -> None:
    with opened() as session:
        drive(session, slice(60))
        process = beside(session).process_id
        assert is_alive(process)
    assert not is_alive(process)
    session.close()


def test_the_back_end_ends_with_its_parent() -> None:
    code = (
        "import time\n"
        "from slamsim.config.slam import SlamConfig\n"
        "from slamsim.slam.online.async_back_end import AsyncBackEnd\n"
        "print(AsyncBackEnd(SlamConfig()).process_id, flush=True)\n"
        "time.sleep(60)\n"
    )
    with running(code) as parent:
        assert parent.stdout is not None
        process = int(parent.stdout.readline())
        assert is_alive(process)
        parent.kill()
        wait_for(lambda: not is_alive(process))
