"""Faults of the robot description, as made by hand or by a converter."""

from __future__ import annotations

import re
from typing import Literal

import numpy as np
from pydantic import Field

from slamsim.recording import Recording
from slamsim.recording.edits.base import Edit
from slamsim.recording.edits.frames import ChangeDescription, joint_text, with_joint_origin
from slamsim.sensors.faults.base import Fault


class UrdfInertia(Fault):
    """A small part is given the inertia that an editor fills in."""

    kind: Literal["urdf_inertia"]
    link: str
    """Which part."""
    inertia_kg_m2: float = Field(gt=0.0, le=1e6)
    """About each of its axes."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        value = f"{self.inertia_kg_m2:g}"
        inertia = f'<inertia ixx="{value}" ixy="0" ixz="0" iyy="{value}" iyz="0" izz="{value}"/>'
        pattern = rf'(<link name="{re.escape(self.link)}">.*?)<inertia\b[^>]*/>'
        return ChangeDescription(
            lambda urdf: re.sub(pattern, rf"\1{inertia}", urdf, count=1, flags=re.DOTALL)
        )


class UrdfJointType(Fault):
    """A joint that should turn is fixed."""

    kind: Literal["urdf_joint_type"]
    link: str
    """The part that it carries."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def fixed(urdf: str) -> str:
            joint = joint_text(urdf, self.link)
            return urdf if joint is None else urdf.replace(joint, _as_fixed(joint))

        return ChangeDescription(fixed)


class UrdfHeight(Fault):
    """A wheel is drawn at the wrong height."""

    kind: Literal["urdf_height"]
    link: str
    """Which wheel."""
    by_m: float = Field(ge=-1.0, le=1.0)
    """How much too high."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        raised = np.eye(4)
        raised[2, 3] = self.by_m
        return ChangeDescription(
            lambda urdf: with_joint_origin(urdf, self.link, lambda T: raised @ T)
        )


class UrdfUnconnected(Fault):
    """No joint carries one of the parts."""

    kind: Literal["urdf_unconnected"]
    link: str
    """Which part."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def without(urdf: str) -> str:
            joint = joint_text(urdf, self.link)
            return urdf if joint is None else urdf.replace(joint, "")

        return ChangeDescription(without)


class UrdfCut(Fault):
    """Only the beginning of the description has arrived."""

    kind: Literal["urdf_cut"]
    share: float = Field(gt=0.0, lt=1.0)
    """Of its characters."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return ChangeDescription(lambda urdf: urdf[: round(self.share * len(urdf))])


def _as_fixed(joint: str) -> str:
    turned = re.sub(r'type="[a-z]+"', 'type="fixed"', joint, count=1)
    return re.sub(r"\s*<axis[^>]*/>", "", turned)
