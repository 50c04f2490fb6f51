"""Random conditions of a drive: world, lidar, wheels, and disturbances."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from slamsim.config.loading import load_run_config
from slamsim.config.robot import RobotConfig
from slamsim.config.run import RunConfig
from slamsim.core.randomness import random_bits, random_stream

WORLDS = ("labyrinth", "rooms", "ring", "symmetric", "corridor")
WORLD_SHARES = (0.45, 0.25, 0.15, 0.075, 0.075)
"""How often each of WORLDS is drawn: labyrinths most, worlds that look alike everywhere least."""
DRIVES = ("tour", "random_goals", "stop_and_go", "fast_turns")
DRIVE_SHARES = (0.4, 0.3, 0.15, 0.15)
"""How often each of DRIVES is drawn."""

MOST_SCANS = 5000
"""A path is cut so that the lidar gives about so many scans: with it no case takes more than some
tens of seconds. Long paths, to 500 m, are therefore those of slow lidars or of fast robots."""

TRACK_M = RobotConfig().drive_wheels.track_m

PATH_PER_CELL_M = 2.4
"""Of a tour of a labyrinth of 2 m cells, measured over ten of them."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """What one case is about; all of it follows from seed and number.

    field_deg: of view. lost_share: of the returns, at random. step_m: ranges are whole multiples
    of it. offset_m: what every range reads too much. ticks: whether wheel counters are recorded
    beside the odometry. radius_error, track_error: relative, of what the driver of the wheels
    believes. curve_deg_per_m: how the odometry turns on a straight way. glass_share: of the walls.
    kidnapped: whether the robot is carried to where it comes later, unnoticed by its odometry.
    """

    seed: int
    number: int
    world: str
    size: tuple[int, int]
    cell_m: float
    drive: str
    path_m: float
    speed_m_s: float
    beams: int
    field_deg: float
    range_m: float
    rate_hz: float
    noise_m: float
    lost_share: float
    step_m: float
    offset_m: float
    gyroscope: bool
    ticks: bool
    radius_error: float
    track_error: float
    curve_deg_per_m: float
    people: int
    glass_share: float
    kidnapped: bool

    @property
    def own_seed(self) -> int:
        """Of everything else that is random in this case."""
        return random_bits(self.seed, "bench robustness", str(self.number)) % 2**31

    @property
    def repeat(self) -> str:
        """The command that does this case again."""
        return f"slamsim bench robustness --seed {self.seed} --only {self.number}"

    def config(self) -> RunConfig:
        """The simulation of this case, without what ``disturbances`` do to its recording."""
        world = "loop" if self.world == "ring" else self.world
        return load_run_config(world, None, [*self._world(), *self._robot()], self.own_seed)

    def _world(self) -> list[str]:
        rows, columns = self.size
        if self.world == "labyrinth":
            size = [f"rows={rows}", f"columns={columns}", f"cell_m={self.cell_m}"]
            return [f"world.maze.{one}" for one in size]
        if self.world == "rooms":  # on a wet floor wheels truly slip
            return [f"world.rooms.length_cells={columns}", "world.floor.patches=[]"]
        if self.world == "ring":
            drawing = ring_drawing(rows, columns).replace("\n", "\\n")
            return [f"world.plan.cell_m={self.cell_m}", f'world.plan.drawing="{drawing}"']
        return [f"world.maze.columns={columns}"] if self.world == "corridor" else []

    def _robot(self) -> list[str]:
        unequal = 0.5 * np.deg2rad(self.curve_deg_per_m) * TRACK_M
        lidar, wheels = "sensors.lidar", "sensors.encoders"
        return [
            f"drive={self.drive}",
            f"drive.route.max_path_length_m={self.path_m}",
            f"drive.limits.max_speed_m_s={self.speed_m_s}",
            f"{lidar}.beam_count={self.beams}",
            f"{lidar}.angle_step_deg={self.field_deg / self.beams}",
            f"{lidar}.angle_min_deg={-0.5 * self.field_deg}",
            f"{lidar}.range_max_m={self.range_m}",
            f"{lidar}.rate_hz={self.rate_hz}",
            f"{lidar}.resolution_m={self.step_m}",
            f"{lidar}.noise.constant_m={self.noise_m}",
            f"{lidar}.dropout.probability={self.lost_share}",
            f"sensors.imu.enabled={str(self.gyroscope).lower()}",
            f"{wheels}.wheel_radius_error={self.radius_error}",
            f"{wheels}.track_error={self.track_error}",
            f"{wheels}.wheel_scale_error=[{-unequal}, {unequal}]",
        ]


def draw_conditions(seed: int, number: int) -> Conditions:
    """Of one case, from these two numbers alone.

    Sizes that cover decades are spread evenly over their logarithm. Each disturbance is there in
    some of the cases, so that one is seen without the others too.
    """
    rng = random_stream(seed, "bench robustness", str(number))
    rate_hz = _log_uniform(rng, 2.0, 40.0, 1)
    speed_m_s = round(float(rng.uniform(0.3, 1.0)), 2)
    longest_m = 0.7 * speed_m_s * MOST_SCANS / rate_hz  # it slows down in bends
    path_m = min(_log_uniform(rng, 20.0, 500.0, 0), round(longest_m))
    world = str(rng.choice(WORLDS, p=WORLD_SHARES))
    cell_m = round(float(rng.uniform(1.6, 3.0)), 1)
    return Conditions(
        seed=seed,
        number=number,
        world=world,
        size=_size(rng, world, path_m, cell_m),
        cell_m=cell_m,
        drive=str(rng.choice(DRIVES, p=DRIVE_SHARES)),
        path_m=path_m,
        speed_m_s=speed_m_s,
        beams=round(_log_uniform(rng, 36.0, 1440.0, 0)),
        field_deg=float(rng.choice([180.0, 270.0, 360.0], p=[0.2, 0.2, 0.6])),
        range_m=_log_uniform(rng, 4.0, 60.0, 1),
        rate_hz=rate_hz,
        noise_m=_log_uniform(rng, 0.002, 0.03, 4),
        lost_share=_sometimes(rng, 0.4, lambda: float(rng.uniform(0.02, 0.5))),
        step_m=float(rng.choice([0.001, 0.01, 0.05], p=[0.6, 0.3, 0.1])),
        offset_m=_sometimes(rng, 0.4, lambda: float(rng.uniform(-0.05, 0.05))),
        gyroscope=bool(rng.random() < 0.5),
        ticks=bool(rng.random() < 0.6),
        radius_error=_sometimes(rng, 0.6, lambda: float(rng.uniform(-0.05, 0.05))),
        track_error=_sometimes(rng, 0.6, lambda: float(rng.uniform(-0.05, 0.05))),
        curve_deg_per_m=_sometimes(rng, 0.4, lambda: float(rng.uniform(-1.5, 1.5))),
        people=int(_sometimes(rng, 0.3, lambda: float(rng.integers(1, 5)))),
        glass_share=_sometimes(rng, 0.2, lambda: float(rng.uniform(0.05, 0.3))),
        kidnapped=bool(rng.random() < 0.15),
    )


def ring_drawing(rows: int, columns: int) -> str:
    """The floor plan of a closed corridor, one cell wide, round a block without cells."""
    edge, gap = "+--" * columns + "+", "+  +" + "--+" * (columns - 2) + "  +"
    open_row = "|" + " " * (3 * columns - 1) + "|"
    lines = [edge, open_row]
    for _ in range(rows - 2):
        lines += [gap, "|  |" + "##|" * (columns - 2) + "  |"]
    return "\n".join([*lines, gap, "|S" + open_row[2:], edge]) + "\n"


def _size(rng: np.random.Generator, world: str, path_m: float, cell_m: float) -> tuple[int, int]:
    """Rows and columns of cells, about as many as the path goes through once."""
    share = float(rng.uniform(0.5, 1.2))
    if world == "ring":  # from half a round to two rounds and more
        half = max(round(share * path_m / cell_m / 2.0), 7)
        columns = round(0.6 * half)
        return half - columns + 1, columns + 1
    if world == "labyrinth":
        side = round(float(np.sqrt(share * path_m / (PATH_PER_CELL_M * 0.5 * cell_m))))
        return (min(max(side, 3), 14),) * 2
    return 1, min(max(round(share * path_m / 6.0), 8), 24)


def _log_uniform(rng: np.random.Generator, low: float, high: float, digits: int) -> float:
    return round(float(np.exp(rng.uniform(np.log(low), np.log(high)))), digits)


def _sometimes(rng: np.random.Generator, share: float, size: Callable[[], float]) -> float:
    """A size in this share of the cases, else 0; both are drawn in any case."""
    there, value = rng.random() < share, size()
    return round(value, 4) if there else 0.0
