"""Writes the ground truth of a sequence: tables during the drive, pairs, grid and quality after."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import shapely

from slamsim.config.lidar import LidarConfig
from slamsim.core.geometry import wrap_angle, yaw_from_xyzw
from slamsim.core.types import Drive, FloatArray, Grid
from slamsim.dataset.recipe.sequence import Cell, SequenceSpec
from slamsim.dataset.truth.key_scans import MOST_BEAMS, KeyScan, KeyScans
from slamsim.dataset.truth.overlap import Pairs, overlapping, write_pairs
from slamsim.dataset.truth.surfaces import TrueSurfaces, surfaces_of
from slamsim.dataset.truth.tables import TruthTables, slip_m_s
from slamsim.evaluate.visibility import seen_from
from slamsim.io.staged_writer import StagedWriter
from slamsim.sensors.motion import PoseOverride
from slamsim.sensors.readings import Readings
from slamsim.sim.robot.model import RobotModel
from slamsim.slam.mapping.map_files import map_files
from slamsim.world.model import BODY_HIGH_M, BODY_LOW_M, World

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


PATH_STEP_M = 0.1
"""Spacing of the points at which clearance and view are judged."""
DEGENERATE_BELOW = 0.02
"""Share of what a scan says of the position that falls to its weaker direction."""


class DriveQuality:
    """Sums over a drive, window by window. wheels_m: true radius and track of the robot."""

    def __init__(self, wheels_m: tuple[float, float]) -> None:
        self._wheels_m = wheels_m
        self._last: FloatArray | None = None
        self._path: list[FloatArray] = []
        self._way_m = self._turn_rad = self._slipped_m = self._rolled_m = 0.0
        self._touching = False
        self._contacts = self._steps = self._steps_in_contact = 0
        self._counts = {"scans": 0, "imu_samples": 0, "encoder_readings": 0}
        self._beams = self._silent = self._invalid = self._width = 0

    def write(self, readings: Readings, window: Drive) -> None:
        """The next window."""
        self._add_motion(window)
        self._counts["scans"] += len(readings.scans)
        self._counts["imu_samples"] += len(readings.imu)
        self._counts["encoder_readings"] += len(readings.encoders)
        ranges_m = readings.scans.ranges_m
        self._beams, self._width = self._beams + ranges_m.size, ranges_m.shape[1]
        self._silent += int(np.count_nonzero(np.isinf(ranges_m)))
        self._invalid += int(np.count_nonzero(np.isnan(ranges_m)))

    def _add_motion(self, window: Drive) -> None:
        poses = np.column_stack([window.positions_m[:, :2], yaw_from_xyzw(window.quats_xyzw)])
        joined = poses if self._last is None else np.vstack([self._last, poses])
        steps = np.diff(joined, axis=0)
        steps_m = np.hypot(steps[:, 0], steps[:, 1])
        ways_m = self._way_m + np.concatenate([[0.0], np.cumsum(steps_m)])
        passed = np.diff(np.floor(ways_m / PATH_STEP_M)) > 0
        if self._last is None:
            self._path.append(joined[:1, :2])
        self._path.append(joined[1:][passed, :2])
        self._way_m, self._last = float(ways_m[-1]), joined[-1:]
        self._turn_rad += float(np.abs(wrap_angle(steps[:, 2])).sum())
        self._add_contacts(window)
        self._add_slip(window)

    def _add_contacts(self, window: Drive) -> None:
        touching = np.concatenate([[self._touching], window.wall_contact])
        self._contacts += int(np.count_nonzero(touching[1:] & ~touching[:-1]))
        self._touching = bool(touching[-1])
        self._steps += len(window)
        self._steps_in_contact += int(np.count_nonzero(window.wall_contact))

    def _add_slip(self, window: Drive) -> None:
        """How far the wheels' rims rolled, and how far they slipped while at it."""
        step_s = float(np.diff(window.stamps_ns[:2]).sum()) * 1e-9
        slips_m_s = slip_m_s(window, *self._wheels_m)[:, :2]
        self._slipped_m += float(np.abs(slips_m_s).mean(axis=1).sum()) * step_s
        rims_m_s = np.abs(window.wheel_speeds_rad_s) * self._wheels_m[0]
        self._rolled_m += float(rims_m_s.mean(axis=1).sum()) * step_s

    def path_m(self) -> FloatArray:
        """(n, 2) the path driven, thinned."""
        return np.concatenate(self._path)

    def numbers(self) -> dict[str, Cell]:
        """The sums under stable, unit-bearing keys."""
        return {
            "path_length_m": _plain(self._way_m),
            "turned_rad": _plain(self._turn_rad),
            **self._counts,
            "beams": self._width,
            "contacts": self._contacts,
            "contact_share": _share(self._steps_in_contact, self._steps),
            "slip_share": _share(self._slipped_m, self._rolled_m),
            "no_return_share": _share(self._silent, self._beams),
            "invalid_share": _share(self._invalid, self._beams),
        }


def scene_numbers(
    world: World, grid: Grid, path_m: FloatArray, robot_radius_m: float, range_m: float
) -> dict[str, Cell]:
    """What the world was like along a path: room to the walls, area in view.

    grid: true occupancy at the height of the lidar, which sees as far as range_m. path_m: (n, 2).
    """
    seen = seen_from(grid, path_m, range_m)
    free = grid.occupancy == 0.0
    outline = world.solids.shadow(BODY_LOW_M, BODY_HIGH_M)
    tree = shapely.STRtree(shapely.linestrings(outline))
    nearest = tree.query_nearest(shapely.points(path_m), all_matches=False, return_distance=True)
    room_m = nearest[1].min(initial=np.inf)
    cell_m2 = grid.resolution_m**2
    return {
        "seen_area_m2": _plain(float(np.count_nonzero(seen & free)) * cell_m2),
        "seen_share": _share(int(np.count_nonzero(seen & free)), int(np.count_nonzero(free))),
        "min_clearance_m": _plain(float(room_m) - robot_radius_m),
    }


def view_numbers(keys: Sequence[KeyScan], pairs: Pairs, surfaces: TrueSurfaces) -> dict[str, Cell]:
    """What the key scans tell: places seen again, and places that fix no position."""
    weak = sum(weaker_share(key, surfaces) < DEGENERATE_BELOW for key in keys)
    again = np.unique(pairs.second[pairs.closes]).size
    return {
        "key_scans": len(keys),
        "overlapping_pairs": len(pairs.first),
        "loop_closures": int(pairs.closes.sum()),
        "revisit_share": _share(again, len(keys)),
        "degenerate_share": _share(weak, len(keys)),
    }


def weaker_share(key: KeyScan, surfaces: TrueSurfaces) -> float:
    """Share of a scan's hold on the position in the plane that falls to its weaker direction.

    Each return holds the position along the normal of its wall (Censi 2007): 0 in a corridor
    without ends or where nothing is seen, 0.5 where walls stand crosswise in equal parts.
    """
    normals = surfaces.normals[key.surfaces, :2]
    held = normals.T @ normals
    total = float(np.trace(held))
    return float(np.linalg.eigvalsh(held)[0]) / total if total > 0.0 else 0.0


def _share(part: float, whole: float) -> float:
    return _plain(part / whole) if whole else 0.0


def _plain(value: float) -> float:
    """Six digits: enough for any table, and no noise of the last bit."""
    return float(f"{value:.6g}")
