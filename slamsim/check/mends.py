"""What ``slamsim fix`` can do: one function for each operation that findings propose."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from difflib import get_close_matches

from slamsim.check import mend_frames, mend_imu, mend_scans, mend_stamps, mend_values, mend_wheels
from slamsim.check.findings import CheckReport, Mend
from slamsim.guard.errors import SlamsimError, shown
from slamsim.recording import Recording

Operation = Callable[[Recording, Mend], Recording]

OPERATIONS: dict[str, Operation] = {
    "reorder": mend_stamps.reorder,
    "shift_stamps": mend_stamps.shift_stamps,
    "rescale_stamps": mend_stamps.rescale_stamps,
    "restamp_evenly": mend_stamps.restamp_evenly,
    "stamp_by_receipt": mend_stamps.stamp_by_receipt,
    "shift_receipt": mend_stamps.shift_receipt,
    "zero_to_inf": mend_scans.zero_to_inf,
    "value_to_inf": mend_scans.value_to_inf,
    "scale_ranges": mend_scans.scale_ranges,
    "add_to_ranges": mend_scans.add_to_ranges,
    "drop_beams": mend_scans.drop_beams,
    "drop_stray_beams": mend_scans.drop_stray_beams,
    "drop_repeated_scans": mend_scans.drop_repeated_scans,
    "set_angle_max": mend_scans.set_angle_max,
    "set_range_limits": mend_scans.set_range_limits,
    "scale_angles": mend_scans.scale_angles,
    "angles_to_radians": mend_scans.angles_to_radians,
    "negate_angles": mend_scans.negate_angles,
    "scale_beam_times": mend_scans.scale_beam_times,
    "set_sweep": mend_scans.set_sweep,
    "turn_with_robot": mend_scans.turn_with_robot,
    "scale_acceleration": mend_imu.scale_acceleration,
    "rotate_imu": mend_imu.rotate_imu,
    "scale_gyro": mend_imu.scale_gyro,
    "subtract_gyro_bias": mend_imu.subtract_gyro_bias,
    "normalise_rotations": mend_values.normalise_rotations,
    "drop_broken_poses": mend_values.drop_broken_poses,
    "drop_broken_readings": mend_values.drop_broken_readings,
    "drop_orientation": mend_values.drop_orientation,
    "scale_wheels": mend_wheels.scale_wheels,
    "scale_lengths": mend_wheels.scale_lengths,
    "swap_wheels": mend_wheels.swap_wheels,
    "reverse_wheel": mend_wheels.reverse_wheel,
    "unwrap_ticks": mend_wheels.unwrap_ticks,
    "odometry_from_ticks": mend_wheels.odometry_from_ticks,
    "scale_odometry": mend_wheels.scale_odometry,
    "remove_odometry_jumps": mend_wheels.remove_odometry_jumps,
    "add_odometry_transform": mend_frames.add_odometry_transform,
    "drop_transform": mend_frames.drop_transform,
    "freeze_static_transform": mend_frames.freeze_static_transform,
    "rename_frame": mend_frames.rename_frame,
    "roll_frame": mend_frames.roll_frame,
    "set_mounting": mend_frames.set_mounting,
}
"""Each takes a recording and a mend, and gives the recording mended."""


_EVIDENT = frozenset(
    (
        "reorder",
        "restamp_evenly",
        "stamp_by_receipt",
        "drop_repeated_scans",
        "drop_beams",
        "zero_to_inf",
        "value_to_inf",
        "scale_ranges",
        "angles_to_radians",
        "set_angle_max",
        "set_range_limits",
        "rename_frame",
        "drop_transform",
        "freeze_static_transform",
        "scale_acceleration",
        "unwrap_ticks",
        "normalise_rotations",
        "drop_broken_poses",
        "drop_broken_readings",
        "drop_orientation",
    )
)
"""What a stream shows by itself is mended before what streams say of each other."""
_DOUBTFUL = frozenset(("shift_receipt",))
"""Mended last: the stamps, not the receipt, may be what is wrong."""
_OTHER_EPOCH_S = 60.0


def proposed(report: CheckReport) -> tuple[Mend, ...]:
    """What the bad findings propose, in their order."""
    return tuple(mend for finding in report.bad for mend in finding.mends)


def chosen(mends: Sequence[Mend], names: str) -> tuple[Mend, ...]:
    """Those that ``all`` or a list of operations or of faults separated by commas means.

    Raises SlamsimError for a name that is no operation.
    """
    if names == "all":
        return tuple(mends)
    wanted = {name.strip() for name in names.split(",") if name.strip()}
    for name in sorted(wanted):
        if name not in OPERATIONS:
            raise SlamsimError(_unknown(name, mends))
    return tuple(mend for mend in mends if mend.operation in wanted)


def next_mends(mends: Sequence[Mend]) -> tuple[Mend, ...]:
    """Those to be applied before the check is asked again: what is evident comes first."""
    ranks = [_rank(mend) for mend in mends]
    first = min(ranks, default=0)
    return tuple(mend for mend, rank in zip(mends, ranks, strict=True) if rank == first)


def _rank(mend: Mend) -> int:
    if mend.operation in _DOUBTFUL:
        return 2
    shifted_s = mend.parameters.get("offset_s", 0.0) if mend.operation == "shift_stamps" else 0.0
    return 0 if mend.operation in _EVIDENT or abs(float(shifted_s)) > _OTHER_EPOCH_S else 1


def apply_mends(recording: Recording, mends: Iterable[Mend]) -> Recording:
    """The recording with every mend applied, one after the other.

    Of several mends with one operation on one subject the last counts, for later questions
    know more; a clock's mend reaches all streams on that clock, once. Raises SlamsimError for
    an operation or subject that is not there.
    """
    for mend in _without_rivals(recording, mends):
        if mend.operation not in OPERATIONS:
            raise SlamsimError(_unknown(mend.operation, ()))
        recording = OPERATIONS[mend.operation](recording, mend)
    return recording


def _without_rivals(recording: Recording, mends: Iterable[Mend]) -> list[Mend]:
    kept: list[Mend] = []
    covered: set[tuple[str, str, str]] = set()
    for mend in reversed(list(mends)):
        detail = str(mend.parameters) if mend.operation in mend_scans.PER_BEAM else ""
        subjects = {mend.subject}
        if mend.operation in mend_stamps.CLOCKS:
            subjects |= mend_stamps.on_clock_of(recording, mend.subject)
        if (mend.operation, mend.subject, detail) not in covered:
            kept.append(mend)
        covered |= {(mend.operation, subject, detail) for subject in subjects}
    return kept[::-1]


def _unknown(name: str, mends: Sequence[Mend]) -> str:
    near = get_close_matches(name, OPERATIONS, 1, 0.4)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    here = ", ".join(dict.fromkeys(mend.operation for mend in mends))
    offer = f" The check proposes: {here}." if here else ""
    return f"{shown(name)} is no mend{hint}{offer}"
