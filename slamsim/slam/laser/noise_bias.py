"""What noise of the ranges makes of the shape of a lidar's scans: noise is added, and that is seen.

Surfaces that are seen at a slant are fitted a little wrong where beams are few and noisy: in a ring
of corridors, by 94 beams over 180 degrees with 19 mm of noise, angles that are right seemed 0.9 %
too large, nine of their standard deviations. The shift grows as the variance of the noise, so that
as much noise again shifts them as much again (simulation extrapolation: Cook & Stefanski 1994).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import overload

import numpy as np

from slamsim.core.types import Float32Array, IntArray
from slamsim.recording import RawScans
from slamsim.slam.laser.scan_beams import BeamReader
from slamsim.slam.laser.scan_motion import ScanMotions, ShapeBias, window_motions
from slamsim.slam.laser.scan_scale import ANGLE_SCALE

DRAWS = 2
"""Of noise: each takes as long as the estimate itself."""

UNSURE_SHARE = 0.5
"""Of a shift that is not known: the noise that is seen in a scan is a tenth to a third less than
what there is, and not all of the shift grows with its square."""


def without_noise_bias(
    scans: RawScans, windows: list[IntArray], motions: ScanMotions
) -> ScanMotions:
    """The motions of these windows again, their shape without what noise makes of it.

    With noise upon them scans may fit at another rough angle between beams, or nowhere: that is no
    shift of the fit that was found, so each begins from the rough angle of that one.
    """
    rough = motions.rough_angle_scale
    shifts = []
    for seed in range(DRAWS):
        noisier = replace(scans, ranges_m=_Noisier(scans, motions.range_noise_m, seed))
        shift = window_motions(noisier, windows, angle_scale=rough).shape - motions.shape
        shift[ANGLE_SCALE] /= rough
        shifts.append(np.where(np.isfinite(shift), shift, 0.0))
    shift = np.mean(shifts, axis=0)
    scatter = np.std(shifts, axis=0, ddof=1) / np.sqrt(DRAWS)
    bias = ShapeBias(shift, np.hypot(scatter, UNSURE_SHARE * np.abs(shift)))
    return window_motions(scans, windows, bias, rough)


class _Noisier(Sequence[Float32Array]):
    """Rows of ranges with independent noise upon each range, made as they are asked for; what is
    no range stays, to the bit."""

    def __init__(self, scans: RawScans, noise_m: float, seed: int) -> None:
        self._scans, self._reader, self._seed = scans, BeamReader(scans), seed
        self._noise = noise_m / self._reader.metres_per_unit

    def __len__(self) -> int:
        return len(self._scans)

    @overload
    def __getitem__(self, at: int) -> Float32Array: ...

    @overload
    def __getitem__(self, at: slice) -> list[Float32Array]: ...

    def __getitem__(self, at: int | slice) -> Float32Array | list[Float32Array]:
        if isinstance(at, slice):
            return [self[scan] for scan in range(*at.indices(len(self)))]
        ranges = np.asarray(self._scans.ranges_m[at], dtype=np.float32)
        noise = np.random.default_rng((self._seed, at)).normal(0.0, self._noise, ranges.shape)
        return np.where(self._reader.returns(ranges), ranges + noise, ranges).astype(np.float32)
