"""Parts of the check, asked without the diagnosis that comes after them."""

from __future__ import annotations

from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding
from slamsim.check.registry import registry
from slamsim.recording import Recording


def motion_findings(recording: Recording) -> list[Finding]:
    """All that compares scans, gyroscope and wheels with one another; raises what it raises."""
    evidence = RecordingEvidence(recording)
    groups = [group for group in registry().groups if group.thorough]
    return [finding for group in groups for finding in group.ask(evidence)]
