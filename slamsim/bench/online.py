"""``slamsim bench online``: latency per scan late in a long drive, and growth of memory.

The drive, the sensing and the session run in step: nothing is recorded, so that a drive may be
as long as one likes. The tour of a world is driven again and again until the path is long enough.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from slamsim.bench import Figures
from slamsim.config.run import RunConfig
from slamsim.console.reporter import Reporter
from slamsim.core.geometry import between, compose
from slamsim.core.types import (
    Drive,
    EncoderStream,
    FloatArray,
    ImuStream,
    Log,
    PlanarTrajectory,
    Scan,
)
from slamsim.sensors.readings import Readings
from slamsim.sensors.rig import SensorRig
from slamsim.sim.drive.legs import Route
from slamsim.sim.drive.process import DriveProcess
from slamsim.sim.drive.route import plan_route
from slamsim.sim.robot.model import RobotModel, build_robot
from slamsim.slam.frontend.tracking import Step
from slamsim.slam.online.async_back_end import AsyncBackEnd
from slamsim.slam.online.replay import replay
from slamsim.slam.online.samples import MotionSamples
from slamsim.slam.session import open_session
from slamsim.world.build import build_world

STRETCH_M = 1000.0
MOST_BEHIND = 20
"""The drive waits when the back end is so many key frames behind: a robot takes its time."""


def measure_online(config: RunConfig, path_m: float, reporter: Reporter) -> Figures:
    """Figures of each kilometre of a drive of ``path_m`` through the configured world.

    Latency is that of ``SlamSession.step``, the wall time and the processor time of its thread.
    """
    stretches: list[_Stretch] = []
    with DriveProcess() as process:
        world = build_world(config.world, config.seed)
        robot = build_robot(config.robot)
        route = _again_and_again(plan_route(world, robot, config.drive), path_m)
        windows = process.drive(world, robot, route, config.drive)
        rig = SensorRig(world.mesh, robot, config.sensors, config.seed)
        with (
            open_session(config.slam, robot.T_base_laser, robot.T_base_imu) as session,
            reporter.stage("online", "m/s") as progress,
        ):
            keeper = session.keeper
            assert isinstance(keeper, AsyncBackEnd)
            stretch = _Stretch()
            for scan, samples, truth in _sensed(windows, rig, robot):
                _wait_for(keeper)
                begun_ns, begun_cpu_ns = time.perf_counter_ns(), time.thread_time_ns()
                step = session.step(scan, samples)
                stretch.cpu_ms.append((time.thread_time_ns() - begun_cpu_ns) * 1e-6)
                stretch.wall_ms.append((time.perf_counter_ns() - begun_ns) * 1e-6)
                stretch.see(step, truth)
                if stretch.path_m >= STRETCH_M:
                    stretches.append(stretch.closed(keeper))
                    reporter.say(stretch.words(len(stretches)))
                    stretch = stretch.next()
                progress(min(STRETCH_M * len(stretches) + stretch.path_m, path_m), path_m)
            if stretch.path_m > 0.1 * STRETCH_M or not stretches:
                stretches.append(stretch.closed(keeper))
    return {"world": config.world.name, "kilometres": [one.figures for one in stretches]}


def _again_and_again(route: Route, path_m: float) -> Route:
    """The same tour, which ends where it begins, until it is long enough."""
    times = max(1, int(np.ceil(path_m / route.length_m)))
    return replace(
        route,
        legs=route.legs * times,
        length_m=route.length_m * times,
        duration_estimate_s=route.duration_estimate_s * times,
    )


def _sensed(
    windows: Iterator[Drive], rig: SensorRig, robot: RobotModel
) -> Iterator[tuple[Scan, MotionSamples, FloatArray]]:
    """Each scan with the motion samples until its end, and the true pose at its stamp."""
    before: Readings | None = None
    since_ns = int(np.iinfo(np.int64).min)
    truth: PlanarTrajectory | None = None
    for window in windows:
        now = rig.sense(window)
        seen = window.trajectory().planar()
        if truth is not None:
            seen = PlanarTrajectory(
                np.concatenate([truth.stamps_ns, seen.stamps_ns]),
                np.concatenate([truth.poses, seen.poses]),
            )
        log = _log(before or now, now, robot)
        for number, (scan, samples) in enumerate(replay(log, since_ns)):
            true_ns = np.clip(now.scans.true_stamps_ns[[number]], *seen.stamps_ns[[0, -1]])
            yield scan, samples, seen.at(true_ns)[0]
            since_ns = scan.span_ns[1]
        before, truth = now, window.trajectory().planar()


def _log(before: Readings, now: Readings, robot: RobotModel) -> Log:
    """One window of a recording, with the motion samples of the window before."""
    imu, earlier = now.imu.stream, before.imu.stream
    ticks, rolled = now.encoders.stream, before.encoders.stream
    imu = ImuStream(
        np.concatenate([earlier.stamps_ns, imu.stamps_ns]),
        np.concatenate([earlier.angular_velocity_rad_s, imu.angular_velocity_rad_s]),
        np.concatenate([earlier.linear_acceleration_m_s2, imu.linear_acceleration_m_s2]),
    )
    encoders = EncoderStream(
        np.concatenate([rolled.stamps_ns, ticks.stamps_ns]),
        np.concatenate([rolled.ticks, ticks.ticks]),
        ticks.ticks_per_revolution,
        ticks.wheel_radius_m,
        ticks.track_m,
    )
    return Log("window", "simulation", now.scans, None, imu, encoders, robot.T_base_laser)


def _wait_for(keeper: AsyncBackEnd) -> None:
    while keeper.behind > MOST_BEHIND:
        time.sleep(0.001)
        keeper.correction()


@dataclass(slots=True)
class _Stretch:
    """A kilometre of the drive."""

    wall_ms: list[float] = field(default_factory=list)
    cpu_ms: list[float] = field(default_factory=list)
    off_m: list[float] = field(default_factory=list)
    path_m: float = 0.0
    T_world_map: FloatArray | None = None
    last: FloatArray | None = None
    begun_s: float = field(default_factory=time.perf_counter)
    figures: Figures = field(default_factory=dict)

    def see(self, step: Step | None, T_world_base: FloatArray) -> None:
        """How far the step is from the truth, the map being laid where the drive began."""
        if self.last is not None:
            self.path_m += float(np.hypot(*(T_world_base - self.last)[:2]))
        self.last = T_world_base
        if step is None:
            return
        if self.T_world_map is None:
            self.T_world_map = compose(T_world_base, between(step.T_map_base, np.zeros(3)))
        seen = compose(self.T_world_map, step.T_map_base)
        self.off_m.append(float(np.hypot(*(seen - T_world_base)[:2])))

    def closed(self, keeper: AsyncBackEnd) -> _Stretch:
        """With its figures."""
        own_mb, child_mb = _resident_mb(os.getpid()), _resident_mb(keeper.process_id)
        wall, cpu, off_m = np.array(self.wall_ms), np.array(self.cpu_ms), np.array(self.off_m)
        self.figures = {
            "path_m": self.path_m,
            "scans": len(wall),
            "p50_ms": float(np.percentile(wall, 50)),
            "p99_ms": float(np.percentile(wall, 99)),
            "max_ms": float(wall.max()),
            "cpu_p50_ms": float(np.percentile(cpu, 50)),
            "cpu_p99_ms": float(np.percentile(cpu, 99)),
            "cpu_max_ms": float(cpu.max()),
            "off_rmse_m": float(np.sqrt(np.mean(off_m**2))),
            "off_max_m": float(off_m.max()),
            "keyframes": keeper.taken,
            "keyframes_kept": keeper.kept,
            "closures": keeper.closures,
            "session_mb": own_mb,
            "back_end_mb": child_mb,
            "wall_s": time.perf_counter() - self.begun_s,
        }
        return self

    def words(self, number: int) -> str:
        """Its figures in a line, told as soon as it is driven."""
        return (
            "km {number}: p50 {p50_ms:.1f}, p99 {p99_ms:.1f}, max {max_ms:.0f} ms; processor time "
            "p50 {cpu_p50_ms:.1f}, p99 {cpu_p99_ms:.1f}, max {cpu_max_ms:.0f} ms; session "
            "{session_mb:.0f} MB, back end {back_end_mb:.0f} MB; {keyframes_kept} key frames "
            "kept of {keyframes}, {closures} closures; off {off_rmse_m:.3f} m; {wall_s:.0f} s"
        ).format_map(self.figures | {"number": number})

    def next(self) -> _Stretch:
        """The kilometre after this one."""
        return _Stretch(T_world_map=self.T_world_map, last=self.last)


def _resident_mb(process: int | None) -> float:
    """Resident memory of a process, nan if it is gone or not told by this system."""
    file = Path(f"/proc/{process}/statm")
    if process is None or not file.exists():
        return float("nan")
    return int(file.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") * 1e-6
