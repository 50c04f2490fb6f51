"""Do ranges scatter as those of a lidar do? By neighbouring beams on smooth surfaces."""

from __future__ import annotations

import numpy as np

from slamsim.check.fault_groups import BY_SCANS
from slamsim.check.findings import Curve, Finding, Measurement, Plot
from slamsim.check.question import FaultKind, Question, anywhere, judge, unanswered
from slamsim.check.scan_sample import ScanSample
from slamsim.core.types import FloatArray

MOST_M, MOST_SHARE = 0.05, 0.025
"""Data sheets: 1 to 5 cm (SICK, Hokuyo UTM-30LX), 2.5 % of the range (Slamtec RPLIDAR A1)."""

NEIGHBOURS = 15
"""Second differences of so many beams tell one scatter, by their median: an edge is but one."""

SMOOTHEST = 0.25
"""Share of the scene that is taken to be smooth: leaves and edges scatter by themselves."""

LEAST_GROUPS = 100
OF_NORMAL = 0.6745 * 6.0**0.5
"""Median size of second differences of normal numbers, in their standard deviations."""

NOISE = Question(
    "ranges.noise",
    "neighbouring ranges scatter no more than those of a lidar",
    (
        FaultKind(
            "range_noise",
            "ranges scatter more than those of any lidar",
            (anywhere(*BY_SCANS, "time_offset_wheels", "time_offset_imu"),),
        ),
    ),
    limit=1e3 * MOST_M,
    unit="mm",
    consequence="walls are as thick as the scatter, and small motions are not seen",
    excitation_wanted="more readings of walls",
    limit_of_ok=False,
)


def check_noise(topic: str, sample: ScanSample) -> Finding:
    """The scatter in the smoothest part of what was seen."""
    ranges_m, scatter_m = _groups(sample.ranges_m.astype(np.float64))
    if scatter_m.size < LEAST_GROUPS:
        few = f"{scatter_m.size} groups of {NEIGHBOURS} neighbouring beams returned something"
        return unanswered(NOISE, topic, f"{few}; what would tell: {NOISE.excitation_wanted}")
    usual_m = float(np.quantile(scatter_m, SMOOTHEST))
    limit_m = max(MOST_M, MOST_SHARE * float(np.median(ranges_m)))
    return judge(
        NOISE,
        topic,
        f"neighbouring beams scatter by {1e3 * usual_m:.3g} mm in the smoothest quarter of the "
        "scene (standard deviation)",
        Measurement(1e3 * usual_m, 0.0, "mm"),
        limit=1e3 * limit_m,
        advice="Look at a scan of a plain wall; clean the window, or have the lidar repaired.",
        fault_plots=(_plot(ranges_m, scatter_m, limit_m),),
    )


def _groups(ranges_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(k,) median range and (k,) scatter of each group of neighbouring beams that all returned."""
    beams = ranges_m.shape[1] // NEIGHBOURS * NEIGHBOURS
    groups = ranges_m[:, :beams].reshape(-1, NEIGHBOURS)
    groups = groups[np.isfinite(groups).all(axis=1) & (groups > 0.0).all(axis=1)]
    bent_m = np.median(np.abs(np.diff(groups, 2, axis=1)), axis=1)
    return np.median(groups, axis=1), bent_m / OF_NORMAL


def _plot(ranges_m: FloatArray, scatter_m: FloatArray, limit_m: float) -> Plot:
    shown = np.linspace(0, ranges_m.size - 1, min(ranges_m.size, 2000)).astype(np.int64)
    curve = Curve("groups of neighbouring beams", ranges_m[shown], scatter_m[shown])
    title = "Scatter of neighbouring beams by range"
    return Plot(title, "range (m)", "scatter (m)", (curve,), (limit_m,))
