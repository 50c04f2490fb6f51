"""Planar scans cut out of the point clouds of a 3-D lidar or a depth camera.

A ring that looks level is a planar lidar already; without one, all returns in a band of heights
count, the nearest in each direction. A cloud that leans is levelled first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slamsim.core.geometry import wrap_angle, xyzw_from_matrix
from slamsim.core.types import FloatArray, IntArray, Trajectory
from slamsim.recording import RawScans, ScanLayout, TransformEdge
from slamsim.recording.cloud_motion import LEVEL, CloudMotion
from slamsim.recording.row_store import RowStore
from slamsim.recording.sweeps import Points, Sweep, sweep_of

_LEVEL_RING_RAD = math.radians(1.5)
"""Half the distance between the rings of common lidars with the fewest (2.9 deg): one is closer."""
_BAND_M = 0.3
"""Above and below the sensor: rings 2 deg apart put a return into it up to 17 m away."""
_FLOOR_M = 0.1
"""What is lower above the base frame may be the floor."""
_SLAB_BEAMS = 720
"""Beams of a turn where no ring tells how many: half a degree, as pointcloud_to_laserscan has."""
_REGULAR = 0.9
"""Columns of returns that lie within a fourteenth of a step of multiples of it (0.9 is the mean
cosine of 0.45 rad): wider than half a degree, half of the beams would be empty in each scan."""
_MOST_BEAMS, _FEWEST_BEAMS = 7200, 180
_NEIGHBOURS = 0.9
"""Of the steps from one direction with a return to the next within a cloud: the wider ones are
between things. A camera that is thinned to 106 columns has half of its beams empty at half a
degree, and would pass for a lidar that loses them."""
_IN_ORDER = 0.95
"""Of the steps from point to point, in one direction: by chance it is half of them."""
_JUMP, _JUMPS = 1.0 / 16.0, 0.05
"""Of a turn, and of the steps that change direction. Points in order jump only over what returns
nothing, 16 times a turn at the most: 0 to 2 % of 900 to 5000 points. Those that a voxel filter
sorts by x, y, z jump in 17 to 21 % (voxels of 5 and 10 cm), those in no order in 88 %."""
_IN_NO_ORDER = (
    "; its points are in no order either, as after a voxel filter: when in a turn each was "
    "measured is lost (the driver's own clouds tell it)"
)
_TOGETHER_M, _TOGETHER_SHARE = 0.1, 0.03
"""Returns in one beam so close behind the nearest are of the same surface: three sigmas of either
side for lidars of up to 17 mm, and for depth cameras of 0.5 % of the distance."""
_NEAR_BEAMS, _STEEPEST = 2.0, 4.0
"""Two returns so many beams apart are of one surface if it is seen at no less than some 14 degrees
(of which the tangent is a fourth; 16 of beams 1 degree wide); else one may be in front of the
other."""
_GAP_RAD = math.radians(10.0)
"""Directions without any return in all clouds looked at are no part of the lidar's view."""

Heights = tuple[float, float]
"""The lowest and the highest return that count, in metres."""


@dataclass(frozen=True, slots=True)
class CloudsWanted:
    """topics: of the clouds. heights_m: above the base frame, None where a level ring, else the
    height of the sensor, decides. base_frame: as a user names it, or empty. is_sampled: whether
    some clouds are enough."""

    topics: tuple[str, ...]
    heights_m: Heights | None = None
    base_frame: str = ""
    is_sampled: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Of a sensor on its robot. base_frame: empty if nothing says where it is."""

    frame: str
    base_frame: str
    T_base_sensor: FloatArray

    def levelled(self) -> FloatArray:
        """3 x 3 R_sensor_level: z as that of the base, x as close to the sensor's as can be."""
        up = self.T_base_sensor[2, :3]
        if up[2] > LEVEL:
            return np.eye(3)
        ahead = np.eye(3)[0 if abs(up[0]) < 0.9 else 1]
        x = ahead - up * (up @ ahead)
        x /= np.linalg.norm(x)
        return np.column_stack([x, np.cross(up, x), up])

    def heights(self, wanted: Heights | None) -> Heights:
        """Of the returns that count, above the sensor."""
        above_base_m = float(self.T_base_sensor[2, 3])
        if wanted is not None:
            return wanted[0] - above_base_m, wanted[1] - above_base_m
        if not self.base_frame:
            return -_FLOOR_M, _BAND_M
        return max(-_BAND_M, min(_FLOOR_M - above_base_m, 0.0)), _BAND_M

    def in_words(self, heights_m: Heights) -> str:
        above = float(self.T_base_sensor[2, 3])
        low, high = (height + above for height in heights_m)
        return f"heights {low:.2f} to {high:.2f} m above {self.base_frame or self.frame}"


@dataclass(frozen=True, slots=True, eq=False)
class _Plan:
    """How the clouds of a topic are cut: alike for all of them.

    ring: None where heights_m, above the sensor, choose. beams: of a full turn, the first at
    phase_rad. first, count: those that the lidar sees. sweep: None for clouds without times; then
    turns is the direction in which the points of a cloud follow each other, 0 if in none.
    in_order: False where a turn's points do not follow each other, so that their times are lost.
    """

    ring: int | None
    heights_m: Heights
    beams: int
    phase_rad: float
    first: int
    count: int
    sweep: Sweep | None
    turns: int = 0
    in_order: bool = True

    @property
    def step_rad(self) -> float:
        return 2.0 * math.pi / self.beams

    def chosen(self, cloud: Points) -> Points:
        if self.ring is not None and cloud.ring is not None:
            return cloud[cloud.ring == self.ring]
        low, high = self.heights_m
        up = cloud.xyz_m[:, 2]
        return cloud[(up >= low) & (up <= high)]


class CloudSlicer:
    """Makes scans of the clouds of one topic, batch by batch; the first one tells how to cut.

    path: how the base of the place moved, None if that is not known. note: how it is done, in
    words, after the first batch.
    """

    def __init__(
        self, topic: str, place: Place, wanted_m: Heights | None, path: Trajectory | None = None
    ) -> None:
        self._topic, self._place, self._wanted_m = topic, place, wanted_m
        self._R_sensor_level = place.levelled()
        self._motion: CloudMotion | None = None
        if path is not None and len(path):
            T_base_level = place.T_base_sensor.copy()
            T_base_level[:3, :3] = T_base_level[:3, :3] @ self._R_sensor_level
            self._motion = CloudMotion(path, T_base_level)
        self._plan: _Plan | None = None
        self._layouts: dict[ScanLayout, int] = {}
        self._layout_of: list[int] = []
        self._stamps_ns: list[int] = []
        self._received_ns: list[int] = []
        self._ranges = RowStore()
        self._farthest_m = np.float32(1.0)
        self.note = ""

    def add(self, clouds: Sequence[Points]) -> None:
        """The next clouds, in the order of the file."""
        level = [replace(cloud, xyz_m=cloud.xyz_m @ self._R_sensor_level) for cloud in clouds]
        if self._plan is None and level:
            self._plan, self.note = _planned(level, self._place, self._wanted_m)
            if self._motion is not None:
                self.note += self._motion.note(self._plan.sweep)
        for cloud in level:
            assert self._plan is not None
            motion, sweep = self._motion, self._plan.sweep
            self._append(cloud if motion is None else motion.undone(cloud, sweep), self._plan)

    def _append(self, cloud: Points, plan: _Plan) -> None:
        chosen = plan.chosen(cloud)
        ranges_m = np.hypot(chosen.xyz_m[:, 0], chosen.xyz_m[:, 1]).astype(np.float32)
        bins, off_rad = _bins(chosen, plan.beams, plan.phase_rad)
        start, direction, beam_dt_s, begin_s = plan.first, 1, 0.0, 0.0
        beam = (bins - start) % plan.beams
        if plan.sweep is not None and chosen.time is not None and bins.size:
            times_s = plan.sweep.after_stamp_s(chosen.time, cloud.stamp_ns)
            direction, beam_dt_s = plan.sweep.direction, plan.step_rad * plan.sweep.s_per_rad
            if plan.count == plan.beams:
                start = int(bins[np.argmin(times_s)])
            elif direction < 0:
                start = (plan.first + plan.count - 1) % plan.beams
            beam = (direction * (bins - start)) % plan.beams
            begin_s = float(np.median(times_s - beam * beam_dt_s))
            off_s = np.abs(times_s - begin_s - beam * beam_dt_s)
            in_turn = (beam_dt_s == 0.0) | (off_s < 0.5 * plan.beams * beam_dt_s)
            beam, ranges_m, off_rad = beam[in_turn], ranges_m[in_turn], off_rad[in_turn]
        elif plan.turns and plan.count == plan.beams and bins.size:
            start, direction = int(bins[0]), plan.turns
            beam = (direction * (bins - start)) % plan.beams
        seen = beam < plan.count
        if plan.ring is None:
            surfaces = _surfaces(beam[seen], ranges_m[seen], direction * off_rad[seen], plan.count)
            row = _at_centres(*surfaces, plan.step_rad)
        else:
            row = _nearest_m(beam[seen], ranges_m[seen], plan.count)
        self._farthest_m = max(self._farthest_m, ranges_m.max(initial=np.float32(0.0)))
        self._ranges.add(row[None])
        self._stamps_ns.append(cloud.stamp_ns + round(1e9 * begin_s))
        self._received_ns.append(cloud.received_ns)
        layout = _layout(plan, start, direction, beam_dt_s)
        self._layout_of.append(self._layouts.setdefault(layout, len(self._layouts)))

    def stream(self) -> RawScans:
        """All scans. Raises ValueError where no cloud holds a return that counts."""
        range_max_m = float(np.nextafter(self._farthest_m, np.float32(np.inf)))
        return RawScans(
            topic=self._topic,
            frame_ids=(self._frame,),
            stamps_ns=np.array(self._stamps_ns, dtype=np.int64),
            received_ns=np.array(self._received_ns, dtype=np.int64),
            layouts=tuple(replace(each, range_max_m=range_max_m) for each in self._layouts),
            layout_of=np.array(self._layout_of, dtype=np.int32),
            ranges_m=self._ranges.rows(),
            range_is_estimated=True,
            in_order=self._plan is None or self._plan.in_order,
            note=self.note,
        )

    @property
    def _is_level(self) -> bool:
        return bool(np.array_equal(self._R_sensor_level, np.eye(3)))

    @property
    def _frame(self) -> str:
        return self._place.frame if self._is_level else f"{self._place.frame}_level"

    def edges(self) -> tuple[TransformEdge, ...]:
        """The transform to the frame of the scans where that is not the sensor's own."""
        if self._is_level:
            return ()
        at_ns = np.array(self._stamps_ns[:1], dtype=np.int64)
        edge = TransformEdge(
            *("/tf_static", self._place.frame, self._frame, True, at_ns, at_ns),
            positions_m=np.zeros((1, 3)),
            quats_xyzw=xyzw_from_matrix(self._R_sensor_level)[None],
        )
        return (edge,)


def _layout(plan: _Plan, start: int, direction: int, beam_dt_s: float) -> ScanLayout:
    step_rad = direction * plan.step_rad
    angle_min_rad = float(wrap_angle(np.array(plan.phase_rad + start * plan.step_rad)))
    scan_time_s = plan.beams * beam_dt_s
    angle_max_rad = angle_min_rad + (plan.count - 1) * step_rad
    return ScanLayout(angle_min_rad, angle_max_rad, step_rad, beam_dt_s, scan_time_s, 0.0, 0.0)


def _planned(clouds: Sequence[Points], place: Place, wanted_m: Heights | None) -> tuple[_Plan, str]:
    """(how to cut, in words). Raises ValueError where nothing can be cut out."""
    ring, words = None, ""
    if wanted_m is None:
        ring, words = _level_ring(clouds)
    heights_m = place.heights(wanted_m)
    plan = _Plan(ring, heights_m, _SLAB_BEAMS, 0.0, 0, _SLAB_BEAMS, None)
    chosen = [plan.chosen(cloud) for cloud in clouds]
    if not any(len(each.xyz_m) for each in chosen):
        raise ValueError(
            f"none of its first {len(clouds)} clouds has a return at {place.in_words(heights_m)}"
            ": --cloud-height LOW,HIGH chooses others"
        )
    beams, phase_rad, regular = _directions(chosen)
    if ring is None and (beams > _SLAB_BEAMS or regular < _REGULAR):
        beams, phase_rad = _seldom_empty(chosen), 0.0
    bins = np.unique(np.concatenate([_bins(each, beams, phase_rad)[0] for each in chosen]))
    first, count = _view(bins, beams)
    sweep, timed = sweep_of(chosen)
    how = words or place.in_words(heights_m)
    note = f"cut out of point clouds: {how}, {360.0 / beams:.2g} deg a beam; {timed}"
    plan = _Plan(ring, heights_m, beams, phase_rad, first, count, sweep)
    if sweep is not None:
        return replace(plan, in_order=sweep.s_per_rad > 0.0), note
    steps = _steps(chosen, beams)
    turns = _turns(steps)
    in_order = turns != 0 or count < beams or not _jumps(steps, beams)
    return replace(plan, turns=turns, in_order=in_order), note + ("" if in_order else _IN_NO_ORDER)


def _jumps(steps: IntArray, beams: int) -> bool:
    """Whether the next point often lies elsewhere in the turn, as after a voxel filter. Several
    channels that fire together at other azimuths are some beams apart."""
    changes = np.abs(steps[steps != 0])
    return changes.size > 0 and float((changes > _JUMP * beams).mean()) > _JUMPS


def _steps(clouds: Sequence[Points], beams: int) -> IntArray:
    """By how many beams each point is farther round than the one before it in its cloud."""
    steps = np.concatenate([np.diff(_bins(cloud, beams, 0.0)[0]) for cloud in clouds])
    return np.asarray((steps + beams // 2) % beams - beams // 2)


def _turns(steps: IntArray) -> int:
    """The direction in which points follow each other: 1, -1, or 0 in none.

    Then they show where a turn begins, without which SLAM could not estimate how long it lasts.
    """
    onward = float((steps[steps != 0] > 0).mean()) if steps.any() else 0.5
    return int(onward > _IN_ORDER) - int(onward < 1.0 - _IN_ORDER)


def _level_ring(clouds: Sequence[Points]) -> tuple[int | None, str]:
    """(the ring that looks level, in words), of two that do as well the upper one."""
    rings = [cloud.ring for cloud in clouds if cloud.ring is not None]
    if len(rings) < len(clouds):
        return None, ""
    ring, xyz_m = np.concatenate(rings), np.concatenate([cloud.xyz_m for cloud in clouds])
    up_rad = np.arctan2(xyz_m[:, 2], np.hypot(xyz_m[:, 0], xyz_m[:, 1]))
    numbers, counts = np.unique(ring, return_counts=True)
    found: list[tuple[float, float, int]] = []
    for number, count in zip(numbers.tolist(), counts.tolist(), strict=True):
        mine = up_rad[ring == number]
        off_rad = float(np.quantile(np.abs(mine), 0.95))
        if off_rad <= _LEVEL_RING_RAD and 2 * count >= np.median(counts):
            found.append((round(abs(float(np.median(mine))), 3), -float(np.median(mine)), number))
    if not found:
        return None, ""
    _, down_rad, number = min(found)
    return number, f"ring {number} of {numbers.size}, {math.degrees(-down_rad):+.1f} deg"


def _azimuths_rad(cloud: Points) -> FloatArray:
    return np.asarray(np.arctan2(cloud.xyz_m[:, 1], cloud.xyz_m[:, 0]))


def _bins(cloud: Points, beams: int, phase_rad: float) -> tuple[IntArray, FloatArray]:
    """(n,) the direction of each return, as one of so many on a turn, and (n,) by how much it is
    farther to the left than that."""
    step_rad = 2.0 * math.pi / beams
    angles_rad = _azimuths_rad(cloud) - phase_rad
    bins = np.rint(angles_rad / step_rad)
    return np.asarray(bins.astype(np.int64) % beams), angles_rad - bins * step_rad


def _nearest_m(beam: IntArray, ranges_m: NDArray[np.float32], count: int) -> NDArray[np.float32]:
    """(count,) range of the nearest return in each beam, nan without one."""
    nearest_m = np.full(count, np.nan, dtype=np.float32)
    np.fmin.at(nearest_m, beam, ranges_m)
    return nearest_m


def _surfaces(
    beam: IntArray, ranges_m: NDArray[np.float32], off_rad: FloatArray, count: int
) -> tuple[NDArray[np.float32], FloatArray]:
    """(count,) range of the nearest surface in each beam, nan without a return, and (count,) the
    mean direction of its returns. The nearest return alone is too near by its noise: by 23 mm
    where five of a lidar with 20 mm fall into a beam.

    beam, ranges_m, off_rad: (n,) of the returns.
    """
    nearest_m = _nearest_m(beam, ranges_m, count)
    limit_m = nearest_m + np.maximum(_TOGETHER_M, _TOGETHER_SHARE * nearest_m)
    together = ranges_m <= limit_m[beam]
    beam, ranges_m, off_rad = beam[together], ranges_m[together], off_rad[together]
    returns = np.bincount(beam, minlength=count)
    with np.errstate(invalid="ignore"):
        mean_m = np.bincount(beam, ranges_m, count) / returns
    return mean_m.astype(np.float32), np.bincount(beam, off_rad, count) / np.maximum(returns, 1)


def _at_centres(
    ranges_m: NDArray[np.float32], off_rad: FloatArray, step_rad: float
) -> NDArray[np.float32]:
    """(beams,) ranges of a surface at the very directions of the beams that have a return, from
    those beside them: half a degree off is 26 mm on a wall 3 m away that is seen at 45 degrees.

    off_rad: (beams,) by how much each return is farther along than its beam. The first and the last
    beam have none beside them on one side, also of a full turn, which ends when it begins anew.
    """
    there = np.flatnonzero(np.isfinite(ranges_m))
    if there.size < 2:
        return ranges_m
    centres_rad = np.arange(ranges_m.size) * step_rad
    angles_rad = there * step_rad + off_rad[there]
    after = np.clip(np.searchsorted(angles_rad, centres_rad), 1, there.size - 1)
    a_rad, b_rad = angles_rad[after - 1], angles_rad[after]
    a_m, b_m = ranges_m[there[after - 1]], ranges_m[there[after]]
    apart_rad = b_rad - a_rad
    between = (a_rad <= centres_rad) & (centres_rad <= b_rad) & (apart_rad > 0.0)
    along_m = _STEEPEST * np.minimum(a_m, b_m) * apart_rad
    joined = (
        np.isfinite(ranges_m)
        & between
        & (apart_rad <= _NEAR_BEAMS * step_rad)
        & (np.abs(a_m - b_m) <= along_m)
    )
    a_rad, b_rad, a_m, b_m = a_rad[joined], b_rad[joined], a_m[joined], b_m[joined]
    at_rad = centres_rad[joined]
    # The line through both points in polar coordinates.
    nearness = np.sin(b_rad - at_rad) / a_m + np.sin(at_rad - a_rad) / b_m
    result = ranges_m.copy()
    result[joined] = np.sin(b_rad - a_rad) / nearness
    return result


def _seldom_empty(clouds: Sequence[Points]) -> int:
    """Beams of a turn, no narrower than the directions of the returns that count are apart."""
    apart_rad = _apart_rad(clouds)
    if not apart_rad.size:
        return _SLAB_BEAMS
    step_rad = float(np.quantile(apart_rad, _NEIGHBOURS))
    return int(np.clip(2.0 * math.pi / step_rad, _FEWEST_BEAMS, _SLAB_BEAMS))


def _apart_rad(clouds: Sequence[Points]) -> NDArray[np.float64]:
    """(k,) the steps from one direction to the next within each cloud."""
    steps: NDArray[np.float64] = np.concatenate(
        [np.diff(np.sort(_azimuths_rad(cloud))) for cloud in clouds]
    )
    return steps[steps > 1e-5]


def _directions(clouds: Sequence[Points]) -> tuple[int, float, float]:
    """(beams of a turn, angle of one of them, how regular: 1 where all are multiples of the step
    between beams, about 0 at random) of the returns that count."""
    apart = _apart_rad(clouds)
    if not apart.size:
        return _SLAB_BEAMS, 0.0, 0.0
    beams = int(np.clip(round(2.0 * math.pi / np.median(apart)), _FEWEST_BEAMS, _MOST_BEAMS))
    angles = np.concatenate([_azimuths_rad(cloud) for cloud in clouds])
    mean = np.exp(1j * beams * angles).mean()
    return beams, float(np.angle(mean)) / beams, float(np.abs(mean))


def _view(bins: IntArray, beams: int) -> tuple[int, int]:
    """(first, how many) of the beams around the largest gap in the directions that were seen.

    bins: sorted and unique.
    """
    gaps = np.diff(np.append(bins, bins[0] + beams))
    widest = int(np.argmax(gaps))
    if gaps[widest] * 2.0 * math.pi / beams < _GAP_RAD:
        return 0, beams
    return int(bins[(widest + 1) % bins.size]), int(beams - gaps[widest] + 1)
