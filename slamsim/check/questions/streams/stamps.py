"""The stamps of every stream by themselves."""

from __future__ import annotations

import numpy as np

from slamsim.check.findings import Curve, Estimate, Finding, Mend, Plot
from slamsim.check.questions.streams.epochs import check_epochs
from slamsim.check.questions.streams.receipt import check_receipt
from slamsim.check.questions.streams.series import StampSeries, series_of
from slamsim.check.questions.streams.spacing import check_spacing
from slamsim.recording import Recording

MAX_OVERLAP = 0.02
"""Of the scan's duration. Drivers that declare the nominal speed of their motor are off by less."""
MIN_OVERLAP_S = 1e-4
_NO_INSTANTS = ("epoch_mismatch", "stamps_quantised", "stamps_repeated")
"""Stamps so wrong that how long they are before the receipt says nothing more."""


def check_streams(recording: Recording) -> list[Finding]:
    """Order, repeats, rounding, scatter and gaps of stamps, and how they fit their receipt."""
    series = series_of(recording)
    if not series:
        words = "the recording holds no stream with stamps"
        return [Finding("time.order", recording.name, "cannot tell", words)]
    epochs = check_epochs(series)
    findings = [*epochs]
    for stream in series:
        findings += check_spacing(stream)
        if stream.kind == "lidar":
            findings.append(_overlap(stream))
    wrong = {finding.subject for finding in findings if finding.fault in _NO_INSTANTS}
    return findings + check_receipt(series, wrong)


def _overlap(series: StampSeries) -> Finding:
    """One lidar begins a scan only when it has ended the one before."""
    steps_s = series.ordered_steps_s
    if not steps_s.size:
        words = "there are not two scans of different stamps"
        return Finding("time.overlap", series.subject, "cannot tell", words)
    lasts_s, step_s = float(np.median(series.lasts_ns)) * 1e-9, series.period_s
    overlap_s = lasts_s - step_s
    estimate = Estimate(1e3 * max(overlap_s, 0.0), 0.0, "ms")
    limit_s = max(MIN_OVERLAP_S, MAX_OVERLAP * lasts_s)
    words = f"a scan lasts {1e3 * lasts_s:.4g} ms as declared, the next begins after "
    words += f"{1e3 * step_s:.4g} ms"
    if overlap_s <= limit_s:
        limit = 1e3 * limit_s
        return Finding("time.overlap", series.subject, "ok", words, None, "", estimate, limit)
    curve = Curve("from one scan to the next", series.since_first_s[1:], series.steps_s)
    return Finding(
        "time.overlap",
        series.subject,
        "bad",
        words,
        "scans_overlap",
        "Declare the time_increment that the lidar really has: at most the period over the "
        "number of beams of a full turn.",
        estimate,
        1e3 * limit_s,
        (Mend("scale_beam_times", series.subject, {"factor": step_s / lasts_s}),),
        (Plot("Scans against their duration", "stamp (s)", "step (s)", (curve,), (lasts_s,)),),
    )
