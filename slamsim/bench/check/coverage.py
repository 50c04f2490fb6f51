"""Whether stated uncertainties are honest: estimates against what was simulated and injected."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from typing import cast

import numpy as np

from slamsim.bench.check.outcome import Json, Measured, Outcome

MOST_SIGMAS = 1.96
SIGMAS_PER_MEDIAN = 1.4826
"""Standard deviation of a normal error over the median of its size."""


def coverage(outcomes: Iterable[Outcome]) -> dict[str, Json]:
    """By check: how often the truth lies inside the 95 % interval, errors, sigmas, bounds.

    ratio: error over sigma, 1 for honest ones, and error: both as standard deviations by their
    medians, so that single wild ones show in ``inside`` alone. over_bound: median of sigma over
    the least one possible. An inconclusive answer counts: its interval is stated too.
    """
    pairs: dict[str, list[tuple[Measured, float]]] = defaultdict(list)
    for outcome in outcomes:
        for measured in outcome.measured:
            if measured.check in outcome.truth and np.isfinite(measured.sigma):
                pairs[measured.check].append((measured, outcome.truth[measured.check]))
    return {check: _figures(found) for check, found in sorted(pairs.items())}


def coverage_row(figures: Json) -> str:
    """What a person sees of one check."""
    unit, over_bound = figures["unit"], figures["over_bound"]
    told = (
        f"{100.0 * cast(float, figures['inside']):.1f} % of {figures['count']} inside; "
        f"error/sigma {figures['ratio']:.2f}; sigma {figures['sigma']:.3g} {unit}, "
        f"error {figures['error']:.3g} {unit}"
    )
    return told if over_bound is None else f"{told}; {over_bound:.2f} x the bound"


def _error(measured: Measured, truth: float) -> float:
    error = measured.value - truth
    return (error + 180.0) % 360.0 - 180.0 if measured.unit == "deg" else error


def _figures(pairs: list[tuple[Measured, float]]) -> Json:
    errors = np.array([_error(measured, truth) for measured, truth in pairs])
    sigmas = np.maximum([measured.sigma for measured, _ in pairs], 1e-300)
    bounds = [m.sigma / m.bound for m, _ in pairs if m.bound is not None and m.bound > 0.0]
    return {
        "count": len(pairs),
        "inside": float(np.mean(np.abs(errors) <= MOST_SIGMAS * sigmas)),
        "ratio": SIGMAS_PER_MEDIAN * float(np.median(np.abs(errors / sigmas))),
        "sigma": float(np.median(sigmas)),
        "error": SIGMAS_PER_MEDIAN * float(np.median(np.abs(errors))),
        "unit": pairs[0][0].unit,
        "over_bound": float(np.median(bounds)) if bounds else None,
    }
