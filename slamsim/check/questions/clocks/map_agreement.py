"""Offsets between clocks, compared with the map: one that the map contradicts is inconclusive."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding
from slamsim.check.map_quality.crispness import Crispness, Stream, crispness
from slamsim.check.question import QuestionGroup
from slamsim.check.questions.clocks.offsets import CULPRITS, DRIFT, PAIRS, STEADY, check_timing

STREAM_OF: dict[str, Stream] = {
    "time.offset.lidar_imu": "gyro",
    "time.offset.imu": "gyro",
    "time.offset.lidar_wheels": "wheel",
    "time.offset.wheels": "wheel",
}
LIDAR = "time.offset.lidar"
"""Both streams are compared with it: the offset with the smaller sigma counts."""


def with_map(findings: Sequence[Finding], crispness: Mapping[Stream, Crispness]) -> list[Finding]:
    """The findings of ``check_timing`` with what the map says of them, by stream."""
    return [_compared(finding, crispness) for finding in findings]


def _compared(finding: Finding, crispness: Mapping[Stream, Crispness]) -> Finding:
    of_lidar = finding.check == LIDAR
    asked = STREAM_OF.get(finding.check)
    told = [one for stream, one in crispness.items() if of_lidar or stream == asked]
    found = min(told, key=lambda one: one.fitted_s[1], default=None)
    if found is None:
        return finding
    plots = (*finding.plots, found.plot(-1.0 if of_lidar else 1.0))
    if not found.objection:
        words = f"{finding.words}; {found.support}" if found.support else finding.words
        return replace(finding, words=words, plots=plots)
    return replace(
        finding.inconclusive(f"but {found.objection}: one of both is misled"), plots=plots
    )


def _checked_with_map(evidence: RecordingEvidence) -> list[Finding]:
    """``check_timing``, and what the map says of each offset."""
    calibration, unit = evidence.calibration, evidence.wrong_unit
    if calibration is None:
        return []
    recorded = evidence.as_recorded
    placed = recorded if unit is not None and unit.side == "ranges" else calibration
    assert placed is not None
    found = crispness(evidence.recording, evidence.motions, placed)
    return with_map(check_timing(calibration), found)


GROUP = QuestionGroup(
    "motion",
    150,
    (STEADY, *PAIRS.values(), *CULPRITS.values(), DRIFT),
    _checked_with_map,
    thorough=True,
)
