"""What servers of a live robot are tried with: its topics, controls that note what is asked."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from slamsim.config.loading import load_run_config
from slamsim.guard.errors import SlamsimError
from slamsim.guard.numbers import require_number
from slamsim.io.bag2.writer import TopicKind
from slamsim.live.controls import HOLD_S, Mode, Status
from slamsim.live.drivers import ManualDriver
from slamsim.live.hub import Hub
from slamsim.live.robot import LiveRobot
from slamsim.sim.robot.model import build_robot
from slamsim.simulation.header import log_header
from slamsim.simulation.recorder import TOPICS
from slamsim.world.build import build_world

LATCHED = ("/robot_description", "/tf_static", "/map", "/path")
LIVE_TOPICS = {
    **TOPICS,
    "/map": "nav_msgs/msg/OccupancyGrid",
    "/path": "nav_msgs/msg/Path",
    "/slamsim/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}


def live_hub() -> Hub:
    """With all topics of a live robot."""
    return Hub(TopicKind(name, kind, name in LATCHED) for name, kind in LIVE_TOPICS.items())


STANDING = Status(
    stamp_ns=12_000_000_034,
    rate=1.0,
    realtime_factor=1.0,
    paused=False,
    mode="tour",
    windows=0,
    late_windows=0,
    speed_m_s=0.0,
    yaw_rate_rad_s=0.0,
    recording=None,
    tracking="off",
    keyframes=0,
    closures=0,
    ended="",
)


@dataclass
class NotedControls:
    """Of a robot that stands still. asked: each call in order, with its arguments."""

    asked: list[tuple[object, ...]] = field(default_factory=list)
    now: Status = STANDING

    def drive(self, speed_m_s: float, yaw_rate_rad_s: float, hold_s: float = HOLD_S) -> None:
        for value in (speed_m_s, yaw_rate_rad_s, hold_s):
            require_number("a twist", value)
        self.asked.append(("drive", speed_m_s, yaw_rate_rad_s))

    def go_to(self, x_m: float, y_m: float, yaw_rad: float | None = None) -> None:
        for value in (x_m, y_m, 0.0 if yaw_rad is None else yaw_rad):
            require_number("a goal", value)
        if abs(x_m) > 100.0:
            raise SlamsimError("no free path leads there")
        self.asked.append(("go_to", x_m, y_m, yaw_rad))

    def set_mode(self, mode: Mode) -> None:
        self._become("set_mode", mode=mode)

    def pause(self, paused: bool) -> None:
        self._become("pause", paused=paused)

    def step(self, seconds: float) -> None:
        require_number("a step", seconds, 0.0, 60.0)
        self.asked.append(("step", seconds))

    def set_rate(self, rate: float | None) -> None:
        if rate is not None:
            require_number("a rate", rate, 0.01, 100.0)
        self._become("set_rate", rate=rate)

    def reset(self) -> None:
        self.asked.append(("reset",))

    def record(self, on: bool) -> Path | None:
        self._become("record", recording=Path("drive_1") if on else None)
        return Path("drive_1")

    def save_map(self) -> Path:
        raise SlamsimError("there is no map: SLAM is off")

    def status(self) -> Status:
        return self.now

    def _become(self, what: str, **changed: object) -> None:
        self.now = replace(self.now, **changed)  # type: ignore[arg-type]
        self.asked.append((what, *changed.values()))


def short_drive(world: str, seconds: float = 1.0) -> list[tuple[str, int, bytes]]:
    """(topic, log time, bytes) of all messages of a robot that drives ahead, by their times."""
    config = load_run_config(world, "labyrinth_10hz", seed=1)
    built, model = build_world(config.world, 1), build_robot(config.robot)
    robot = LiveRobot(config, built, model, log_header(model, config))
    driver = ManualDriver()
    driver.drive(0.3, 0.2, 60.0)
    window = robot.advance(round(seconds / robot.tick_s), driver)
    robot.close()
    found = []
    for stream in window.messages:
        rows = stream.rows(slice(None))
        data = rows.view(np.uint8).reshape(rows.size, -1)
        for log_ns, row in zip(stream.log_ns.tolist(), data, strict=True):
            found.append((stream.topic, log_ns, row.tobytes()))
    return sorted(found, key=lambda message: message[1])
