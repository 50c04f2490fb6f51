"""What ``slamsim fix`` makes of recordings whose clean counterpart is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

from slamsim.bench.check.outcome import Json
from slamsim.check.check import check_recording
from slamsim.check.findings import CheckReport
from slamsim.check.map_quality.beam_ends import TOLERANCE, TOLERANCE_M, beam_ends
from slamsim.check.repairing import restored
from slamsim.io.open import read_recording
from slamsim.recording import Recording

RESTORED = 1.2
"""A recording is restored if scans are apart by no more than so many times what they are when
nothing is wrong."""


def repaired(
    generator: Any, case: Any, seconds: float, recording: Recording, report: CheckReport
) -> Json:
    """Figures of the repair of the recording of a case. report: the check of it."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "clean"
        generator.make(replace(case, sort="clean", faults=()), path, seconds)
        clean = beam_ends(read_recording(path))
    found = restored(
        recording, "all", lambda one: report if one is recording else check_recording(one)
    )
    before_m, after_m, clean_m = (one.mean_m for one in (found.before, found.after, clean))
    placed = before_m is not None and after_m is not None
    # Scans that repeat lie on each other all too well: what is as good as clean is not worse.
    least_m = None if before_m is None else max(before_m, clean_m or 0.0)
    allowed_m = None if least_m is None else (1.0 + TOLERANCE) * least_m + TOLERANCE_M
    return {
        "applied": [asdict(one) for one in found.applied],
        "taken_back": [asdict(one) for one in found.taken_back],
        "left": [f"{one.fault} {one.subject}: {one.words}" for one in found.report.faults],
        "beam_end_error_m": {"before": before_m, "after": after_m, "clean": clean_m},
        "worse": bool(placed and cast(float, after_m) > cast(float, allowed_m)),
        "restored": bool(clean_m and after_m is not None and after_m <= RESTORED * clean_m),
    }


def summarise_repaired(rows: Sequence[Json]) -> Json:
    """Of rows with the figures above: how many have been tried to repair, how many are worse, which
    share is restored, and which are not."""
    tried = [(str(row["case"]), cast(Json, row["fix"])) for row in rows if "fix" in row]
    tried = [(name, one) for name, one in tried if one["applied"] or one["taken_back"]]
    done = [bool(one["restored"]) for _, one in tried]
    return {
        "fixed": len(tried),
        "fix_worse": sum(bool(one["worse"]) for _, one in tried),
        "fix_restored_share": sum(done) / len(done) if done else None,
        "fix_missed": [name for name, one in tried if not one["restored"]],
    }


def fixed_words(figures: Json) -> str:
    """The same for a person."""
    if not figures["fixed"]:
        return "none"
    share = 100.0 * cast(float, figures["fix_restored_share"])
    worse = figures["fix_worse"]
    return f"{figures['fixed']}, {share:.1f} % as good as clean ones, {worse} worse than before"
