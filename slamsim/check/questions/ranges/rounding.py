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
from slamsim.slam.matching.range_noise import COARSE_STEP_M, rounding_step_m

ROUNDING = Question(
    "ranges.rounding",
    "ranges are written more finely than a map's cells",
    (
        FaultKind(
            "ranges_coarse",
            "ranges are rounded to large steps",
            (
                same_subject("scan_stuck", "beams_constant", "beams_lost", "range_noise"),
                anywhere(*BY_SCANS, "time_offset_wheels", "time_offset_imu", "scans_overlap"),
            ),
        ),
    ),
    limit=1e3 * COARSE_STEP_M,
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


def _plot(readings_m: FloatArray) -> Plot:
    values, counts = np.unique(np.round(readings_m, 3), return_counts=True)
    curve = Curve("readings", values, counts.astype(np.float64))
    return Plot("How often each range is read", "range (m)", "readings", (curve,))
