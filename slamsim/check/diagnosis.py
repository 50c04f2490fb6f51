"""One fault, one name: what follows from another fault that was found is not reported as its own.

Every question is asked by itself, and one fault may make many go wrong. Where a fault explains
another (``FaultKind.explains``), what was found there becomes inconclusive, with the reason.
Faults that do not touch each other are both reported.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slamsim.check.fault_groups import LIDAR_TIMES, MOUNTING, SIZES
from slamsim.check.findings import SURE_SIGMAS, Finding, Measurement
from slamsim.check.registry import fault_meaning, registry

MOST_MOVED = {
    "rolling_scan_untimed": 2.0,
    "scans_overlap": 1.0,
    "stamps_quantised": 1.0,
    "stamps_jitter": 2.0,
}
"""An undeclared sweep, one that is too long, and stamps that are rounded or of publishing, move
instants by no more than so many times their length, or their scatter: delays of one sign are on
average no more than twice as long as they scatter."""

MOST_SIZED = 1.5
"""Per cent of a size of the wheels per millisecond by which their stamps scatter. Of 80 drives
with wheels at 10 to 50 Hz, stamped 5 to 50 ms late or early, the largest was 22 % at 24 ms; at up
to 15 ms it was 5 %."""

OFFSETS = (*LIDAR_TIMES, "time_offset_imu", "time_offset_wheels", "clock_step")

UNTIL_TURNS_AGREE = (*SIZES, "range_offset", "stamps_invented")
"""What scans of a wrong shape, or wheels of wrong sizes, make of everything else."""

COUNTED = "time.invented"
NO_CAUSE = "does_not_fit"
SLIP = "wheel_slip"
FITTED = (*MOUNTING, "wheel_radius", "wheel_track", "range_scale")
"""Sizes that are fitted to scans and wheels: what these still differ by is not theirs."""

NOT_FITTED = ("imu.spikes", "imu.gravity", "imu.orientation", "imu.heading", "camera.")
"""Questions about what takes no part in that fit: accelerations, and cameras."""

MOVES_NOTHING = "tf.slash"
"""A name that tf2 does not look up is still the frame that is meant: what was measured is right."""

LIDAR_QUESTIONS = ("laser.", "ranges.offset")

BY_OTHERS = (
    *("camera.yaw", "camera.x", "camera.y", "camera.depth_scale", "camera.focal"),
    *("camera.time_offset", "camera.turns", "camera.shutter"),
)
"""Questions about cameras that are answered by comparing them with other sensors."""

BESIDE_CAMERAS = ("clock.", "gyro.", "laser.", "odometry.", "ranges.", "tf.", "time.", "wheels.")

BY_DEPTHS = ("camera.yaw", "camera.x", "camera.y", "camera.depth_scale", "camera.focal")
"""Of these, those that compare depths with the scan nearest in time, as does the time offset of a
topic of depths."""

BY_FLOOR = ("camera.pitch", "camera.roll", "camera.z")
"""Those that only need to know which way is up in the claimed frame."""

UNFELT = ("wheel_radius", "wheel_track", "wheel_slip", "time_offset_imu")
MOST_UNFELT_MS = 100.0
"""Wheels that are somewhat wrong, or stamped by so much late, do not move what depths tell: they
carry an image to a scan a tenth of a second away at most, as often forward as back. The inertial
unit takes no part in it."""


def explained(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """The same findings, those that another fault explains now inconclusive."""
    findings = _without_drift_of_none(_without_contradicted(findings))
    findings = _without_cameras_beside(findings)
    findings = _without_known_cause(_without_misfit(findings))
    faults = [finding for finding in findings if finding.verdict == "fault"]
    lidars = {one.subject for one in findings if one.check.startswith(LIDAR_QUESTIONS)}
    return tuple(_with_cause(finding, faults, lidars) for finding in findings)


def _without_contradicted(findings: Sequence[Finding]) -> list[Finding]:
    """Where turns of scans and of all others differ, and scans do not fit each other well enough
    to know their angles, no size that rests on either is told. Nor where scans turn by another
    factor than all others: they are then matched in a wrong shape, and lengths come out as wrong as
    turns, and so does the angle between beams, whose fault is told by the turns alone. That stamps
    are counted is seen without any motion."""
    asked = {one.check: one for one in findings}
    rotation, step = asked.get("laser.rotation"), asked.get("laser.angle_step")
    unknown = all(
        one is not None and one.verdict == "inconclusive" and one.estimate is not None
        for one in (rotation, step)
    )
    by_turns = rotation is not None and rotation.fault == "laser_angle_step"
    if not unknown and not by_turns:
        return list(findings)
    reason = "cannot be told while the turns of the scans and of the others contradict each other"
    return [
        one.inconclusive(reason)
        if (one.fault in UNTIL_TURNS_AGREE and one.check != COUNTED)
        or (by_turns and one.fault and one.check == "laser.angle_step")
        else one
        for one in findings
    ]


def _without_drift_of_none(findings: Sequence[Finding]) -> list[Finding]:
    """A clock that keeps pace with the receiver's drifts by no more than that shows: where motion
    says otherwise, it is the motion of scans that are warped by as much as they turn."""
    paces = {
        one.subject: one.estimate
        for one in findings
        if one.check == "time.receipt_drift" and one.verdict == "ok" and one.estimate is not None
    }
    reason = "but its stamps keep pace with the receiver's clock"
    return [
        one.inconclusive(reason)
        if one.check == "time.drift" and one.fault and _apart(one.estimate, paces.get(one.subject))
        else one
        for one in findings
    ]


def _without_cameras_beside(findings: Sequence[Finding]) -> list[Finding]:
    """What cameras are measured with, scans, odometry and gyroscope, must itself be right."""
    others = [
        one
        for one in findings
        if one.fault and one.check.startswith(BESIDE_CAMERAS) and one.check != MOVES_NOTHING
    ]
    felt = [one for one in others if not _is_unfelt(one)]
    frames = [one for one in others if one.check.startswith("tf.")]
    depths = {one.subject for one in findings if one.check == "camera.depth_scale"}

    def wrong_beside(one: Finding) -> list[Finding]:
        if not one.fault:
            return []
        if one.check in BY_FLOOR:
            return frames
        if one.check in BY_DEPTHS or (one.check in BY_OTHERS and one.subject in depths):
            return felt
        return others if one.check in BY_OTHERS else []

    return [
        one.inconclusive(_while(wrong[0])) if (wrong := wrong_beside(one)) else one
        for one in findings
    ]


def _is_unfelt(fault: Finding) -> bool:
    """Whether it takes no part in what depths tell beside scans."""
    if fault.fault == "time_offset_wheels" and fault.estimate is not None:
        return abs(fault.estimate.value) <= MOST_UNFELT_MS
    return fault.fault in UNFELT or fault.check.startswith("gyro.")


def _without_misfit(findings: Sequence[Finding]) -> list[Finding]:
    """Where wheels and scans contradict each other most of the time, and nothing but the sizes
    that were fitted to both would say why, these sizes are what a broken fit left. Nor does slip
    that is seen here and there leave the rest to rely on: four wheels that skid in each turn put a
    laser 0.1 m before its place, and called a track 42 % too narrow."""
    misfit = [one for one in findings if one.check == "motion.wheels" and one.fault]
    known = [one for one in _causes(findings) if one.fault not in (*FITTED, SLIP)]
    if not misfit or known:
        return list(findings)
    reason = _while(misfit[0])
    return [one.inconclusive(reason) if one.fault in FITTED else one for one in findings]


def _causes(findings: Sequence[Finding]) -> list[Finding]:
    """Faults that may be why the streams do not tell one motion."""
    return [
        one
        for one in findings
        if one.fault
        and one.fault != NO_CAUSE
        and not one.check.startswith((*NOT_FITTED, MOVES_NOTHING))
    ]


def _without_known_cause(findings: Sequence[Finding]) -> list[Finding]:
    """What fits nothing has no known cause only where nothing else was found that takes part."""
    known = _causes(findings)
    if not known:
        return list(findings)
    reason = _while(known[0])
    return [one.inconclusive(reason) if one.fault == NO_CAUSE else one for one in findings]


def _apart(one: Measurement | None, other: Measurement | None) -> bool:
    """Whether two sizes of one thing contradict each other."""
    if one is None or other is None:
        return False
    return abs(one.value - other.value) > SURE_SIGMAS * float(np.hypot(one.sigma, other.sigma))


def _with_cause(finding: Finding, faults: Sequence[Finding], lidars: set[str]) -> Finding:
    if finding.verdict != "fault":
        return finding
    causes = [one for one in faults if _follows(finding, one, lidars)]
    if not causes:
        return finding
    return finding.inconclusive(_while(causes[0]))


def _while(cause: Finding) -> str:
    """Why nothing can be told beside a fault."""
    return f"cannot be told while {fault_meaning(cause.fault or '')} ({cause.subject})"


def _follows(finding: Finding, cause: Finding, lidars: set[str]) -> bool:
    """Whether the one may be nothing but a consequence of the other."""
    fault, by = finding.fault, cause.fault
    if fault is None or by is None or fault == by:
        return False
    if _is_larger(finding, cause):
        return False
    applies = {
        "anywhere": True,
        "same subject": finding.subject == cause.subject,
        "lidar stamps": cause.subject in lidars,
    }
    explained_by = registry().faults[by].explains
    return any(applies[one.where] and fault in one.faults for one in explained_by)


def _is_larger(finding: Finding, cause: Finding) -> bool:
    """Whether an offset, or a size, is more than the other fault can make of the stamps."""
    if finding.estimate is None or cause.estimate is None:
        return False
    most = None
    if finding.fault in OFFSETS:
        most = MOST_MOVED.get(cause.fault or "")
    elif cause.fault == "stamps_jitter" and _is_size_of(finding, cause.subject):
        most = MOST_SIZED
    return most is not None and abs(finding.estimate.value) > most * abs(cause.estimate.value)


def _is_size_of(finding: Finding, wheels: str) -> bool:
    """Whether it is a size of these wheels in per cent."""
    sized = finding.fault in ("wheel_radius", "wheel_track") and finding.subject == wheels
    return sized and finding.estimate is not None and finding.estimate.unit == "%"
