"""Is the robot description in the recording one that physics can drive?

A wrong one gives plausible wrong results: ``sim/robot/validate.py`` asks the same of our own.
"""

from __future__ import annotations

from slamsim.check.findings import Finding
from slamsim.guard.errors import InputRefused
from slamsim.recording import Recording
from slamsim.sim.robot.urdf import Description, Unconnected, read_description
from slamsim.sim.robot.validate import FaultKind, ModelFault, model_faults

CHECK = "description"
MAX_WHEEL_GAP_M = 0.002
"""A support wheel 2 mm off the floor tilts a robot of 0.3 m by half a degree."""
_FLOOR_FRAME = "base_footprint"
_FAULT: dict[FaultKind, tuple[str, str]] = {
    "inertia": (
        "urdf_inertia",
        "Compute mass and inertia of each link from its shape; a default of 1 kg m^2 makes a "
        "small part shake the robot until it bursts.",
    ),
    "support_wheels": (
        "urdf_support_wheels",
        "Give the support wheels continuous joints, or frictionless balls.",
    ),
    "wheel_height": (
        "urdf_wheel_height",
        "Put every wheel's lowest point on the floor, z = 0 of base_footprint.",
    ),
    "balance": ("urdf_balance", "Move the wheels or the weight so that the robot stands."),
}


def check_description(recording: Recording) -> list[Finding]:
    """Mass and inertia, support wheels and wheels' heights of /robot_description."""
    subject = "/robot_description"
    if recording.robot_description is None:
        words = "the recording holds no robot description"
        return [Finding(CHECK, subject, "cannot tell", words)]
    try:
        description = read_description(recording.robot_description, subject, meshes=True)
    except Unconnected as error:
        advice = "Join every link to the rest with a joint."
        return [_bad(subject, "urdf_unconnected", error.reason, advice)]
    except InputRefused as error:
        advice = "Publish a well-formed URDF, or none."
        return [_bad(subject, "urdf_unreadable", error.reason, advice)]
    faults = _faults(description)
    if not faults:
        words = f"{len(description.links)} links with sane mass, inertia and wheels"
        return [Finding(CHECK, subject, "ok", words)]
    named: dict[str, list[ModelFault]] = {}
    for fault in faults:
        named.setdefault(_FAULT[fault.kind][0], []).append(fault)
    return [
        _bad(subject, name, _sentence(of_kind), _FAULT[of_kind[0].kind][1])
        for name, of_kind in named.items()
    ]


def _faults(description: Description) -> list[ModelFault]:
    """Heights only count where the floor is known, and balance where all masses are."""
    faults = model_faults(description, MAX_WHEEL_GAP_M)
    if description.root == _FLOOR_FRAME:
        return faults
    return [fault for fault in faults if fault.kind in ("inertia", "support_wheels")]


def _sentence(faults: list[ModelFault]) -> str:
    more = f" (and {len(faults) - 1} more like it)" if len(faults) > 1 else ""
    return faults[0].words + more


def _bad(subject: str, fault: str, words: str, advice: str) -> Finding:
    return Finding(f"{CHECK}.{fault.removeprefix('urdf_')}", subject, "bad", words, fault, advice)
