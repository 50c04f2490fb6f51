"""A random world, drive and set of sensors for each seed, all of them healthy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.config.bundled import bundled_names
from slamsim.config.loading import load_run_config
from slamsim.config.run import RunConfig
from slamsim.core.randomness import random_stream

WORLDS = ("labyrinth", "labyrinth", "labyrinth", "rooms", "loop", "symmetric")


@dataclass(frozen=True, slots=True)
class CheckScenario:
    """What one seed stands for; world and lidar are the names of what it was drawn from."""

    seed: int
    world: str
    lidar: str
    config: RunConfig


def random_scenario(seed: int, seconds: float) -> CheckScenario:
    """The scenario of a seed, always the same one.

    World, size, preset of the lidar, rates, phases, where the laser is mounted and the errors that
    a careful user leaves are drawn; the route is a tour cut after ``seconds``.
    """
    rng = random_stream(seed, "bench check", "scenario")
    world = str(rng.choice(WORLDS))
    lidar = str(rng.choice(bundled_names("configs/sensors")))
    overrides = [
        f"drive.route.max_duration_s={seconds:.1f}",
        f"sensors.lidar={lidar}",
        "robot=turtlebot2",
        *_world(world, rng),
        *_clocks(rng),
        *_wheels(rng),
        *_mount(rng),
    ]
    return CheckScenario(seed, world, lidar, load_run_config(world, None, overrides, seed))


def _world(world: str, rng: np.random.Generator) -> list[str]:
    if world != "labyrinth":
        return ["world.floor.patches=[]"]  # on a wet floor wheels truly slip
    rows, columns = rng.integers(4, 11, size=2)
    return [f"world.maze.rows={rows}", f"world.maze.columns={columns}"]


def _clocks(rng: np.random.Generator) -> list[str]:
    """Streams that begin at any instant, stamped and received nearly when they should be."""
    rates = {"imu": rng.choice([100.0, 200.0, 400.0]), "encoders": rng.choice([20.0, 50.0, 100.0])}
    overrides = [f"sensors.{name}.rate_hz={rate}" for name, rate in rates.items()]
    for name in ("lidar", "imu", "encoders"):
        at = f"sensors.{name}"
        overrides += [
            f"{at}.phase_s={rng.uniform(0.0, 0.2):.6f}",
            f"{at}.clock.jitter_s={rng.uniform(0.0, 5e-5):.7f}",
            f"{at}.clock.latency_s={rng.uniform(5e-4, 3e-3):.6f}",
            f"{at}.clock.latency_jitter_s={rng.uniform(1e-4, 1e-3):.6f}",
        ]
    return overrides


def _wheels(rng: np.random.Generator) -> list[str]:
    """What a careful calibration leaves (Borenstein & Feng 1996), of either sign."""
    at = "sensors.encoders"
    left, right = rng.uniform(-7e-4, 7e-4, size=2)
    return [
        f"{at}.wheel_radius_error={rng.uniform(-0.003, 0.003):.5f}",
        f"{at}.track_error={rng.uniform(-0.006, 0.006):.5f}",
        f"{at}.wheel_scale_error=[{left:.6f}, {right:.6f}]",
        f"{at}.ticks_per_revolution={rng.choice([1024, 2578, 4096])}",
    ]


def _mount(rng: np.random.Generator) -> list[str]:
    at = "robot.lidar.mount"
    return [
        f"{at}.x_m={rng.uniform(-0.05, 0.1):.3f}",
        f"{at}.y_m={rng.uniform(-0.05, 0.05):.3f}",
        f"{at}.yaw_deg={rng.choice([0.0, 0.0, 0.0, 180.0, 90.0, -45.0])}",
    ]
