"""Are ranges written finely enough? The step of which all readings are multiples."""

from __future__ import annotations

import numpy as np

from slamsim.check.fault_groups import BY_SCANS
from slamsim.check.findings import Curve, Finding, Measurement, Plot
from slamsim.check.question import (
    FaultKind,
    Question,
    anywhere,
    judge,
    same_subject,
    unanswered,
)
from slamsim.check.scan_sample import ScanSample, positive
from slamsim.core.types import FloatArray

MAX_STEP_M = 0.05
"""A usual cell of a map: rounding moves walls into the next one. Lidars read in steps of 1 mm to
1 cm (SICK LMS 200)."""

LEAST_VALUES, LEAST_EACH = 5, 10
"""So many different readings, each so often on average, show that they are steps."""

SAME_M = 1e-4
"""Multiples written as floats are no farther off; no lidar reads in such small steps."""

USUAL_STEP = 0.1
"""Quantile of the distances between neighbouring values: some values do not occur."""

MULTIPLES, OFF_SHARE = 0.99, 0.02
"""Such a share of the distances are whole steps, but for this share of one."""

ROUNDING = Question(
    "ranges.rounding",
    "ranges are written more finely than a map's cells",
    (
        FaultKind(
            "ranges_coarse",
            "ranges are rounded to large steps",
            (
                same_subject("scan_stuck", "beams_constant", "beams_lost"),
                anywhere(*BY_SCANS, "time_offset_wheels", "time_offset_imu", "scans_overlap"),
            ),
        ),
    ),
    limit=1e3 * MAX_STEP_M,
    unit="mm",
    consequence="walls are as thick as a step, and small motions are not seen",
    excitation_wanted="more readings, of more places",
    limit_of_ok=False,
)


def check_rounding(topic: str, sample: ScanSample) -> Finding:
    """The step between readings; of readings that keep none nothing is said but that."""
    readings = positive(sample)
    step_m = rounding_step_m(readings)
    if step_m is None:
        few = f"{readings.size} readings do not show whether they keep a common step"
        return unanswered(ROUNDING, topic, f"{few}; what would tell: {ROUNDING.excitation_wanted}")
    words = "readings keep no common step" if step_m == 0.0 else _words(step_m)
    return judge(
        ROUNDING,
        topic,
        words,
        Measurement(1e3 * step_m, 0.0, "mm"),
        advice="Publish ranges as the lidar measures them, in metres as floating-point numbers.",
        fault_plots=(_plot(readings),),
    )


def _words(step_m: float) -> str:
    return f"readings are {1e3 * step_m:.3g} mm or a multiple of that apart"


def rounding_step_m(readings_m: FloatArray) -> float | None:
    """The step of which readings (n,) are multiples, but for a constant; 0 if none is evident, None
    if so few readings would not show one."""
    written = np.unique(np.round(readings_m / SAME_M))
    if written.size < LEAST_VALUES:
        return None
    values = written[np.diff(written, prepend=-np.inf) > 1.5]
    if values.size < LEAST_VALUES:
        return 0.0
    apart = np.diff(values)
    step = float(np.quantile(apart, USUAL_STEP))
    if readings_m.size < LEAST_EACH * values.size:
        return 0.0 if step * SAME_M <= MAX_STEP_M else None
    off = np.abs(apart / step - np.round(apart / step))
    return step * SAME_M if float(np.mean(off < OFF_SHARE)) >= MULTIPLES else 0.0


def _plot(readings_m: FloatArray) -> Plot:
    values, counts = np.unique(np.round(readings_m, 3), return_counts=True)
    curve = Curve("readings", values, counts.astype(np.float64))
    return Plot("How often each range is read", "range (m)", "readings", (curve,))
