"""The stamps of every stream by themselves."""

from __future__ import annotations

from slamsim.check.findings import Finding
from slamsim.recording import Recording


def check_streams(recording: Recording) -> list[Finding]:
    """Order, rate, gaps, repeats and rounding of stamps, and how they fit the times of receipt."""
    return []
