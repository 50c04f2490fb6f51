"""``slamsim fix``: a recording in, a corrected copy out; ``slamsim fault``: a copy with known
faults injected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

from slamsim.check.findings import CheckReport
from slamsim.check.repairing import Restored, TakenBack, restored
from slamsim.check.wording import as_json
from slamsim.config.faults import FaultChoice
from slamsim.console.reporter import Reporter
from slamsim.console.summary import labelled
from slamsim.guard.errors import SlamsimError
from slamsim.guard.output import partial_folder
from slamsim.io.cameras.survey import with_cameras
from slamsim.io.copy.recording import copy_recording, require_lossless
from slamsim.io.copy.rewrite import Copied
from slamsim.io.open import read_recording
from slamsim.io.selection import EVERYTHING, Selection
from slamsim.recording import Recording
from slamsim.recording.choice import choices, in_words
from slamsim.recording.repairs.apply import NONE
from slamsim.run.checking import check_stage, show_verdicts
from slamsim.run.naming import log_of, recording_name
from slamsim.run.stages import Stages
from slamsim.sensors.faults.base import Fault
from slamsim.sensors.faults.cameras import CameraFault
from slamsim.sensors.faults.registry import bundled_faults, chosen_fault, injected


def fix_log(
    source: Path,
    folder: Path,
    names: str,
    reporter: Reporter,
    *,
    wanted: Selection = EVERYTHING,
    lossy: bool = False,
    overwrite: bool = False,
) -> CheckReport:
    """Check, repair, check again until nothing gets better, write; the last report.

    names: ``all``, the operations to apply, or ``none`` for a plain copy. Raises SlamsimError for
    other names, and when the check proposes none of them; Lossy for what the copy could not hold,
    unless lossy is set.
    """
    stages = Stages(reporter)
    path = log_of(source)
    if not lossy:
        require_lossless(path)
    with stages.stage("read"):
        recording = with_cameras(read_recording(path, wanted), path)
        recording = replace(recording, name=recording_name(str(source)))
    reporter.note(in_words(choices(recording)))
    with partial_folder(folder, overwrite) as partial:
        fixed = _fixed(recording, names, stages)
        with stages.stage("write"):
            copied = copy_recording(path, recording, fixed.recording, partial)
    _show(reporter, fixed)
    for sentence in copied.sentences():
        reporter.say(sentence)
    told = {
        "applied": [asdict(repair) for repair in fixed.applied],
        "taken_back": [asdict(one) for one in fixed.taken_back],
        "beam_end_error_m": {"before": fixed.before.mean_m, "after": fixed.after.mean_m},
        "copied": asdict(copied),
    }
    reporter.result({**as_json(fixed.report), **told, "folder": str(folder)})
    return fixed.report


def _fixed(recording: Recording, names: str, stages: Stages) -> Restored:
    """Raises SlamsimError where nothing is to be done, or nothing made it better."""
    fixed = restored(recording, names, lambda one: check_stage(one, stages))
    if not fixed.applied and names != NONE:
        raise SlamsimError(_nothing_to_do(fixed, names))
    return fixed


def _nothing_to_do(fixed: Restored, names: str) -> str:
    name, report = fixed.recording.name, fixed.report
    if fixed.taken_back:
        return f"{name}: nothing was fixed; {'; '.join(map(_taken_back, fixed.taken_back))}"
    there = ", ".join(dict.fromkeys(repair.operation for repair in report.repairs))
    if there:
        return f"{name}: the check does not propose {names}, but {there}"
    kind = "no repair is known for its faults" if report.faults else "no fault was found"
    return f"{name}: there is nothing to fix, {kind}"


def _taken_back(one: TakenBack) -> str:
    return f"{one.repair.operation} of {one.repair.subject} taken back: {one.reason}"


def _show(reporter: Reporter, fixed: Restored) -> None:
    for repair in fixed.applied:
        told = labelled(dict(repair.parameters))
        numbers = ", ".join(f"{name} {value}" for name, value in told.items())
        reporter.say(
            f"Applied {repair.operation} to {repair.subject}{': ' if numbers else ''}{numbers}"
        )
    for one in fixed.taken_back:
        reporter.say(_taken_back(one))
    before_m, after_m = fixed.before.mean_m, fixed.after.mean_m
    if fixed.applied and before_m is not None and after_m is not None:
        reporter.say(
            "Placed by what is recorded, scans of a few seconds are "
            f"{1e3 * before_m:.1f} mm apart before, {1e3 * after_m:.1f} mm after"
        )
    show_verdicts(reporter, fixed.recording, fixed.report)


def inject_faults(
    source: Path,
    folder: Path,
    choices: Sequence[FaultChoice],
    *,
    seed: int = 0,
    wanted: Selection = EVERYTHING,
    lossy: bool = False,
    overwrite: bool = False,
) -> tuple[tuple[Fault, ...], Copied]:
    """Write the recording with these faults into the folder, and say what became of the rest.

    Raises SlamsimError where the recording has nothing that could be corrupted so; Lossy for what
    the copy could not hold, unless lossy is set.
    """
    faults = tuple(map(chosen_fault, choices))
    path = log_of(source)
    if not lossy:
        require_lossless(path)
    recording = read_recording(path, wanted)
    if any(isinstance(fault, CameraFault) for fault in faults):
        recording = with_cameras(recording, path)
    corrupted = injected(recording, faults, seed)
    with partial_folder(folder, overwrite) as partial:
        copied = copy_recording(path, recording, corrupted, partial)
    return faults, copied


def fault_table() -> dict[str, str]:
    """Name and meaning of every fault that comes with the package, with its harmful size."""
    return {fault.name: f"{fault.title}{_sized(fault)}" for fault in bundled_faults()}


def fault_facts() -> list[dict[str, object]]:
    """The same with all that is known of each."""
    return [fault.model_dump(mode="json") for fault in bundled_faults()]


def _sized(fault: Fault) -> str:
    return "" if fault.size is None else f" ({fault.SIZE} {fault.size:g})"
