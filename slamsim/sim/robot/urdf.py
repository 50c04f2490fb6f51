"""Parses a robot description (URDF) into plain values, reduced to the moving parts.

Only what the simulation needs is kept: links with mass and primitive shapes, joints with their
place and axis. Meshes are for the eye; as collision shapes they are refused.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from xml.etree.ElementTree import Element, ParseError

import numpy as np
from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import fromstring

from slamsim.core.geometry import matrix_from_rpy, se3_from_parts
from slamsim.core.types import FloatArray
from slamsim.guard.errors import InputRefused
from slamsim.sim.robot.inertia import Inertial, box_inertia, cylinder_inertia, join, sphere_inertia

ShapeKind = Literal["box", "cylinder", "sphere"]


class Unconnected(InputRefused):
    """Links that the joints do not join into one tree."""


@dataclass(frozen=True, slots=True, eq=False)
class LinkShape:
    """A primitive solid. size_m: box (x, y, z), cylinder (radius, length along z), sphere (r,)."""

    kind: ShapeKind
    size_m: tuple[float, ...]
    T_link_shape: FloatArray

    def solid_inertia(self, mass_kg: float) -> FloatArray:
        """(3, 3) of a homogeneous body of this shape, in the shape's own axes."""
        if self.kind == "box":
            return box_inertia(mass_kg, self.size_m)
        if self.kind == "cylinder":
            return cylinder_inertia(mass_kg, self.size_m[0], self.size_m[1])
        return sphere_inertia(mass_kg, self.size_m[0])

    def volume_m3(self) -> float:
        if self.kind == "box":
            return float(np.prod(self.size_m))
        if self.kind == "cylinder":
            return float(np.pi * self.size_m[0] ** 2 * self.size_m[1])
        return float(4.0 / 3.0 * np.pi * self.size_m[0] ** 3)

    def reach_m(self, T_frame_link: FloatArray, direction: FloatArray) -> float:
        """How far the shape reaches along a unit direction (3,) of a frame (its support)."""
        T = T_frame_link @ self.T_link_shape
        local = T[:3, :3].T @ direction
        if self.kind == "box":
            extent = 0.5 * float(np.abs(local) @ np.array(self.size_m))
        elif self.kind == "cylinder":
            across = float(np.hypot(local[0], local[1]))
            extent = self.size_m[0] * across + 0.5 * self.size_m[1] * abs(float(local[2]))
        else:
            extent = self.size_m[0]
        return float(T[:3, 3] @ direction) + extent


@dataclass(frozen=True, slots=True, eq=False)
class Link:
    """inertial is None for a pure frame."""

    name: str
    inertial: Inertial | None
    collisions: tuple[LinkShape, ...]
    visuals: tuple[LinkShape, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """axis: (3,) unit vector in the child's frame. kind: as in URDF, "fixed", "continuous", ...

    limits: lowest and highest position, where it has any.
    """

    name: str
    kind: str
    parent: str
    child: str
    T_parent_child: FloatArray
    axis: FloatArray
    limits: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Description:
    """A tree of links. joints is ordered from the root outwards."""

    name: str
    root: str
    links: dict[str, Link]
    joints: tuple[Joint, ...]

    def placements(self) -> dict[str, FloatArray]:
        """(4, 4) where each link stands when all joints are at zero."""
        placed = {self.root: np.eye(4)}
        for joint in self.joints:
            placed[joint.child] = placed[joint.parent] @ joint.T_parent_child
        return placed

    def whole(self) -> Inertial:
        """All links as one rigid body, in the frame of the root."""
        placed = self.placements()
        return join(
            [
                link.inertial.seen_from(placed[name])
                for name, link in self.links.items()
                if link.inertial is not None
            ]
        )


def read_description(text: str, path: Path | str, meshes: bool = False) -> Description:
    """The links and joints of a URDF text; path is only for the message.

    meshes: whether collision meshes are left out, or refused as the physics must. Raises
    InputRefused if it is no URDF, and Unconnected if its links are no tree.
    """
    try:
        robot = fromstring(text)
    except (ParseError, DefusedXmlException, ValueError) as error:
        raise InputRefused(path, f"this is not a robot description: {error}") from None
    try:
        found = [_read_link(link, meshes) for link in robot.findall("link")]
        joints = [_read_joint(joint) for joint in robot.findall("joint")]
    except (KeyError, ValueError) as error:
        raise InputRefused(path, f"a link or joint is incomplete: {error}") from None
    links = {link.name: link for link in found}
    roots = sorted(set(links) - {joint.child for joint in joints})
    if len(roots) != 1:
        raise Unconnected(path, f"needs exactly one root link, has {len(roots)}: {roots}")
    ordered = _from_root_outwards(roots[0], joints, path)
    return Description(robot.get("name", "robot"), roots[0], links, ordered)


def _from_root_outwards(root: str, joints: Iterable[Joint], path: Path | str) -> tuple[Joint, ...]:
    waiting, placed, ordered = list(joints), {root}, list[Joint]()
    while waiting:
        ready = [joint for joint in waiting if joint.parent in placed]
        if not ready:
            names = ", ".join(joint.name for joint in waiting)
            raise Unconnected(path, f"joints that do not lead back to the root {root}: {names}")
        ordered += ready
        placed.update(joint.child for joint in ready)
        waiting = [joint for joint in waiting if joint.child not in placed]
    return tuple(ordered)


def _numbers(text: str, count: int) -> tuple[float, ...]:
    values = tuple(float(word) for word in text.split())
    if len(values) != count or not np.all(np.isfinite(values)):
        raise ValueError(f"expected {count} finite numbers, found {text!r}")
    return values


def _required(element: Element, tag: str) -> Element:
    child = element.find(tag)
    if child is None:
        raise KeyError(f"<{element.tag} name={element.get('name', '')!r}> has no <{tag}>")
    return child


def _origin(element: Element) -> FloatArray:
    origin = element.find("origin")
    if origin is None:
        return np.eye(4)
    xyz = _numbers(origin.get("xyz", "0 0 0"), 3)
    roll, pitch, yaw = _numbers(origin.get("rpy", "0 0 0"), 3)
    return se3_from_parts(matrix_from_rpy(roll, pitch, yaw), np.array(xyz))


def _read_shape(element: Element, meshes: bool) -> LinkShape | None:
    geometry = _required(element, "geometry")
    T = _origin(element)
    if (box := geometry.find("box")) is not None:
        return LinkShape("box", _numbers(box.attrib["size"], 3), T)
    if (cylinder := geometry.find("cylinder")) is not None:
        size = f"{cylinder.attrib['radius']} {cylinder.attrib['length']}"
        return LinkShape("cylinder", _numbers(size, 2), T)
    if (sphere := geometry.find("sphere")) is not None:
        return LinkShape("sphere", _numbers(sphere.attrib["radius"], 1), T)
    if element.tag == "collision" and not meshes:
        raise ValueError("a collision shape must be a box, a cylinder or a sphere")
    return None


def _read_inertial(element: Element | None) -> Inertial | None:
    if element is None:
        return None
    mass = _numbers(_required(element, "mass").attrib["value"], 1)[0]
    tensor = _required(element, "inertia").attrib
    xx, xy, xz, yy, yz, zz = (
        _numbers(tensor[key] if key in ("ixx", "iyy", "izz") else tensor.get(key, "0"), 1)[0]
        for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    )
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return Inertial(mass, np.zeros(3), inertia).seen_from(_origin(element))


def _read_link(element: Element, meshes: bool) -> Link:
    shapes = {
        tag: tuple(s for e in element.findall(tag) if (s := _read_shape(e, meshes)) is not None)
        for tag in ("collision", "visual")
    }
    return Link(
        element.attrib["name"],
        _read_inertial(element.find("inertial")),
        shapes["collision"],
        shapes["visual"],
    )


def _read_joint(element: Element) -> Joint:
    axis_element = element.find("axis")
    axis = np.array(_numbers("1 0 0" if axis_element is None else axis_element.attrib["xyz"], 3))
    length = float(np.linalg.norm(axis))
    if length == 0.0:
        raise ValueError(f"joint {element.attrib['name']} has a zero axis")
    return Joint(
        element.attrib["name"],
        element.attrib["type"],
        _required(element, "parent").attrib["link"],
        _required(element, "child").attrib["link"],
        _origin(element),
        axis / length,
    )
