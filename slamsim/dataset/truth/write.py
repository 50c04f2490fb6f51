"""Writes the ground truth of a sequence: tables during the drive, pairs, grid and quality after."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from slamsim.config.lidar import LidarConfig
from slamsim.core.types import Drive, Grid
from slamsim.dataset.recipe.sequence import Cell, SequenceSpec
from slamsim.dataset.truth.key_scans import MOST_BEAMS, KeyScans
from slamsim.dataset.truth.overlap import overlapping, write_pairs
from slamsim.dataset.truth.quality import DriveQuality, scene_numbers, view_numbers
from slamsim.dataset.truth.surfaces import surfaces_of
from slamsim.dataset.truth.tables import TruthTables
from slamsim.io.staged_writer import StagedWriter
from slamsim.sensors.motion import PoseOverride
from slamsim.sensors.readings import Readings
from slamsim.sim.robot.model import RobotModel
from slamsim.slam.mapping.map_files import map_files
from slamsim.world.model import World

OCCUPANCY = "occupancy"


def write_occupancy(folder: Path, grid: Grid) -> None:
    """``occupancy.png`` and ``occupancy.yaml``: 0 solid, 254 free, 205 out of reach."""
    files = map_files(grid)
    text = files["map.yaml"].decode().replace("map.pgm", f"{OCCUPANCY}.png")
    (folder / f"{OCCUPANCY}.png").write_bytes(files["map.png"])
    (folder / f"{OCCUPANCY}.yaml").write_text(text, encoding="utf-8")


class Truth(StagedWriter):
    """The truth of a sequence that is being made, in a new folder; a context manager.

    override: how the laser truly looks, as for sensing. What needs the whole drive is written when
    the block ends; ``quality`` is known from then on.
    """

    def __init__(
        self,
        folder: Path,
        world: World,
        robot: RobotModel,
        spec: SequenceSpec,
        override: PoseOverride,
    ) -> None:
        super().__init__()
        lidar, wheels_m = spec.config.sensors.lidar, (robot.wheel_radius_m, robot.track_m)
        self._folder, self._world, self._robot, self._spec = folder, world, robot, spec
        self._surfaces = surfaces_of(world.mesh, lidar.range_max_m)
        tables = TruthTables(folder, self._surfaces, wheels_m, spec.index)
        self._tables = self._open.enter_context(tables)
        self._keys = KeyScans(lidar, robot, override, self._surfaces)
        self._drive = DriveQuality(wheels_m)
        self._quality: dict[str, Cell] = {}

    def write(self, readings: Readings, window: Drive) -> None:
        """The next window of the drive, and what was sensed during it."""
        self._tables.write(readings, window)
        self._keys.take(readings.scans, window)
        self._drive.write(readings, window)

    def quality(self) -> Mapping[str, Cell]:
        """The numbers of the sequence under stable, unit-bearing keys."""
        return self._quality

    def _finish(self) -> None:
        config, keys = self._spec.config, self._keys.scans
        lidar = config.sensors.lidar
        pairs = overlapping(keys, self._surfaces, _kept_step_rad(lidar))
        write_pairs(self._folder / "pairs.parquet", keys, pairs, self._spec.index)
        height_m = float(self._robot.T_base_laser[2, 3])
        grid = self._world.grid(config.mapping.resolution_m, height_m)
        write_occupancy(self._folder, grid)
        radius_m = self._robot.footprint_radius_m
        path_m = self._drive.path_m()
        self._quality = {
            **self._drive.numbers(),
            **scene_numbers(self._world, grid, path_m, radius_m, lidar.range_max_m),
            **view_numbers(keys, pairs, self._surfaces),
        }


def _kept_step_rad(lidar: LidarConfig) -> float:
    """Between the beams of a key scan."""
    return float(np.radians(lidar.angle_step_deg)) * -(-lidar.beam_count // MOST_BEAMS)
