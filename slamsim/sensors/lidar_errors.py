"""Error model of the lidar: from true ranges to measured ones.

Each effect is a function of arrays and its own generator, drawn once for every beam in the order
of the beams whatever it hit: switching one effect on or off, or cutting the beams into other
batches, leaves the draws of all others as they were. Ranges are float32, ``inf`` is no return.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamsim.config.lidar import DropoutConfig, LidarConfig, MixedReturnsConfig, RangeNoiseConfig
from slamsim.core.jit import kernel
from slamsim.core.types import BoolArray, Float32Array, FloatArray
from slamsim.sensors.scene import NOTHING, Hits

SUB_RAYS = 8
GRAZING = 0.01
"""Cosine of incidence below which the noise of the spot grows no further."""


@dataclass(frozen=True, slots=True, eq=False)
class EffectStreams:
    """One generator for each random effect."""

    noise: np.random.Generator
    dropout: np.random.Generator
    mixed: np.random.Generator


def measured(hits: Hits, config: LidarConfig, streams: EffectStreams) -> Float32Array:
    """(n,) readings of the beams that met ``hits`` (edges already mixed), in their order."""
    lost = too_slanted(hits, config.max_incidence_deg)
    if has_dropout(config.dropout):
        lost |= dropped(hits, config.dropout, config.range_max_m, streams.dropout)
    ranges = np.where(lost, np.float32(np.inf), hits.ranges_m)
    if has_noise(config.noise):
        ranges = noisy(ranges, hits.cos_incidence, config.noise, streams.noise)
    return reported(ranges, config.resolution_m, config.range_min_m, config.range_max_m)


def has_dropout(config: DropoutConfig) -> bool:
    """Whether any beam can get lost by chance."""
    return max(config.probability, config.at_max_range, config.at_grazing) > 0.0


def has_noise(config: RangeNoiseConfig) -> bool:
    """Whether any range gets noise."""
    return max(config.constant_m, config.proportional, config.spot_mrad) > 0.0


def too_slanted(hits: Hits, max_incidence_deg: float) -> BoolArray:
    """(n,) whether the surface slants away too far to send light back."""
    if max_incidence_deg >= 90.0:
        return np.zeros(hits.ranges_m.size, dtype=np.bool_)
    return hits.cos_incidence < np.float32(np.cos(np.radians(max_incidence_deg)))


def dropped(
    hits: Hits, config: DropoutConfig, range_max_m: float, rng: np.random.Generator
) -> BoolArray:
    """(n,) whether each return is lost by chance: more likely far away and on slanted walls."""
    draws = rng.random(hits.ranges_m.size, dtype=np.float32)
    parts = config.probability, config.at_max_range / range_max_m**2, config.at_grazing
    return _dropped(hits.ranges_m, hits.cos_incidence, draws, range_max_m, *parts)


@kernel
def _dropped(
    ranges_m: Float32Array,
    cosines: Float32Array,
    draws: Float32Array,
    range_max_m: float,
    always: float,
    by_range_squared: float,
    by_slant: float,
) -> BoolArray:
    lost = np.empty(ranges_m.size, dtype=np.bool_)
    for beam in range(ranges_m.size):
        length = min(ranges_m[beam], range_max_m)
        chance = always + by_range_squared * length * length + by_slant * (1.0 - cosines[beam])
        lost[beam] = draws[beam] < chance
    return lost


def noisy(
    ranges_m: Float32Array,
    cos_incidence: Float32Array,
    config: RangeNoiseConfig,
    rng: np.random.Generator,
) -> Float32Array:
    """(n,) ranges with normal noise of the constant, proportional and slanted-spot variances."""
    draws = rng.standard_normal(ranges_m.size, dtype=np.float32)
    variances = config.constant_m**2, config.proportional**2, (config.spot_mrad * 1e-3) ** 2
    return _noisy(ranges_m, cos_incidence, draws, *variances)


@kernel
def _noisy(
    ranges_m: Float32Array,
    cosines: Float32Array,
    draws: Float32Array,
    constant: float,
    proportional: float,
    spot: float,
) -> Float32Array:
    noisy = np.empty_like(ranges_m)
    for beam in range(ranges_m.size):
        length = ranges_m[beam]
        if length < np.inf:
            cos = max(cosines[beam], GRAZING)
            tan_squared = max(1.0 / (cos * cos) - 1.0, 0.0)
            sigma = np.sqrt(constant + length * length * (proportional + spot * tan_squared))
            length += sigma * draws[beam]
        noisy[beam] = length
    return noisy


@kernel
def reported(
    ranges_m: Float32Array, resolution_m: float, range_min_m: float, range_max_m: float
) -> Float32Array:
    """(n,) ranges as the device gives them: in whole multiples of the resolution (0: as they
    are), below the minimum invalid (nan), above the maximum no return (inf)."""
    readings = np.empty_like(ranges_m)
    for beam in range(ranges_m.size):
        length = float(ranges_m[beam])
        if resolution_m > 0.0:
            length = np.rint(length / resolution_m) * resolution_m
        if length > range_max_m:
            length = np.inf
        elif length < range_min_m:
            length = np.nan
        readings[beam] = length
    return readings


def beside_a_jump(hits: Hits, beam_count: int, min_gap_m: float) -> BoolArray:
    """(n,) beams beside which the surface changes with a jump: only they may see two.

    n is a whole number of scans. A neighbour on another surface closer than the gap is a corner.
    """
    return _beside_a_jump(hits.ranges_m, hits.surfaces, beam_count, min_gap_m)


@kernel
def _beside_a_jump(
    ranges_m: Float32Array, surfaces: NDArray[np.int32], beam_count: int, min_gap_m: float
) -> BoolArray:
    beside = np.zeros(ranges_m.size, dtype=np.bool_)
    for beam in range(1, ranges_m.size):
        if surfaces[beam] != surfaces[beam - 1] and beam % beam_count != 0:
            jumps = abs(ranges_m[beam] - ranges_m[beam - 1]) > min_gap_m
            beside[beam] |= jumps
            beside[beam - 1] |= jumps
    return beside


def sub_ray_directions(divergence_mrad: float) -> FloatArray:
    """(2, SUB_RAYS) cosines and sines that sample the width of a beam about its middle."""
    across = ((np.arange(SUB_RAYS) + 0.5) / SUB_RAYS - 0.5) * divergence_mrad * 1e-3
    return np.stack([np.cos(across), np.sin(across)])


def turned(directions: FloatArray, sub_rays: FloatArray) -> FloatArray:
    """(2, m * SUB_RAYS) the sub-rays about each of (2, m) directions."""
    (cos, sin), (cos_across, sin_across) = directions[:, :, None], sub_rays
    x = cos * cos_across - sin * sin_across
    y = sin * cos_across + cos * sin_across
    return np.stack([x.ravel(), y.ravel()])


def mixed(middle: Hits, parts: Hits, config: MixedReturnsConfig, rng: np.random.Generator) -> Hits:
    """What (m,) beams report whose parts (m * SUB_RAYS,) may lie on two surfaces.

    The nearest surface and the rest return light in proportion to their share of the beam over
    the squared range. If their gap is within the limits, a beam mixes both ranges by that light
    with the configured probability; otherwise the stronger one wins. One surface: no change.
    """
    ranges = parts.ranges_m.reshape(-1, SUB_RAYS).astype(np.float64)
    surfaces = parts.surfaces.reshape(-1, SUB_RAYS)
    row, nearest = np.arange(len(ranges)), ranges.argmin(axis=1)
    first = ranges[row, nearest][:, None]
    near = (surfaces == surfaces[row, nearest][:, None]) | (ranges < first + config.min_gap_m)
    near &= surfaces != NOTHING
    far = ~near & (surfaces != NOTHING)
    near_m, near_light = _mean_and_light(ranges, near)
    far_m, far_light = _mean_and_light(ranges, far)

    two = near.any(axis=1) & far.any(axis=1)
    mixes = (far_m - near_m <= config.max_gap_m) & (rng.random(len(ranges)) < config.probability)
    mixture = (near_light * near_m + far_light * far_m) / np.maximum(near_light + far_light, 1e-30)
    stronger = np.where(near_light >= far_light, near_m, far_m)
    cosines = parts.cos_incidence.reshape(-1, SUB_RAYS).max(axis=1)
    return Hits(
        np.where(two, np.where(mixes, mixture, stronger), middle.ranges_m).astype(np.float32),
        np.where(two, cosines, middle.cos_incidence),
        middle.surfaces,
        middle.triangles,
    )


def _mean_and_light(ranges: FloatArray, member: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Mean range of the member sub-rays of each row, and the light they return."""
    count = member.sum(axis=1)
    mean = np.where(member, ranges, 0.0).sum(axis=1) / np.maximum(count, 1)
    return mean, count / np.maximum(mean, 1e-3) ** 2


def strengths(hits: Hits, readings_m: Float32Array) -> Float32Array:
    """(n,) light of each return: cos(incidence) / max(range, 1 m) squared, 0 without return."""
    light = hits.cos_incidence / np.maximum(hits.ranges_m, np.float32(1.0)) ** 2
    return np.where(np.isfinite(readings_m), light, np.float32(0.0))
