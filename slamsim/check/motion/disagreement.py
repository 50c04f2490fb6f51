"""Compares two publishers of the motion of one body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.check.findings import Curve, Finding, Measurement, Plot
from slamsim.check.motion.planar_track import planar_track, track_at
from slamsim.check.question import Question, judge
from slamsim.core.geometry import between, wrap_angle
from slamsim.core.types import BoolArray, FloatArray, IntArray
from slamsim.recording import RawOdometry, TransformEdge
from slamsim.recording.repairs.base import Repair

LIMIT_M = 0.1
LIMIT_RAD = 0.06
"""Over four seconds of driving: more than two publishers differ by whose stamps are a few
milliseconds apart."""

IN_COMMON = "four seconds in common"
MAX_COVER_GAP_NS = 500_000_000
"""Interpolating a pose over more than half a second no longer says where a robot was."""

_COMPARED_NS = 4_000_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Disagreement:
    """(n,) by how much motions over four seconds differ, and when they begin."""

    elapsed_s: FloatArray
    off_m: FloatArray
    off_rad: FloatArray

    @property
    def usual(self) -> tuple[float, float]:
        """Metres and radians that are exceeded 5 % of the time."""
        return float(np.quantile(self.off_m, 0.95)), float(np.quantile(self.off_rad, 0.95))

    def judged(
        self, question: Question, subject: str, advice: str, repairs: tuple[Repair, ...] = ()
    ) -> Finding:
        """The answer to a question whether both tell one motion; its limit is ``LIMIT_M``."""
        at_m, at_rad = self.usual
        curve = Curve("difference over 4 s", self.elapsed_s, self.off_m, "line")
        return judge(
            question,
            subject,
            f"over four seconds of driving they differ by {1e3 * at_m:.3g} mm and "
            f"{np.degrees(at_rad):.3g} deg (95 % of the time less)",
            Measurement(at_m, 0.0, "m"),
            verdict="fault" if at_m > LIMIT_M or at_rad > LIMIT_RAD else "ok",
            advice=advice,
            repairs=repairs,
            fault_plots=(Plot(subject, "time (s)", "difference (m)", (curve,), (LIMIT_M,)),),
        )


def disagreement(one: RawOdometry, other: RawOdometry | TransformEdge) -> Disagreement | None:
    """At the stamps of the first; None without four seconds in common."""
    ours_ns, ours = planar_track(one.stamps_ns, one.positions_m, one.quats_xyzw)
    theirs_ns, theirs = planar_track(other.stamps_ns, other.positions_m, other.quats_xyzw)
    if ours_ns.size < 2 or theirs_ns.size < 2:
        return None
    there = [
        covered(ours_ns + later_ns, stamps_ns)
        for stamps_ns in (ours_ns, theirs_ns)
        for later_ns in (0, _COMPARED_NS)
    ]
    begin_ns = ours_ns[np.all(there, axis=0)]
    if begin_ns.size == 0:
        return None
    steps = [
        between(track_at(ns, poses, begin_ns), track_at(ns, poses, begin_ns + _COMPARED_NS))
        for ns, poses in ((ours_ns, ours), (theirs_ns, theirs))
    ]
    off = steps[0] - steps[1]
    seconds = (begin_ns - begin_ns[0]) * 1e-9
    return Disagreement(seconds, np.hypot(off[:, 0], off[:, 1]), np.abs(wrap_angle(off[:, 2])))


def covered(query_ns: IntArray, stamps_ns: IntArray) -> BoolArray:
    """(m,) whether sorted stamps (n,) lie near on both sides, or one just there."""
    right = np.searchsorted(stamps_ns, query_ns, side="left")
    exact = stamps_ns[np.minimum(right, stamps_ns.size - 1)] == query_ns
    inside = (right > 0) & (right < stamps_ns.size)
    gap_ns = stamps_ns[np.minimum(right, stamps_ns.size - 1)] - stamps_ns[np.maximum(right - 1, 0)]
    return np.asarray(exact | (inside & (gap_ns <= MAX_COVER_GAP_NS)))
