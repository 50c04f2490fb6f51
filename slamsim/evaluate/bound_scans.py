"""Information about pose and walls from the ranges of a scan: the scan part of the bound.

The range to a straight face with outward normal n, seen from p along the unit vector u, changes
with the pose of the robot and with the place of the face as (Censi, "On achievable accuracy for
range-finder localization", ICRA 2007; "On achievable accuracy for pose tracking", ICRA 2009)

    dr = [ -n.dp - n.J(h - p) dyaw + doffset - (J n).(h - c) dangle ] / (n.u)

with h the point hit, c the middle of the face and J a quarter turn. With independent
normal noise of variance s^2 the information is the sum of outer products of these rows over s^2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from slamsim.config.lidar import LidarConfig
from slamsim.core.geometry import compose, se2_from_se3
from slamsim.core.jit import kernel
from slamsim.core.types import FloatArray, IntArray, PlanarTrajectory
from slamsim.evaluate.bound_walls import FaceIndex, Faces, first_face, index_faces
from slamsim.sensors.lidar import scan_geometry
from slamsim.sensors.lidar_errors import GRAZING

LEAST_SIGMA_M = 1e-5
"""No range is taken as more exact than this."""


@dataclass(frozen=True, slots=True, eq=False)
class ScanInformation:
    """Of k scans, each about its own pose: steps of the base (x, y in map axes, yaw).

    pose: (k, 3, 3). A scan meets some faces: rows (m,) of ``scan`` and ``face`` with
    cross (m, 3, 2) between pose and (offset, angle) of the face, and wall (m, 2, 2).
    returns, lost, mixed: beams expected to come back, to get lost by chance, and to straddle an
    edge, summed over all scans.
    """

    pose: FloatArray
    scan: IntArray
    face: IntArray
    cross: FloatArray
    wall: FloatArray
    returns: float
    lost: float
    mixed: float


class NoiseModel(NamedTuple):
    """Of the range to a surface r metres away, met at an angle of incidence i.

    Variance: variance_m2 + r^2 (variance_per_range + spot_rad2 tan^2 i). Chance that a beam gets
    lost: lost + lost_per_m2 r^2 + lost_grazing (1 - cos i); it is lost for sure beyond
    range_max_m, nearer than range_min_m and where cos i < least_cos. mixed: chance that one of
    two neighbours that lie farther apart than gap_m straddles the edge between them.
    """

    variance_m2: float
    variance_per_range: float
    spot_rad2: float
    range_min_m: float
    range_max_m: float
    least_cos: float
    lost: float
    lost_per_m2: float
    lost_grazing: float
    gap_m: float
    mixed: float


def scan_information(
    faces: Faces,
    truth: PlanarTrajectory,
    stamps_ns: IntArray,
    T_base_laser: FloatArray,
    lidar: LidarConfig,
    beam_stride: int = 1,
) -> ScanInformation:
    """Information of the scans that begin at stamps_ns (k,), all covered by the truth.

    truth: ``T_map_base``. beam_stride: only every so many beams are cast, another subset for each
    scan in turn, and count for those between them.
    """
    geometry = scan_geometry(lidar)
    angles_rad, offsets_ns = geometry.angles_rad(), geometry.offsets_ns()
    T_base_laser_2d = se2_from_se3(T_base_laser)
    rows: list[tuple[IntArray, FloatArray]] = []
    pose = np.zeros((len(stamps_ns), 3, 3))
    totals = np.zeros(3)
    work = np.zeros((len(faces), 9))
    model = _noise_model(lidar)
    index = index_faces(faces)
    base = truth.at(stamps_ns)
    for scan, stamp_ns in enumerate(stamps_ns.tolist()):
        beams = np.arange(scan % beam_stride, geometry.beam_count, beam_stride)
        lasers = compose(truth.at(stamp_ns + offsets_ns[beams]), T_base_laser_2d)
        count = geometry.beam_count / len(beams)
        met, counted = _add_scan(
            lasers, angles_rad[beams], base[scan], count, model, index, work, pose[scan]
        )
        totals += counted
        rows.append((met, work[met].copy()))
        work[met] = 0.0
    return _gathered(pose, rows, totals)


def _gathered(
    pose: FloatArray, rows: list[tuple[IntArray, FloatArray]], totals: FloatArray
) -> ScanInformation:
    face = np.concatenate([np.zeros(0, dtype=np.int64), *(met for met, _ in rows)])
    values = np.concatenate([np.zeros((0, 9)), *(sums for _, sums in rows)])
    scan = np.repeat(np.arange(len(rows)), [len(met) for met, _ in rows])
    wall = np.stack([values[:, [6, 7]], values[:, [7, 8]]], axis=1)
    cross = values[:, :6].reshape(-1, 3, 2)
    returns, lost, mixed = totals.tolist()
    return ScanInformation(pose, scan, face, cross, wall, returns, lost, mixed)


def _noise_model(lidar: LidarConfig) -> NoiseModel:
    noise, dropout = lidar.noise, lidar.dropout
    spread = lidar.mixed.divergence_mrad * 1e-3 / math.radians(lidar.angle_step_deg)
    return NoiseModel(
        variance_m2=max(noise.constant_m**2 + lidar.resolution_m**2 / 12.0, LEAST_SIGMA_M**2),
        variance_per_range=noise.proportional**2,
        spot_rad2=(noise.spot_mrad * 1e-3) ** 2,
        range_min_m=lidar.range_min_m,
        range_max_m=lidar.range_max_m,
        least_cos=math.cos(math.radians(lidar.max_incidence_deg)),
        lost=dropout.probability,
        lost_per_m2=dropout.at_max_range / lidar.range_max_m**2,
        lost_grazing=dropout.at_grazing,
        gap_m=lidar.mixed.min_gap_m,
        mixed=min(spread, 1.0),
    )


@kernel
def _add_scan(
    lasers: FloatArray,
    angles_rad: FloatArray,
    base: FloatArray,
    count: float,
    model: NoiseModel,
    faces: FaceIndex,
    sums: FloatArray,
    pose: FloatArray,
) -> tuple[IntArray, FloatArray]:
    """Adds a scan to ``pose`` (3, 3) and to the rows of ``sums`` (faces, 9) it meets.

    Returns which rows these are, and how many beams return, get lost and straddle an edge.
    """
    met = np.empty(lasers.shape[0], dtype=np.int64)
    many = 0
    totals = np.zeros(3)
    row = np.empty(5)
    last_face, last_m = -1, 0.0
    for beam in range(lasers.shape[0]):
        x, y = lasers[beam, 0], lasers[beam, 1]
        heading = lasers[beam, 2] + angles_rad[beam]
        dx, dy = math.cos(heading), math.sin(heading)
        face, far = first_face(x, y, dx, dy, model.range_max_m, faces)
        if beam > 0 and face != last_face and abs(far - last_m) > model.gap_m:
            totals[2] += model.mixed
        last_face, last_m = face, far
        if face < 0 or far < model.range_min_m:
            continue
        nx, ny = faces.normal[face, 0], faces.normal[face, 1]
        slant = nx * dx + ny * dy
        cos = min(-slant, 1.0)
        if cos < model.least_cos:
            continue
        chance, variance = _loss_and_noise(far, cos, model)
        totals[0] += count * (1.0 - chance)
        totals[1] += count * chance
        weight = count * (1.0 - chance) / (variance * slant * slant)
        hx, hy = x + far * dx, y + far * dy
        row[0], row[1] = -nx, -ny
        row[2] = nx * (hy - base[1]) - ny * (hx - base[0])
        row[3] = 1.0
        row[4] = ny * (hx - faces.middle_m[face, 0]) - nx * (hy - faces.middle_m[face, 1])
        if sums[face, 6] == 0.0:
            met[many] = face
            many += 1
        _add_beam(row, weight, pose, sums[face])
    return met[:many].copy(), totals


@kernel
def _loss_and_noise(range_m: float, cos: float, model: NoiseModel) -> tuple[float, float]:
    """Chance that a beam gets lost, and variance of its range if it does not."""
    lost_here = model.lost + model.lost_per_m2 * range_m * range_m
    chance = min(lost_here + model.lost_grazing * (1.0 - cos), 1.0)
    cos = max(cos, GRAZING)
    tan_squared = 1.0 / (cos * cos) - 1.0
    of_range = model.variance_per_range + model.spot_rad2 * tan_squared
    return chance, model.variance_m2 + range_m * range_m * of_range


@kernel
def _add_beam(row: FloatArray, weight: float, pose: FloatArray, sums: FloatArray) -> None:
    """One range's information on pose (3, 3), on its face, and between them (9,)."""
    for i in range(3):
        for j in range(3):
            pose[i, j] += weight * row[i] * row[j]
        sums[2 * i] += weight * row[i]
        sums[2 * i + 1] += weight * row[i] * row[4]
    sums[6] += weight
    sums[7] += weight * row[4]
    sums[8] += weight * row[4] * row[4]
