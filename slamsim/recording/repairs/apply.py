"""The table of repairs that ``slamsim fix`` can apply."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from inspect import isfunction, signature
from math import inf, log

from slamsim.guard.errors import SlamsimError, did_you_mean, shown
from slamsim.recording import Recording
from slamsim.recording.edits.stamps import clock_of
from slamsim.recording.repairs import cameras, frames, readings, scans, stamps, wheels
from slamsim.recording.repairs.base import Declaration, Repair

_TAKEN = ["recording", "repair"]
OPERATIONS: Mapping[str, Declaration] = {
    name: found
    for module in (stamps, scans, readings, wheels, frames, cameras)
    for name, found in vars(module).items()
    if isfunction(found) and name[0] != "_" and [*signature(found).parameters] == _TAKEN
}
"""The public functions of these modules that take a recording and a repair, by name; each gives the
edit for what is asked of a recording."""

PER_BEAM = ("drop_beams", "value_to_inf")
"""Operations that may come several times on one subject, with other numbers."""
ABSOLUTE = (
    *("set_mounting", "set_range_limits", "set_sweep", "rename_frame", "undo_clock_step"),
    *("set_readout", "set_height"),
)
"""Operations that declare a number anew, whatever it was, or do something elsewhere each time."""
VARIANTS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "scale_angles": ("pivot", scans.PIVOTS),
    "negate_angles": ("about", scans.AXES),
}
"""Which parameter, with which values, a finding leaves open, the usual one first: scans that fit
each other do so whatever way all their rays are turned as a whole."""
CLOCKS = ("shift_stamps", "rescale_stamps", "undo_clock_step", "restamp_evenly", "reorder")
"""Operations that a clock needs, and so all streams that are stamped together."""

_EVIDENT = frozenset(
    (
        "reorder",
        "undo_clock_step",
        "restamp_evenly",
        "stamp_by_receipt",
        "drop_copies",
        "drop_repeated_scans",
        "drop_beams",
        "zero_to_inf",
        "value_to_inf",
        "scale_ranges",
        "angles_to_radians",
        "set_angle_max",
        "set_range_limits",
        "set_scan_time",
        "rename_frame",
        "rename_child_frame",
        "reorder_quaternions",
        "invert_transform",
        "scale_heading",
        "twist_from_poses",
        "drop_transform",
        "freeze_static_transform",
        "scale_acceleration",
        "set_camera_size",
        "drop_repeated_images",
        "drop_damaged_images",
        "exchange_images",
        "unwrap_ticks",
        "normalise_rotations",
        "drop_broken_poses",
        "drop_broken_readings",
        "drop_orientation",
    )
)
"""What a stream shows by itself is repaired before what streams say of each other."""
_DOUBTFUL = frozenset(("shift_receipt",))
"""Repaired last: the stamps, not the receipt, may be what is wrong."""
_OTHER_EPOCH_S = 60.0
"""A shift that is longer brings a stream to the clock of the others: before it, nothing else can be
judged."""
NONE = "none"


def chosen(repairs: Sequence[Repair], names: str) -> tuple[Repair, ...]:
    """Those that ``all``, ``none`` or a list of operations separated by commas means.

    Raises SlamsimError for a name that is no operation.
    """
    if names in ("all", NONE):
        return tuple(repairs) if names == "all" else ()
    wanted = {name.strip() for name in names.split(",") if name.strip()}
    for name in sorted(wanted):
        if name not in OPERATIONS:
            raise SlamsimError(_unknown(name, repairs))
    return tuple(repair for repair in repairs if repair.operation in wanted)


def next_repairs(repairs: Sequence[Repair]) -> tuple[Repair, ...]:
    """Those to be applied before the check is asked again: what is evident comes first."""
    ranks = [_rank(repair) for repair in repairs]
    first = min(ranks, default=0)
    return tuple(repair for repair, rank in zip(repairs, ranks, strict=True) if rank == first)


def _rank(repair: Repair) -> int:
    if repair.operation in _DOUBTFUL:
        return 2
    if repair.operation == "shift_stamps":
        shifted_s = float(repair.parameters.get("offset_s", 0.0))
        return 0 if abs(shifted_s) > _OTHER_EPOCH_S else 1
    return 0 if repair.operation in _EVIDENT else 1


def apply_repairs(recording: Recording, repairs: Iterable[Repair]) -> Recording:
    """The recording with every repair applied, one after the other, but for ``without_rivals``.

    Raises SlamsimError for an operation or subject that is not there.
    """
    for repair in without_rivals(recording, repairs):
        recording = apply_repair(recording, repair)
    return recording


def apply_repair(recording: Recording, repair: Repair) -> Recording:
    """The recording with one repair. Raises as ``apply_repairs`` does."""
    if repair.operation not in OPERATIONS:
        raise SlamsimError(_unknown(repair.operation, ()))
    return OPERATIONS[repair.operation](recording, repair).apply(recording)


def variants(repair: Repair) -> tuple[Repair, ...]:
    """The ways in which it can be applied, the usual one first."""
    if repair.operation not in VARIANTS:
        return (repair,)
    name, values = VARIANTS[repair.operation]
    return tuple(replace(repair, parameters={**repair.parameters, name: value}) for value in values)


def without_rivals(recording: Recording, repairs: Iterable[Repair]) -> list[Repair]:
    """Of several repairs with one operation on one subject the last, for later questions know
    more; a clock's repair reaches all streams on that clock, once."""
    last: list[Repair] = []
    covered: set[tuple[str, ...]] = set()
    for repair in reversed(list(repairs)):
        subjects = frozenset({repair.subject})
        if repair.operation in CLOCKS:
            subjects = clock_of(recording, repair.subject).subjects or subjects
        if target_of(repair) not in covered:
            last.append(repair)
        covered |= {target_of(replace(repair, subject=subject)) for subject in subjects}
    return last[::-1]


def target_of(repair: Repair) -> tuple[str, ...]:
    """What no two repairs share that are to be applied together."""
    detail = str(repair.parameters) if repair.operation in PER_BEAM else ""
    return repair.operation, repair.subject, detail


def repeats(repair: Repair, earlier: Repair, shrinking: float) -> bool:
    """Whether it changes again what an earlier one of its target changed, or back, by no less than
    the share ``shrinking`` of it. Operations without a number are made once."""
    if target_of(repair) != target_of(earlier):
        return False
    if repair.operation in ABSOLUTE:
        return repair.parameters == earlier.parameters
    return not _size(repair) < shrinking * _size(earlier)


def _size(repair: Repair) -> float:
    """How far from nothing its numbers are: logarithms of factors, and what is added."""
    sizes = [0.0]
    for name, value in repair.parameters.items():
        if not isinstance(value, str):
            sizes.append(_log(value) if name.endswith("factor") else abs(value))
    return sum(sizes)


def _log(factor: float) -> float:
    return abs(log(factor)) if factor > 0.0 else inf


def _unknown(name: str, repairs: Sequence[Repair]) -> str:
    hint = did_you_mean(name, OPERATIONS, 0.4)
    here = ", ".join(dict.fromkeys(repair.operation for repair in repairs))
    offer = f" The check proposes: {here}." if here else ""
    return f"{shown(name)} is not a repair{hint}{offer}"
