"""The checker's look at the robot description."""

from __future__ import annotations

import re

import pytest

from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding
from slamsim.check.questions.frames.description import check_description
from slamsim.config.robot import RobotConfig
from slamsim.recording import Recording
from slamsim.sim.robot.model import build_robot

URDF = build_robot(RobotConfig()).urdf


def asked(text: str | None) -> list[Finding]:
    return check_description(RecordingEvidence(Recording("test", "memory", robot_description=text)))


def test_our_own_robot_is_sane() -> None:
    assert [finding.verdict for finding in asked(URDF)] == ["ok"]


def test_without_a_description_nothing_can_be_told() -> None:
    assert [finding.verdict for finding in asked(None)] == ["inconclusive"]


def lifted_support_wheel() -> str:
    joint = re.search(r'<joint name="caster_front_joint".*?</joint>', URDF, re.DOTALL)
    assert joint is not None
    place = re.search(r'xyz="(\S+) (\S+) (\S+)"', joint[0])
    assert place is not None
    x, y, z = place.groups()
    lifted = joint[0].replace(place[0], f'xyz="{x} {y} {float(z) + 0.007}"')
    return URDF.replace(joint[0], lifted)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (re.sub('(ixx|iyy|izz)="[^"]*"', r'\1="1"', URDF), "urdf_inertia"),
        (re.sub(r'<mass value="[^"]*"', '<mass value="1000"', URDF, count=1), "urdf_inertia"),
        (
            re.sub('(caster_front_joint" type=)"continuous"', r'\1"fixed"', URDF),
            "urdf_support_wheels",
        ),
        (lifted_support_wheel(), "urdf_wheel_height"),
        (URDF.replace('parent link="base_link"', 'parent link="nobody"', 1), "urdf_unconnected"),
        ("", "urdf_unreadable"),
        ("a robot", "urdf_unreadable"),
        (URDF[: len(URDF) // 2], "urdf_unreadable"),
        ("<robot/>", "urdf_unconnected"),
        (URDF.replace('mass value="', 'mass value="nan', 1), "urdf_unreadable"),
    ],
)
def test_each_fault_is_named(text: str, fault: str) -> None:
    bad = {finding.fault for finding in asked(text)}
    assert fault in bad
    assert all(finding.words and finding.advice for finding in asked(text))


def test_meshes_do_not_hide_the_rest() -> None:
    mesh = '<geometry><mesh filename="package://robot/base.stl"/></geometry>'
    foreign = re.sub(r"<geometry><box[^>]*/></geometry>", mesh, URDF)
    assert foreign != URDF
    assert "urdf_unreadable" not in {finding.fault for finding in asked(foreign)}


def test_a_robot_without_a_floor_frame_is_not_judged_by_its_wheels_heights() -> None:
    foreign = URDF.replace("base_footprint", "chassis")
    assert not [finding for finding in asked(foreign) if finding.fault == "urdf_wheel_height"]
