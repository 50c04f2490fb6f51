"""``slamsim fault``: a copy of a recording with known faults injected."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from slamsim.config.faults import FaultChoice
from slamsim.guard.output import partial_folder
from slamsim.io.cameras.survey import with_cameras
from slamsim.io.copy.recording import copy_recording, require_lossless
from slamsim.io.copy.rewrite import Copied
from slamsim.io.open import read_recording
from slamsim.io.selection import EVERYTHING, Selection
from slamsim.run.naming import log_of
from slamsim.sensors.faults.apply import injected
from slamsim.sensors.faults.base import Fault
from slamsim.sensors.faults.cameras import CameraFault
from slamsim.sensors.faults.registry import bundled_faults, chosen_fault


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
