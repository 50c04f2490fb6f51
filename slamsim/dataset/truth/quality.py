"""Quality figures of a sequence, independent of how it was made."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely

from slamsim.core.geometry import wrap_angle, yaw_from_xyzw
from slamsim.core.types import Drive, FloatArray, Grid
from slamsim.dataset.recipe.sequence import Cell
from slamsim.dataset.truth.key_scans import KeyScan
from slamsim.dataset.truth.overlap import Pairs
from slamsim.dataset.truth.surfaces import TrueSurfaces
from slamsim.dataset.truth.tables import slip_m_s
from slamsim.evaluate.visibility import seen_from
from slamsim.sensors.readings import Readings
from slamsim.world.model import BODY_HIGH_M, BODY_LOW_M, World

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

    grid: true occupancy at the height of the lidar, which sees as far as range_m.
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
