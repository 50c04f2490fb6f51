"""Is the robot description in the recording one that physics can drive?

A wrong one gives plausible wrong results; ``sim/robot/validate.py`` asks the same of our own.
"""

from __future__ import annotations

from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding
from slamsim.check.question import FaultKind, Question, QuestionGroup, judge, unanswered
from slamsim.guard.errors import InputRefused
from slamsim.sim.robot.urdf import Description, Unconnected, read_description
from slamsim.sim.robot.validate import FaultKind as ModelFaultKind
from slamsim.sim.robot.validate import ModelFault, model_faults

SUBJECT = "/robot_description"
MAX_WHEEL_GAP_M = 0.002
"""A support wheel 2 mm off the floor tilts a robot of 0.3 m by half a degree."""
_FLOOR_FRAME = "base_footprint"
_CONSEQUENCE = "a simulation with this robot gives plausible wrong results"


def _about(fault: str, asks: str, meaning: str, consequence: str = _CONSEQUENCE) -> Question:
    part = fault.removeprefix("urdf_")
    kinds = (FaultKind(fault, meaning),)
    return Question(f"description.{part}", asks, kinds, consequence=consequence)


WHOLE = Question(
    "description",
    "the robot description is one that physics can drive",
    (),
    consequence=_CONSEQUENCE,
    excitation_wanted=f"a robot description on {SUBJECT}",
)
UNREADABLE = _about(
    "urdf_unreadable",
    "the robot description can be read",
    "the robot description cannot be read",
    "no consumer knows where the sensors sit",
)
UNCONNECTED = _about(
    "urdf_unconnected",
    "joints connect all links",
    "links that nothing connects",
    "no consumer knows where these links are",
)
_KINDS: dict[ModelFaultKind, tuple[Question, str]] = {
    "inertia": (
        _about(
            "urdf_inertia",
            "mass and inertia fit the shapes",
            "mass or inertia does not fit the shape",
        ),
        "Compute mass and inertia of each link from its shape; a default of 1 kg m^2 makes a "
        "small part shake the robot until it bursts.",
    ),
    "support_wheels": (
        _about(
            "urdf_support_wheels",
            "support wheels turn or slide",
            "support wheels are fixed and not free to slide",
        ),
        "Give the support wheels continuous joints, or frictionless balls.",
    ),
    "wheel_height": (
        _about(
            "urdf_wheel_height", "all wheels touch the ground", "wheels do not touch the ground"
        ),
        "Put every wheel's lowest point on the floor, z = 0 of base_footprint.",
    ),
    "balance": (
        _about("urdf_balance", "the robot stands", "the robot would topple where it stands"),
        "Move the wheels or the weight so that the robot stands.",
    ),
}


def check_description(evidence: RecordingEvidence) -> list[Finding]:
    """Mass and inertia, support wheels and wheels' heights of /robot_description."""
    text = evidence.recording.robot_description
    if text is None:
        return [unanswered(WHOLE, SUBJECT, "the recording holds no robot description")]
    try:
        description = read_description(text, SUBJECT, meshes=True)
    except Unconnected as error:
        return [_fault(UNCONNECTED, error.reason, "Join every link to the rest with a joint.")]
    except InputRefused as error:
        return [_fault(UNREADABLE, error.reason, "Publish a well-formed URDF, or none.")]
    faults = _faults(description)
    if not faults:
        words = f"{len(description.links)} links with sane mass, inertia and wheels"
        return [judge(WHOLE, SUBJECT, words, verdict="ok")]
    by_kind: dict[ModelFaultKind, list[ModelFault]] = {}
    for fault in faults:
        by_kind.setdefault(fault.kind, []).append(fault)
    return [
        _fault(_KINDS[kind][0], _sentence(of_kind), _KINDS[kind][1])
        for kind, of_kind in by_kind.items()
    ]


GROUP = QuestionGroup(
    "robot description",
    70,
    (WHOLE, UNREADABLE, UNCONNECTED, *(question for question, _ in _KINDS.values())),
    check_description,
)


def _faults(description: Description) -> list[ModelFault]:
    """Heights only count where the floor is known, and balance where all masses are."""
    faults = model_faults(description, MAX_WHEEL_GAP_M)
    if description.root == _FLOOR_FRAME:
        return faults
    return [fault for fault in faults if fault.kind in ("inertia", "support_wheels")]


def _sentence(faults: list[ModelFault]) -> str:
    more = f" (and {len(faults) - 1} more like it)" if len(faults) > 1 else ""
    return faults[0].words + more


def _fault(question: Question, words: str, advice: str) -> Finding:
    return judge(question, SUBJECT, words, verdict="fault", advice=advice)
