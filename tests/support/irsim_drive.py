"""A drive through a room of IR-SIM (https://github.com/hanruihua/ir-sim), mapped.

    pip install ir-sim
    PYTHONPATH=.:tests python tests/support/irsim_drive.py OUT [--seed 1] [--rate-hz 10]
        [--beams 360] [--range-m 10] [--noise-m 0.02] [--walkers 4] [--seconds 90]

writes a rosbag2 of LaserScan, Odometry and tf, maps it, and tells the error of the trajectory.
Robot, lidar and moving things are theirs; their lidar writes its range where nothing came back, and
a scan_time of its own. The odometry is the true path, its way 2 % too long, its turns 3 % too
small.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from independent.rays import Floats
from independent.recorded import Bag, Edge, Odometry, Scans, yaw_quaternion
from independent.writer import write

from slamsim.config.slam import SlamConfig
from slamsim.core.types import PlanarTrajectory
from slamsim.evaluate.trajectory import compare, statistics
from slamsim.io.open import read_log
from slamsim.slam.session import run_slam

SIDE_M, LASER_X_M = 16.0, 0.1
FASTEST_M_S, FASTEST_RAD_S = 0.6, 1.0
WAY_TOO_LONG, TURN_TOO_SMALL = 1.02, 0.97
BEGIN_NS = 1_700_000_000_000_000_000


@dataclass(frozen=True)
class Drive:
    """A drive to random places, the lidar, and how many discs wander about."""

    seed: int = 1
    rate_hz: float = 10.0
    beams: int = 360
    range_m: float = 10.0
    noise_m: float = 0.02
    walkers: int = 0
    seconds: float = 90.0

    def recorded(self, folder: Path) -> tuple[Bag, PlanarTrajectory]:
        """What the robot recorded, and where it was. folder: for the description of the room."""
        import irsim  # type: ignore[import-not-found]
        import yaml

        rng = np.random.default_rng(self.seed)
        room = folder / "room.yaml"
        room.write_text(yaml.safe_dump(self._room(rng)))
        simulator = irsim.make(str(room), display=False, disable_all_plot=True)
        driver = _Driver(rng, self.rate_hz)
        scans, poses = [], []
        for _ in range(round(self.seconds * self.rate_hz)):
            scan = simulator.robot.get_lidar_scan()
            scans.append({**scan, "ranges": np.array(scan["ranges"])})  # theirs is written over
            poses.append(np.asarray(simulator.robot.state).ravel()[:3])
            simulator.step(driver.steer(poses[-1], scan)[:, None])
        return self._bag(scans, np.array(poses), rng)

    def _room(self, rng: np.random.Generator) -> dict[str, Any]:
        corners = [[0.0, 0.0], [SIDE_M, 0.0], [SIDE_M, SIDE_M], [0.0, SIDE_M], [0.0, 0.0]]
        things: list[dict[str, Any]] = [{"shape": {"name": "linestring", "vertices": corners}}]
        for x_m, y_m in rng.uniform(2.0, SIDE_M - 2.0, (9, 2)).tolist():
            length_m, width_m, yaw_rad = rng.uniform([0.4, 0.2, 0.0], [2.5, 1.2, 3.0]).tolist()
            shape = {"name": "rectangle", "length": length_m, "width": width_m}
            things.append({"shape": shape, "state": [x_m, y_m, yaw_rad]})
        low, high = [1.0, 1.0, 0.0], [SIDE_M - 1.0, SIDE_M - 1.0, 0.0]
        wander = {"name": "rvo", "wander": True, "range_low": low, "range_high": high, "vmax": 1.2}
        walker = {
            "number": self.walkers,
            "kinematics": {"name": "omni"},
            "distribution": {"name": "random", "range_low": low, "range_high": high},
            "behavior": wander,
            "vel_max": [1.2, 1.2],
            "shape": {"name": "circle", "radius": 0.25},
        }
        lidar = {
            "name": "lidar2d",
            "range_min": 0.0,
            "range_max": self.range_m,
            "angle_range": 2.0 * np.pi,
            "number": self.beams,
            "noise": self.noise_m > 0.0,
            "std": self.noise_m,
            "angle_std": 0.0,
            "offset": [LASER_X_M, 0.0, 0.0],
        }
        robot = {
            "kinematics": {"name": "diff"},
            "shape": {"name": "circle", "radius": 0.2},
            "state": [2.0, 2.0, 0.3],
            "vel_max": [FASTEST_M_S, FASTEST_RAD_S],
            "sensors": [lidar],
        }
        size = {"height": SIDE_M, "width": SIDE_M, "step_time": 1.0 / self.rate_hz}
        return {
            "world": {**size, "collision_mode": "unobstructed"},
            "robot": [robot],
            "obstacle": [*things, walker] if self.walkers else things,
        }

    def _bag(
        self, scans: list[dict[str, Any]], poses: Floats, rng: np.random.Generator
    ) -> tuple[Bag, PlanarTrajectory]:
        stamps_ns = BEGIN_NS + np.round(np.arange(len(poses)) * 1e9 / self.rate_hz).astype(np.int64)
        one, count = scans[0], len(poses)
        xy_m, yaw_rad = _odometry(poses, rng)
        turns, none = yaw_quaternion(yaw_rad), np.zeros((count, 3))
        at = stamps_ns, stamps_ns  # received at once
        laser = Scans(
            "/scan",
            "laser",
            *at,
            ranges_m=np.array([scan["ranges"] for scan in scans], dtype=np.float32),
            angle_min=one["angle_min"],
            angle_increment=one["angle_increment"],
            time_increment=one["time_increment"],
            scan_time=one["scan_time"],
            range_min=one["range_min"],
            range_max=one["range_max"],
            intensities=np.zeros((count, 0), dtype=np.float32),
        )
        odometry = Odometry(
            "/odom",
            "odom",
            *at,
            child="base",
            xy_m=xy_m,
            quaternion=turns,
            linear=none,
            angular=none,
        )
        there = np.column_stack([xy_m, np.zeros(count)])
        moving = Edge("/tf", "odom", *at, child="base", translation=there, quaternion=turns)
        mount_m, level = np.array([[LASER_X_M, 0.0, 0.0]]), yaw_quaternion(np.zeros(1))
        first = stamps_ns[:1]
        fixed = Edge("/tf_static", "base", first, first, "laser", mount_m, level, static=True)
        truth = PlanarTrajectory(stamps_ns, poses)
        return Bag(scans=[laser], odometry=[odometry], edges=[moving, fixed]), truth


class _Driver:
    """Drives to one place after the other, and turns away from what is near."""

    def __init__(self, rng: np.random.Generator, rate_hz: float) -> None:
        self._rng, self._seconds = rng, 1.0 / rate_hz
        self._goal_m, self._since_s = np.full(2, np.inf), np.inf
        self._speed = np.zeros(2)

    def steer(self, pose: Floats, scan: dict[str, Any]) -> Floats:
        """(2,) m/s and rad/s."""
        self._since_s += self._seconds
        if self._since_s > 12.0 or np.hypot(*(self._goal_m - pose[:2])) < 0.6:
            self._goal_m, self._since_s = self._rng.uniform(1.5, SIDE_M - 1.5, 2), 0.0
        ranges_m = np.asarray(scan["ranges"])
        angles_rad = np.linspace(scan["angle_min"], scan["angle_max"], len(ranges_m))
        near_m = ranges_m[np.abs(angles_rad) < 0.6].min()
        if near_m < 0.9:
            left, right = (ranges_m[np.abs(angles_rad - side) < 0.7].mean() for side in (0.9, -0.9))
            wanted = np.array([0.0 if near_m < 0.55 else 0.15, 1.0 if left > right else -1.0])
        else:
            off_rad = np.arctan2(*(self._goal_m - pose[:2])[::-1]) - pose[2]
            off_rad = (off_rad + np.pi) % (2.0 * np.pi) - np.pi
            wanted = np.array([FASTEST_M_S, np.clip(1.2 * off_rad, -FASTEST_RAD_S, FASTEST_RAD_S)])
        most = np.array([1.0, 3.0]) * self._seconds
        self._speed = self._speed + np.clip(wanted - self._speed, -most, most)
        return self._speed


def _odometry(poses: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Positions (n, 2) and headings (n,) by wheels that are wrong and slip. The simulated robot
    goes straight in the direction that it has at the begin of each step."""
    steps = np.diff(poses, axis=0)
    heading = np.column_stack([np.cos(poses[:-1, 2]), np.sin(poses[:-1, 2])])
    way_m = WAY_TOO_LONG * np.sum(steps[:, :2] * heading, axis=1)
    way_m *= 1.0 + rng.normal(0.0, 0.01, len(way_m))
    turn_rad = TURN_TOO_SMALL * ((steps[:, 2] + np.pi) % (2.0 * np.pi) - np.pi)
    turn_rad += rng.normal(0.0, 0.002, len(turn_rad)) * np.sqrt(np.abs(turn_rad))
    yaw_rad = np.concatenate([[0.0], np.cumsum(turn_rad)])
    moved = way_m[:, None] * np.column_stack([np.cos(yaw_rad[:-1]), np.sin(yaw_rad[:-1])])
    return np.concatenate([np.zeros((1, 2)), np.cumsum(moved, axis=0)]), yaw_rad


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, default=Drive.seed)
    parser.add_argument("--rate-hz", type=float, default=Drive.rate_hz)
    parser.add_argument("--beams", type=int, default=Drive.beams)
    parser.add_argument("--range-m", type=float, default=Drive.range_m)
    parser.add_argument("--noise-m", type=float, default=Drive.noise_m)
    parser.add_argument("--walkers", type=int, default=Drive.walkers)
    parser.add_argument("--seconds", type=float, default=Drive.seconds)
    options = vars(parser.parse_args())
    out = options.pop("out")
    out.mkdir(parents=True)
    bag, truth = Drive(**options).recorded(out)
    slam = run_slam(read_log(write(bag, out / "recording")), SlamConfig())
    errors = statistics(compare(slam.trajectory, truth).translation_m)
    by_wheels = statistics(compare(slam.odometry, truth).translation_m)
    told = [f"{event.kind}: {event.words}" for event in slam.events]
    sys.stdout.write(
        f"driven {truth.path_length_m():.1f} m, error {1e3 * errors.rmse:.1f} mm RMSE, "
        f"{1e3 * errors.max:.1f} mm at most (odometry {1e3 * by_wheels.rmse:.0f} mm RMSE); "
        f"told: {told or 'nothing'}\n"
    )


if __name__ == "__main__":
    main()
