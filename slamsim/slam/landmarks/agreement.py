"""Whether tags agree with a survey, and on lengths with what else tells them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from slamsim.core.geometry import rotation
from slamsim.core.landmarks import CameraErrors, KnownTag, Landmark
from slamsim.core.types import BoolArray, FloatArray

FARTHEST_SIGMAS = 3.5
"""A surveyed tag that is farther from where the others put it stands elsewhere: of normal errors in
the plane two of a thousand are (chi-squared with two degrees of freedom)."""
FEWEST = 3
"""Tags that agree on where a survey lies; two agree on any distance that is nearly right."""
PARTNERS = 16
"""With so many others each tag is tried as the pair that says where the survey lies."""
DISAGREE_SIGMAS = 2.0
"""As ``slamsim calibrate`` calls a fault what is so far beyond what is claimed."""


def contradicted(found: Mapping[int, Landmark], known: Sequence[KnownTag]) -> dict[int, float]:
    """Of surveyed tags that do not stand where most of the others put them: how far off, in m.

    found: tags as mapped without the survey, by their numbers. None where fewer than three agree,
    or not more than half: nothing tells which is wrong.
    """
    both = [tag for tag in known if tag.number in found]
    if len(both) <= FEWEST:
        return {}
    here = np.array([found[tag.number].T_map_tag[:2] for tag in both])
    there = np.array([tag.T_map_tag[:2] for tag in both])
    own = [np.trace(found[tag.number].covariance[:2, :2] + tag.covariance[:2, :2]) for tag in both]
    variances = np.array(own)
    agree = _most(here, there, variances)
    if agree.sum() < FEWEST or 2 * agree.sum() <= len(both):
        return {}
    off_m = _apart_m(here, there, agree)
    wrong = off_m > FARTHEST_SIGMAS * np.sqrt(variances + variances[agree].mean())
    return {tag.number: float(off) for tag, off, bad in zip(both, off_m, wrong, strict=True) if bad}


def _most(here: FloatArray, there: FloatArray, variances: FloatArray) -> BoolArray:
    """(n,) the largest set of tags that one pair of them, laid onto the survey, explains."""
    count, best = len(here), np.zeros(len(here), np.bool_)
    stride = max(1, count // PARTNERS)
    for one in range(count):
        for other in range(one + 1, count, stride):
            pair = np.isin(np.arange(count), [one, other])
            limit = FARTHEST_SIGMAS * np.sqrt(variances + variances[pair].sum())
            agree = _apart_m(here, there, pair) <= limit
            if agree.sum() > best.sum():
                best = agree
    return best


def _apart_m(here: FloatArray, there: FloatArray, those: BoolArray) -> FloatArray:
    """(n,) how far points (n, 2) are from the survey's, laid onto it by those (n,) of them."""
    middles = here[those].mean(axis=0), there[those].mean(axis=0)
    a, b = here - middles[0], there - middles[1]
    across = (a[those, 0] * b[those, 1] - a[those, 1] * b[those, 0]).sum()
    turn = rotation(np.arctan2(across, (a[those] * b[those]).sum()))[:2, :2]
    return np.asarray(np.linalg.norm(a @ turn.T - b, axis=1))


def disagreement(
    shared: FloatArray, cameras: Mapping[str, CameraErrors], wheels_sigma: float
) -> tuple[float, float]:
    """By what share tags have things farther apart than wheels or lidar have them, and in how many
    standard deviations of what is claimed of both.

    shared: (c, 6) errors of the cameras in their order, then of the wheels, as solved.
    wheels_sigma: of the scale of the wheels' path, 0 where scans hold all of it.
    """
    sigmas = np.array([each.scale for each in cameras.values()])
    camera = int(np.argmax(np.abs(shared[:-1, -1] / sigmas))) if cameras else -1
    scale, sigma = (shared[camera, -1], sigmas[camera]) if cameras else (0.0, 0.0)
    apart, claimed = float(shared[-1, -1] - scale), float(np.hypot(sigma, wheels_sigma))
    return apart, abs(apart) / claimed if claimed else 0.0
