"""Live drives on the smallest world: the same bytes as ``simulate``, and as their replay."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import numpy as np
import pytest
from waiting import wait_for

from slamsim.config.loading import load_run_config
from slamsim.config.run import RunConfig
from slamsim.console.reporter import Reporter
from slamsim.guard.errors import InputRefused, NotFound, SlamsimError
from slamsim.guard.numbers import BadNumbers
from slamsim.io.open import read_truth
from slamsim.io.text.tum import write_tum
from slamsim.live.controls import LiveOptions
from slamsim.live.hub import Message
from slamsim.live.loop import ROUTE_TICKS, UNPACED_TICKS, LiveLoop, LiveSetup
from slamsim.live.loop_controls import LoopControls
from slamsim.live.mapping import MappingProcess
from slamsim.live.recording import read_drive
from slamsim.live.robot import Driver, LiveRobot, Window
from slamsim.run.live.world import live_config, replay_drive
from slamsim.sim.drive.drive_loop import BasePose
from slamsim.sim.drive.legs import Route
from slamsim.simulation.simulate import simulate
from slamsim.world.build import build_world

QUIET = Reporter(quiet=True)
SHORT = "drive.route.max_duration_s=12"
"""Longer than a window of ``simulate``, so that its odometry goes over a border."""


def _config(*settings: str) -> RunConfig:
    return live_config(load_run_config("tiny", None, settings))


def _loop(
    config: RunConfig, folder: Path, process: MappingProcess | None = None, **options: object
) -> LiveLoop:
    lived = LiveOptions(rate=None, **options)  # type: ignore[arg-type]
    return LiveLoop(LiveSetup.built(config, folder, lived), process)


def _files(folder: Path) -> dict[str, bytes]:
    found = {str(p.relative_to(folder)): p for p in sorted(folder.rglob("*")) if p.is_file()}
    return {name: path.read_bytes() for name, path in found.items()}


@pytest.mark.long
def test_tour_is_recorded_as_simulate_does(tmp_path: Path) -> None:
    config = _config(SHORT)
    loop = _loop(config, tmp_path, mode="tour", record=True, until_done=True)
    loop.run()
    simulate(config, tmp_path / "log")
    assert _files(tmp_path / "drive_1" / "log") == _files(tmp_path / "log")


def test_replay_gives_the_same_folder(tmp_path: Path) -> None:
    """Also where the recording began during the drive, and the twists came from outside."""
    config = _config("sensors.lidar=lds_01")
    loop = _loop(config, tmp_path)
    controls, rng = LoopControls(loop), np.random.default_rng(1)
    thread = threading.Thread(target=loop.run)
    thread.start()
    _drive_at_random(controls, rng)
    controls.record(True)
    _drive_at_random(controls, rng)
    folder = controls.record(False)
    loop.stop()
    thread.join()
    assert folder == tmp_path / "drive_1"
    drive = read_drive(folder)
    assert drive.first_tick > 0 and len({twist for _, twist in drive.commands}) > 3
    replay_drive(folder, tmp_path / "again", QUIET)
    assert _files(tmp_path / "again") == _files(folder)
    recorded = read_truth(folder / "log")
    assert recorded is not None
    write_tum(tmp_path / "recorded.tum", recorded)
    assert (tmp_path / "recorded.tum").read_bytes() == (folder / "ground_truth.tum").read_bytes()


def _drive_at_random(controls: LoopControls, rng: np.random.Generator) -> None:
    """Ten twists, each of which is driven, however busy the machine is."""
    for _ in range(10):
        controls.drive(rng.uniform(-1.0, 1.0), rng.uniform(-1.0, 1.0), 0.05)
        _wait_for_time_after(controls, controls.status().stamp_ns)


def _wait_for_time_after(controls: LoopControls, stamp_ns: int) -> None:
    wait_for(lambda: controls.status().stamp_ns > stamp_ns)


def test_messages_come_in_order_and_latched_ones_first(tmp_path: Path) -> None:
    loop = _loop(_config(), tmp_path, mode="tour", duration_s=2.0)
    heard: list[Message] = []
    loop.hub.listen(heard.append)
    loop.run()
    stamps = [message.log_ns for message in heard]
    assert stamps == sorted(stamps)
    assert {message.topic.name for message in heard} >= {"/scan", "/odom", "/tf", "/tf_static"}
    late: list[Message] = []
    loop.hub.listen(late.append)
    assert {message.topic.name for message in late} == {"/tf_static", "/robot_description"}


def test_pause_step_reset_and_rate(tmp_path: Path) -> None:
    loop = _loop(_config(), tmp_path)
    controls = LoopControls(loop)
    thread = threading.Thread(target=loop.run)
    thread.start()
    try:
        controls.pause(True)
        wait_for(lambda: controls.status().paused)
        held = controls.status().stamp_ns
        time.sleep(0.1)
        assert controls.status().stamp_ns == held
        controls.step(0.5)
        wait_for(lambda: controls.status().stamp_ns == held + 500_000_000)
        controls.set_rate(2.0)
        wait_for(lambda: controls.status().rate == 2.0)
        assert controls.status().paused
        controls.reset()
        assert controls.status().stamp_ns <= loop.begun_ns + held
        controls.pause(False)
        wait_for(lambda: controls.status().stamp_ns > loop.begun_ns)
    finally:
        loop.stop()
        thread.join()


def test_a_loop_that_is_late_takes_longer_windows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each window costs more than it lasts here: its usual ticks would be later and later."""
    config = _config()
    advance, tick_s = LiveRobot.advance, 1.0 / config.drive.follow.control_rate_hz
    ticks: list[int] = []

    def slowly(robot: LiveRobot, wanted: int, driver: Driver) -> Window:
        ticks.append(wanted)
        time.sleep(1.2 * ROUTE_TICKS * tick_s)
        return advance(robot, wanted, driver)

    monkeypatch.setattr(LiveRobot, "advance", slowly)
    loop = _loop(config, tmp_path, mode="tour", duration_s=2.0)
    loop.set_pace(1.0, paused=False)
    loop.run()
    lived = ticks[1:]  # the first is that of the warm-up
    assert lived[0] == ROUTE_TICKS and max(lived) <= UNPACED_TICKS
    assert len(lived) < sum(lived) / ROUTE_TICKS / 1.2, "as long as they are late"


@pytest.mark.parametrize("twist", [(np.nan, 0.0), (0.0, np.inf), (1e300, 0.0)])
def test_bad_twists_are_refused(tmp_path: Path, twist: tuple[float, float]) -> None:
    loop = _loop(_config(), tmp_path)
    controls = LoopControls(loop)
    with pytest.raises(BadNumbers):
        controls.drive(*twist)
    for rate in (0.0, np.nan, 1e6):
        with pytest.raises(BadNumbers):
            controls.set_rate(rate)
    for seconds in (0.0, -1.0, 1e6):
        with pytest.raises(BadNumbers):
            controls.step(seconds)


def test_a_fast_twist_is_cut_down_to_the_limits(tmp_path: Path) -> None:
    config = _config()
    loop = _loop(config, tmp_path, duration_s=3.0)
    LoopControls(loop).drive(1e9, -1e9, 60.0)
    loop.steering.begin = lambda mode: None  # type: ignore[method-assign] # which would stand
    loop.run()
    limits = config.drive.limits
    assert loop.status.speed_m_s == limits.max_speed_m_s
    assert loop.status.yaw_rate_rad_s == -limits.max_yaw_rate_rad_s


def test_what_is_asked_of_a_robot_that_has_ended_is_refused(tmp_path: Path) -> None:
    loop = _loop(_config(), tmp_path, duration_s=0.1)
    loop.run()
    with pytest.raises(SlamsimError, match="has ended"):
        LoopControls(loop).record(True)


def test_map_and_goals_need_a_map(tmp_path: Path) -> None:
    controls = LoopControls(_loop(_config(), tmp_path))
    with pytest.raises(SlamsimError, match="no map yet"):
        controls.save_map()
    with pytest.raises(SlamsimError, match="no map yet"):
        controls.go_to(1.0, 1.0)


@pytest.mark.parametrize(("bumped", "told"), [(False, "reached"), (True, "not reached")])
def test_what_became_of_a_goal_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bumped: bool, told: str
) -> None:
    loop = _loop(_config("drive.follow.final_standstill_s=0"), tmp_path)
    monkeypatch.setattr(loop.known, "pose", lambda: np.zeros(3))
    steering = loop.steering
    steering.go(Route((), np.array([[0.0, 0.1, 0.0], [0.2, 0.0, 0.0]]), 0.02, 0.2))
    goals = [steering.goal]
    for tick in range(200):
        steering.driver.wanted(0.02 * tick, BasePose(0.0, 0.0, 0.0, 0.0, 1.0))
        steering.update(bumped)
        goals.append(steering.goal)
    LoopControls(loop).drive(0.1, 0.0)
    loop.calls.heed()
    assert list(dict.fromkeys([*goals, steering.goal])) == ["driving", told, "none"]


def test_a_robot_that_tipped_over_does_not_reach_its_goal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop = _loop(_config(), tmp_path)
    robot = LiveRobot(loop.setup.config, loop.setup.world, loop.setup.robot, loop.setup.header)
    monkeypatch.setattr(loop, "_robot", robot)
    loop.steering.go(Route((), np.array([[0.0, 0.1, 0.0], [9.0, 0.0, 0.0]]), 0.9, 9.0))
    assert loop._described().goal == "driving"
    robot.ended = "the robot tipped over"
    assert loop._described().goal == "not reached"
    robot.close()


@pytest.mark.long
def test_explore_maps_all_of_a_small_world(tmp_path: Path) -> None:
    config = _config("sensors.lidar=lds_01")
    with MappingProcess() as process:
        loop = _loop(config, tmp_path, process, mode="explore", until_done=True)
        seen: list[str] = []
        loop.hub.listen(lambda message: seen.append(message.topic.name))
        loop.run()
        finished = process.finish()
    assert loop.status.ended == "all that can be reached is mapped"
    truth = build_world(config.world, config.seed).grid(0.05, 0.2)
    known = np.isfinite(finished.grid.occupancy).sum()
    assert known > 0.8 * np.isfinite(truth.occupancy).sum()
    assert {"/map", "/path", "/slamsim/diagnostics"} <= set(seen)
    folder = LoopControls(loop).save_map()
    assert (folder / "map.yaml").is_file() and (folder / "keyframes.csv").is_file()


def test_what_cannot_be_replayed_is_told(tmp_path: Path) -> None:
    with pytest.raises(NotFound, match="has no config"):
        replay_drive(tmp_path, tmp_path / "out", QUIET)


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        ("0,nan,0.0", "finite"),
        ("5,0.1,0.0\n5,0.2,0.0", "rise"),
        ("-1,0.1,0.0", "rise"),
        ("zero,0.1,0.0", "tick"),
        ("0,0.1", "tick"),
    ],
)
def test_damaged_commands_are_refused(tmp_path: Path, rows: str, told: str) -> None:
    (tmp_path / "drive.yaml").write_text("first_tick: 0\nend_tick: 9\n")
    (tmp_path / "commands.csv").write_text(f"tick,v_m_s,w_rad_s\n{rows}\n")
    with pytest.raises(InputRefused, match=told):
        read_drive(tmp_path)


def test_faults_are_refused() -> None:
    config = load_run_config("tiny", None, ())
    faulty = config.model_copy(update={"faults": ("laser_yaw",)})
    with pytest.raises(SlamsimError, match="slamsim fault"):
        live_config(faulty)
