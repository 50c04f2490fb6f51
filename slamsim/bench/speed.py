"""Speed of each stage, as ratios to bare engines and to real time, measured in one run."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slamsim.bench import Figures
from slamsim.config.run import RunConfig
from slamsim.console.reporter import Reporter
from slamsim.core.types import Drive, Float32Array, TriangleMesh
from slamsim.io.open import read_log
from slamsim.process.children import MEMORY
from slamsim.sensors.rig import SensorRig
from slamsim.sensors.scene import Scene
from slamsim.sim.drive.legs import Route
from slamsim.sim.drive.route import plan_route
from slamsim.sim.drive.run import DriveRun, bare_step_seconds
from slamsim.sim.robot.model import RobotModel, build_robot
from slamsim.simulation.simulate import simulate
from slamsim.slam.frontend.motion import predict_motion
from slamsim.slam.mapping.grid import build_grid
from slamsim.slam.session import run_slam
from slamsim.world.build import build_world
from slamsim.world.model import World


@dataclass(frozen=True, slots=True)
class _Subject:
    """What is measured: one world, one robot, one stretch of its tour."""

    config: RunConfig
    world: World
    robot: RobotModel
    route: Route
    repeats: int
    reporter: Reporter


def run_bench(part: str, config: RunConfig, repeats: int, reporter: Reporter) -> Figures:
    """Measure one part of the pipeline or ``all`` on the configured drive.

    Every time is the least of ``repeats`` runs, as whatever else the machine does only adds to
    it; kernels are compiled and libraries loaded before the clock runs.
    """
    built = build_world(config.world, config.seed)
    robot = build_robot(config.robot)
    route = plan_route(built, robot, config.drive)
    subject = _Subject(config, built, robot, route, repeats, reporter)
    limit_s = config.drive.route.max_duration_s
    figures: Figures = {"world": config.world.name, "simulated_s": limit_s, "repeats": repeats}
    for name, measure in _PARTS.items():
        if part in ("all", name):
            figures[name] = measure(subject)
    figures["peak_memory_mb"] = MEMORY.peak_mb()
    return figures


def _sense(subject: _Subject) -> Figures:
    """Lidar beams per second on one thread, all streams, noise and stamps included."""
    windows = list(_windows(subject))
    lidar = subject.config.sensors.lidar

    def sense_all() -> int:
        rig = SensorRig(
            subject.world.mesh, subject.robot, subject.config.sensors, subject.config.seed
        )
        return sum(len(rig.sense(window).scans) for window in windows)

    beams = sense_all() * lidar.beam_count
    sensed_s = _least(sense_all, subject, "sense")
    rays = plain_rays(windows, subject.world.mesh, subject.robot, subject.config)
    scene = Scene(subject.world.mesh, lidar.range_max_m)
    bare_s = _least(lambda: [scene.cast(batch) for batch in rays], subject, "cast")
    bare_s *= beams / sum(len(batch) for batch in rays)
    return {
        "beams": beams,
        "beams_per_s": beams / sensed_s,
        "bare_cast_beams_per_s": beams / bare_s,
        "time_over_bare_cast": sensed_s / bare_s,
    }


def plain_rays(
    windows: list[Drive], mesh: TriangleMesh, robot: RobotModel, config: RunConfig
) -> list[Float32Array]:
    """Level rays to all sides from along the drive: what a caster alone would have to do.

    Each (n, 6): origin in metres and direction.
    """
    lidar = config.sensors.lidar
    every = max(round(config.drive.physics.rate_hz / lidar.rate_hz), 1)
    angles = np.radians(lidar.angle_min_deg + lidar.angle_step_deg * np.arange(lidar.beam_count))
    directions = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1)
    low, high = mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)
    mount = robot.T_base_laser[:3, 3] - 0.5 * (low + high)
    return [
        np.hstack([np.tile(origin, (len(angles), 1)), directions]).astype(np.float32)
        for window in windows
        for origin in window.positions_m[::every] + mount
    ]


def _drive(subject: _Subject) -> Figures:
    """The drive against nothing but ``stepSimulation`` in the same world."""
    physics = subject.config.drive.physics
    simulated_s = sum(len(window) for window in _windows(subject)) / physics.rate_hz

    def bare() -> None:
        bare_step_seconds(subject.world, subject.robot, physics, simulated_s)

    driven_s = bare_s = float("inf")
    with subject.reporter.stage("drive") as progress:
        for number in range(subject.repeats):
            driven_s = min(driven_s, _seconds(lambda: _exhaust(_windows(subject))))
            bare_s = min(bare_s, _seconds(bare))
            progress(number + 1, subject.repeats)
    return {
        "realtime_factor": simulated_s / driven_s,
        "bare_step_realtime_factor": simulated_s / bare_s,
        "time_over_bare_step": driven_s / bare_s,
    }


def _simulate(subject: _Subject) -> Figures:
    """``slamsim simulate`` as a whole, from the configuration to the closed log."""
    simulated_s = 0.0

    def run() -> None:
        nonlocal simulated_s
        with tempfile.TemporaryDirectory() as folder:
            simulated_s = simulate(subject.config, Path(folder) / "log").outcome.duration_s

    run()
    whole_s = _least(run, subject, "simulate")
    return {"seconds": whole_s, "realtime_factor": simulated_s / whole_s}


def _slam(subject: _Subject) -> Figures:
    """SLAM and map from a log on the disk, and whether a scan costs more late than early."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log"
        simulated_s = simulate(subject.config, path).outcome.duration_s
        passed_s: list[float] = []

        def run() -> None:
            log, slam = read_log(path), subject.config.slam
            passed_s.clear()
            result = run_slam(log, slam, lambda done, total: passed_s.append(time.perf_counter()))
            log = result.log or log
            motion = predict_motion(log)
            build_grid(
                log.scans, result.trajectory, log.T_base_laser, subject.config.mapping, motion
            )

        run()
        slam_s = _least(run, subject, "slam")
    quarter = len(passed_s) // 4
    early_s = passed_s[2 * quarter] - passed_s[quarter]
    late_s = passed_s[4 * quarter - 1] - passed_s[3 * quarter - 1]
    return {
        "realtime_factor": simulated_s / slam_s,
        "ms_per_scan": 1e3 * slam_s / len(passed_s),
        "late_over_early_scan_time": late_s / early_s,
    }


def _windows(subject: _Subject) -> Iterable[Drive]:
    return DriveRun(subject.world, subject.robot, subject.route, subject.config.drive)


def _exhaust(items: Iterable[object]) -> None:
    for _ in items:
        pass


def _least(work: Callable[[], object], subject: _Subject, title: str) -> float:
    best_s = float("inf")
    with subject.reporter.stage(title, "") as progress:
        for number in range(subject.repeats):
            best_s = min(best_s, _seconds(work))
            progress(number + 1, subject.repeats)
    return best_s


def _seconds(work: Callable[[], object]) -> float:
    begun_s = time.perf_counter()
    work()
    return time.perf_counter() - begun_s


def processor_s(work: Callable[[], object]) -> float:
    """Processor time that this process takes for a piece of work."""
    begun_s = time.process_time()
    work()
    return time.process_time() - begun_s


_PARTS: dict[str, Callable[[_Subject], Figures]] = {
    "sense": _sense,
    "drive": _drive,
    "simulate": _simulate,
    "slam": _slam,
}
