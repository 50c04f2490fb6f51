"""A scan as a few straight surface pieces: the points that a matcher works on.

Runs of neighbouring beams are split where another surface begins and cut into short lengths, each
fitted by total least squares. A piece keeps the information of all its beams in one mean and one
normal: a tenth of the points, each with a third of the noise.
"""

from __future__ import annotations

import numpy as np

from slamsim.core.jit import kernel
from slamsim.core.types import BoolArray, Cloud, FloatArray
from slamsim.models.line_bundle import principal_axis
from slamsim.slam.matching.runs import LEAST_INCIDENCE, joined, parted
from slamsim.slam.matching.small import median

# Columns of a piece. Scatter is the sum of squares about the mean, in square metres.
X, Y, NORMAL_X, NORMAL_Y, BEAMS, SCATTER_XX, SCATTER_XY, SCATTER_YY, HALF_LENGTH, VARIANCE = range(
    10
)
PIECE_FIELDS = 10
MEAN, SCATTER = [X, Y], [SCATTER_XX, SCATTER_XY, SCATTER_YY]

MIN_BEAMS = 3
MIN_BEAMS_TO_SPARE = 8
"""Runs of this many beams do without their first and last, which may have met two surfaces."""

MAX_SILENT_BEAMS = 1
"""A surface goes on past so many beams without a return. Where half of all returns are lost, runs
that end at each of them hold two beams on average, too few to show which way a wall runs; with one
beam bridged they hold four. Bridging two joined aces' walls across doors."""

BEAMS_PER_PIECE = 5.0
"""Pieces are lengthened, where beams are far apart, to hold about this many."""

MIN_INCIDENCE_SIN = 0.08
MAX_NORMAL_SIGMA_RAD = 0.35
MODEL_SIGMA_M = 0.002
"""What even a long average does not remove: dents, beam width, deskew, quantisation."""


def surface_pieces(cloud: Cloud, noise_m: float, piece_m: float, reach_m: float) -> FloatArray:
    """(k, PIECE_FIELDS) straight pieces of a cloud in its own frame, normals towards the lidar.

    noise_m: standard deviation of a range. piece_m: their length where beams are dense. Hits
    beyond reach_m are left out. VARIANCE is that of the mean along the normal.
    """
    return _pieces(cloud.points_m, cloud.origins_m, cloud.hit, noise_m, piece_m, reach_m)


def range_noise_m(pieces: FloatArray) -> float:
    """Standard deviation of a range, as the scatter of the pieces shows it; nan without enough.

    pieces: (n, PIECE_FIELDS).
    """
    return float(_noise(pieces))


@kernel
def _moments(
    points: FloatArray, first: int, last: int
) -> tuple[float, float, tuple[float, float, float]]:
    """Mean of points first..last, and their scatter about it."""
    count = last - first + 1
    x = y = xx = xy = yy = 0.0
    for i in range(first, last + 1):
        x += points[i, 0]
        y += points[i, 1]
    x /= count
    y /= count
    for i in range(first, last + 1):
        dx, dy = points[i, 0] - x, points[i, 1] - y
        xx += dx * dx
        xy += dx * dy
        yy += dy * dy
    return x, y, (xx, xy, yy)


@kernel
def _without_slant(
    scatter: tuple[float, float, float], beam: tuple[float, float], noise: float
) -> tuple[float, float, float]:
    """The scatter about a slanted surface, less what range errors add along it.

    They move points along their beam, which turns the axis of least scatter away from the normal.
    What they add across the surface stays. beam: unit vector. noise: expected sum of squares.
    """
    (xx, xy, yy), (vx, vy) = scatter, beam
    nx, ny, _, _ = principal_axis(xx - noise * vx * vx, xy - noise * vx * vy, yy - noise * vy * vy)
    across = (nx * vx + ny * vy) * (nx * vx + ny * vy)
    return (
        xx - noise * (vx * vx - across * nx * nx),
        xy - noise * (vx * vy - across * nx * ny),
        yy - noise * (vy * vy - across * ny * ny),
    )


@kernel
def _normal_sigma(
    scatter: tuple[float, float, float], beam: tuple[float, float], noise: float
) -> float:
    """Standard deviation of the angle of a line through points that are off along their beam.

    Their bearings are known: what tells the slope of the ranges, and how surely, is how far the
    points lie apart across the beam. The slope is taken for the flattest that it may be, within two
    sigmas: range errors alone give a few points of a wall seen head-on any slope.
    """
    (xx, xy, yy), (vx, vy) = scatter, beam
    lateral = xx * vy * vy - 2.0 * xy * vx * vy + yy * vx * vx
    if lateral <= 0.0:
        return np.inf
    along = (xx - yy) * vx * vy + xy * (vy * vy - vx * vx)
    sigma = noise / np.sqrt(lateral)
    least = max(np.abs(along) / lateral - 2.0 * sigma, 0.0)
    return float(sigma / (1.0 + least * least))


@kernel
def _fit(
    points: FloatArray,
    origins: FloatArray,
    span: tuple[int, int],
    noise: float,
    piece: FloatArray,
) -> bool:
    """Total least squares through points first..last; False if it tells too little."""
    first, last = span
    count = last - first + 1
    x, y, scatter = _moments(points, first, last)
    vx = 0.5 * (origins[first, 0] + origins[last, 0]) - x
    vy = 0.5 * (origins[first, 1] + origins[last, 1]) - y
    reach = max(np.hypot(vx, vy), 1e-9)
    xx, xy, yy = _without_slant(scatter, (vx / reach, vy / reach), noise * noise * (count - 1))
    nx, ny, least, most = principal_axis(xx, xy, yy)
    incidence = (nx * vx + ny * vy) / reach
    if np.abs(incidence) < MIN_INCIDENCE_SIN:
        return False
    if incidence < 0.0:
        nx, ny = -nx, -ny
    # A range error moves a point along its beam, across the surface only by its incidence.
    across = noise * max(np.abs(incidence), LEAST_INCIDENCE)
    if _normal_sigma(scatter, (vx / reach, vy / reach), noise) > MAX_NORMAL_SIGMA_RAD:
        return False
    piece[X], piece[Y], piece[NORMAL_X], piece[NORMAL_Y] = x, y, nx, ny
    piece[BEAMS] = count
    piece[SCATTER_XX], piece[SCATTER_XY], piece[SCATTER_YY] = xx, xy, yy
    piece[HALF_LENGTH] = np.sqrt(3.0 * most / count)
    rough = max(least / count - across * across, 0.0)
    piece[VARIANCE] = (across * across + rough) / count + MODEL_SIGMA_M * MODEL_SIGMA_M
    return True


@kernel
def _cut(
    points: FloatArray,
    origins: FloatArray,
    span: tuple[int, int],
    sizes: tuple[float, float],
    out: FloatArray,
    kept: int,
) -> int:
    """Cut a straight run into equal pieces and fit each."""
    first, last = span
    noise, piece_m = sizes
    count = last - first + 1
    if count < MIN_BEAMS:
        return kept
    length = np.hypot(points[last, 0] - points[first, 0], points[last, 1] - points[first, 1])
    spacing = length / (count - 1)
    target = max(piece_m, BEAMS_PER_PIECE * spacing)
    parts = max(1, int(np.ceil(length / target)))
    begin = first
    for part in range(1, parts + 1):
        end = first + (count * part) // parts - 1
        if end - begin + 1 >= MIN_BEAMS and _fit(points, origins, (begin, end), noise, out[kept]):
            kept += 1
        begin = end + 1
    return kept


@kernel
def _pieces(
    points: FloatArray,
    origins: FloatArray,
    hit: BoolArray,
    noise: float,
    piece_m: float,
    reach: float,
) -> FloatArray:
    beams = np.flatnonzero(hit)
    points, origins = points[beams], origins[beams]
    count = beams.size
    out = np.empty((count // MIN_BEAMS + 1, PIECE_FIELDS))
    stack = np.empty((64, 2), np.int64)
    kept = 0
    start = 0
    while start < count:
        end = start
        while (
            end + 1 < count
            and beams[end + 1] - beams[end] <= MAX_SILENT_BEAMS + 1
            and joined(points, origins, end, (noise, reach))
        ):
            end += 1
        stack[0, 0], stack[0, 1] = start, end
        depth = 1 if end - start + 1 >= MIN_BEAMS else 0
        while depth > 0:
            depth -= 1
            first, last = stack[depth, 0], stack[depth, 1]
            if last - first + 1 < MIN_BEAMS:
                continue
            middle = parted(points, origins, first, last, noise)
            if middle >= 0 and depth < 62:
                # The nearer half comes off the stack first: pieces stay in beam order.
                stack[depth, 0], stack[depth, 1] = middle + 1, last
                stack[depth + 1, 0], stack[depth + 1, 1] = first, middle
                depth += 2
            else:
                spare = 1 if last - first + 1 >= MIN_BEAMS_TO_SPARE else 0
                span = (first + spare, last - spare)
                kept = _cut(points, origins, span, (noise, piece_m), out, kept)
        start = end + 1
    return out[:kept].copy()


@kernel
def _noise(pieces: FloatArray) -> float:
    spread = np.empty(pieces.shape[0])
    used = 0
    for k in range(pieces.shape[0]):
        beams = pieces[k, BEAMS]
        if beams < 6.0:
            continue
        _, _, least, _ = principal_axis(
            pieces[k, SCATTER_XX], pieces[k, SCATTER_XY], pieces[k, SCATTER_YY]
        )
        reach = max(np.hypot(pieces[k, X], pieces[k, Y]), 1e-9)
        incidence = (
            pieces[k, NORMAL_X] * pieces[k, X] + pieces[k, NORMAL_Y] * pieces[k, Y]
        ) / reach
        spread[used] = np.sqrt(least / (beams - 2.0)) / max(np.abs(incidence), LEAST_INCIDENCE)
        used += 1
    return median(spread, used) if used >= 5 else np.nan
