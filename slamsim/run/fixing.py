"""``slamsim fix``: a recording in, a corrected copy out."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

from slamsim.check.findings import CheckReport
from slamsim.check.wording import as_json
from slamsim.console.reporter import Reporter
from slamsim.guard.errors import SlamsimError
from slamsim.guard.output import partial_folder
from slamsim.io.copy.recording import copy_recording, require_lossless
from slamsim.io.open import read_recording
from slamsim.recording import Recording
from slamsim.recording.repairs.apply import apply_repairs, chosen, next_repairs
from slamsim.recording.repairs.base import Repair
from slamsim.run.checking import check_stage, show_verdicts
from slamsim.run.naming import log_of, recording_name
from slamsim.run.stages import Stages

NONE = "none"
_ROUNDS = 5
"""What one fault hides, such as a turned mounting behind wrong stamps, shows once it is fixed."""


def fix_log(
    source: Path,
    folder: Path,
    names: str,
    reporter: Reporter,
    *,
    scan_topic: str | None = None,
    lossy: bool = False,
    overwrite: bool = False,
) -> CheckReport:
    """Check, repair, check again until nothing more is to be repaired, write; the last report.

    names: ``all``, the operations to apply, or ``none`` for a plain copy. Raises SlamsimError for
    other names, and when the check proposes none of them; Lossy for what the copy could not hold,
    unless lossy is set.
    """
    stages = Stages(reporter)
    path = log_of(source)
    if not lossy:
        require_lossless(path)
    with stages.stage("read"):
        recording = replace(read_recording(path, scan_topic), name=recording_name(str(source)))
    with partial_folder(folder, overwrite) as partial:
        fixed, report, applied = _fixed(recording, names, stages)
        with stages.stage("write"):
            copied = copy_recording(path, recording, fixed, partial)
    _show(reporter, fixed, report, applied)
    for sentence in copied.sentences():
        reporter.say(sentence)
    reporter.say(f"Written to {folder}/")
    told = {"applied": [asdict(repair) for repair in applied], "copied": asdict(copied)}
    reporter.result({**as_json(report), **told, "folder": str(folder)})
    return report


def _fixed(
    recording: Recording, names: str, stages: Stages
) -> tuple[Recording, CheckReport, list[Repair]]:
    """(the repaired recording, the check of it, what was applied)."""
    applied: list[Repair] = []
    report = check_stage(recording, stages)
    for _ in range(_ROUNDS):
        repairs = () if names == NONE else next_repairs(chosen(report.repairs, names))
        if not repairs:
            break
        recording = apply_repairs(recording, repairs)
        applied += repairs
        report = check_stage(recording, stages)
    if not applied and names != NONE:
        raise SlamsimError(_nothing_to_do(recording, report, names))
    return recording, report, applied


def _nothing_to_do(recording: Recording, report: CheckReport, names: str) -> str:
    there = ", ".join(dict.fromkeys(repair.operation for repair in report.repairs))
    if there:
        return f"{recording.name}: the check does not propose {names}, but {there}"
    kind = "no repair is known for its faults" if report.faults else "no fault was found"
    return f"{recording.name}: there is nothing to fix, {kind}"


def _show(
    reporter: Reporter, recording: Recording, report: CheckReport, applied: list[Repair]
) -> None:
    for repair in applied:
        numbers = ", ".join(
            f"{name} {value:.6g}" if isinstance(value, float) else f"{name} {value}"
            for name, value in repair.parameters.items()
        )
        reporter.say(
            f"Applied {repair.operation} to {repair.subject}{': ' if numbers else ''}{numbers}"
        )
    show_verdicts(reporter, recording, report)
