"""Edits of the robot description as text; the rest of the text stays unchanged."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from slamsim.core.geometry import matrix_from_rpy, se3_from_parts
from slamsim.core.types import FloatArray
from slamsim.recording import Recording
from slamsim.recording.edits.base import CannotEdit, Edit


@dataclass(frozen=True, slots=True)
class ChangeDescription(Edit):
    """The robot description (URDF) changed; a text that stays as it was cannot be meant."""

    change: Callable[[str], str]

    def apply(self, recording: Recording) -> Recording:
        if recording.robot_description is None:
            raise CannotEdit(f"{recording.name} has no robot description")
        changed = self.change(recording.robot_description)
        if changed == recording.robot_description:
            raise CannotEdit(f"the robot description of {recording.name} has no such part")
        return replace(recording, robot_description=changed)


def with_joint_origin(urdf: str, child: str, moved: Callable[[FloatArray], FloatArray]) -> str:
    """The description with the origin of the joint to ``child`` exchanged, if it has one.

    moved: from its (4, 4) T_parent_child to another.
    """
    joint = joint_text(urdf, child)
    if joint is None:
        return urdf
    xyz, rpy = (_numbers(joint, name) for name in ("xyz", "rpy"))
    T = moved(se3_from_parts(matrix_from_rpy(*rpy), np.array(xyz)))
    origin = f'<origin xyz="{_text(T[:3, 3])}" rpy="{_text(_rpy(T[:3, :3]))}"/>'
    bare = re.sub(r"<origin[^>]*/>", "", joint)
    return urdf.replace(joint, bare.replace("<parent", f"{origin}<parent", 1))


def joint_text(urdf: str, child: str) -> str | None:
    """The joint element that carries this link, as it is written."""
    for joint in re.findall(r"<joint\b.*?</joint>", urdf, flags=re.DOTALL):
        if re.search(rf'<child\s+link="{re.escape(child)}"', joint):
            return str(joint)
    return None


def _numbers(joint: str, name: str) -> list[float]:
    origin = re.search(r"<origin[^>]*/>", joint)
    found = re.search(rf'{name}="([^"]*)"', origin.group()) if origin else None
    return [float(word) for word in found.group(1).split()] if found else [0.0, 0.0, 0.0]


def _rpy(rotation: FloatArray) -> FloatArray:
    return np.array(
        [
            np.arctan2(rotation[2, 1], rotation[2, 2]),
            np.arcsin(np.clip(-rotation[2, 0], -1.0, 1.0)),
            np.arctan2(rotation[1, 0], rotation[0, 0]),
        ]
    )


def _text(values: FloatArray) -> str:
    return " ".join(f"{value:.12g}" for value in values)
