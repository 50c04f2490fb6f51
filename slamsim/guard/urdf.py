"""Checks robot descriptions (URDF) of users before PyBullet reads them.

PyBullet crashes on two root links and takes NaN, negative and missing numbers in silence.
"""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path, PurePosixPath
from xml.etree.ElementTree import Element, ParseError

import defusedxml.ElementTree
from defusedxml import DefusedXmlException

from slamsim.guard.errors import InputRefused, NotFound, shown
from slamsim.guard.files import read_input, require_inside
from slamsim.guard.limits import LIMITS
from slamsim.guard.mesh_file import check_mesh_file

_JOINT_TYPES = ("fixed", "continuous", "revolute", "prismatic", "floating", "planar")
_MESH_SUFFIXES = (".stl", ".obj", ".dae")
_AXIS_JOINTS = ("continuous", "revolute", "prismatic", "planar")
_MIN_AXIS = 1e-6
_MIN_SIZE_M = 1e-6
"""Smaller numbers are rounding of 0, which PyBullet takes in silence."""


def read_urdf(path: Path) -> tuple[str, tuple[str, ...]]:
    """The text of a URDF file, and the mesh files that it names, relative to its folder.

    Raises NotFound, or InputRefused as ``check_urdf`` does.
    """
    try:
        text = read_input(path, "urdf_bytes").decode("utf-8-sig")
    except UnicodeDecodeError as error:
        reason = f"cannot be read as text, save it as UTF-8: {error}"
        raise InputRefused(path, reason) from None
    return text, check_urdf(text, path)


def check_urdf(text: str, path: Path) -> tuple[str, ...]:
    """Raise InputRefused unless this is one well-formed robot with sane numbers.

    That is: one tree of links with unique names, known joint types, finite numbers of the
    right count, masses and moments of inertia >= 0, sizes > 0, axes that point somewhere, and
    whole mesh files inside the folder of ``path``. Returns their names, relative to that folder.
    """
    checked = _UrdfCheck(path)
    checked.check(text)
    return tuple(checked.meshes)


class _UrdfCheck:
    def __init__(self, path: Path) -> None:
        self.path = path
        self.meshes: dict[str, Path] = {}

    def check(self, text: str) -> None:
        robot = self._parse(text)
        links, joints = robot.findall("link"), robot.findall("joint")
        moving = [joint for joint in joints if joint.get("type") != "fixed"]
        self._short(robot.get("name", ""), "robot")
        self._few("links", len(links))
        self._few("moving_joints", len(moving))
        self._names(links, "link")
        self._names(joints, "joint")
        for joint in joints:
            self._joint(joint)
        self._tree(links, joints)
        for link in links:
            self._link(link)

    def refuse(self, reason: str, element: Element | None = None, limit: str = "") -> InputRefused:
        if element is None:
            return InputRefused(self.path, reason, limit=limit)
        name = element.get("name")
        where = f"<{element.tag} name={shown(name)}>" if name else f"<{element.tag}>"
        return InputRefused(self.path, reason, where, limit=limit)

    def _few(self, what: str, count: int) -> None:
        most: int = getattr(LIMITS, f"urdf_{what}")
        if count > most:
            reason = f"has {count:,} {what.replace('_', ' ')}, at most {most:,} are read"
            raise self.refuse(reason, limit=f"urdf_{what}")

    def _parse(self, text: str) -> Element:
        size = len(text.encode("utf-8", errors="replace"))
        if size > LIMITS.urdf_bytes:
            reason = f"is {size:,} bytes long, at most {LIMITS.urdf_bytes:,} are read"
            raise self.refuse(reason, limit="urdf_bytes")
        if text.count("<") > 4 * LIMITS.urdf_elements:  # before a tree of them is built
            raise self._too_many()
        try:
            robot: Element = defusedxml.ElementTree.fromstring(text, forbid_dtd=True)
        except ParseError as error:
            raise self.refuse(f"is not well-formed XML: {error}") from None
        except (DefusedXmlException, ValueError) as error:
            raise self.refuse(f"is refused as XML: {error}") from None
        if robot.tag != "robot":
            raise self.refuse(f"begins with <{shown(robot.tag)[1:-1]}>, a URDF with <robot>")
        self._depth_and_count(robot)
        return robot

    def _depth_and_count(self, robot: Element) -> None:
        level, depth, count = [robot], 0, 0
        while level:
            depth, count = depth + 1, count + len(level)
            if depth > LIMITS.urdf_depth:
                reason = f"is nested deeper than {LIMITS.urdf_depth} levels"
                raise self.refuse(reason, limit="urdf_depth")
            if count > LIMITS.urdf_elements:
                raise self._too_many()
            level = [child for element in level for child in element]

    def _too_many(self) -> InputRefused:
        reason = f"has more than {LIMITS.urdf_elements:,} elements"
        return self.refuse(reason, limit="urdf_elements")

    def _names(self, elements: list[Element], kind: str) -> None:
        counts = Counter(element.get("name") for element in elements)
        if counts[None] or counts[""]:
            raise self.refuse(f"a <{kind}> has no name")
        for name, count in counts.items():
            self._short(name or "", kind)
            if count > 1:
                raise self.refuse(f"{count} {kind}s are called {shown(name)}")

    def _short(self, name: str, kind: str) -> None:
        if len(name) > (most := LIMITS.urdf_name_characters):
            reason = f"a {kind} has a name of {len(name):,} characters, at most {most:,} are read"
            raise self.refuse(reason, limit="urdf_name_characters")

    def _joint(self, joint: Element) -> None:
        kind = joint.get("type")
        if kind not in _JOINT_TYPES:
            known = ", ".join(_JOINT_TYPES)
            raise self.refuse(f"the type {shown(kind)} is none of {known}", joint)
        for origin in joint.findall("origin"):
            self._origin(origin, joint)
        for axis in joint.findall("axis"):
            values = self._numbers(axis, "xyz", 3, joint, default=(1.0, 0.0, 0.0))
            if kind in _AXIS_JOINTS and math.hypot(*values) < _MIN_AXIS:
                raise self.refuse("the axis points nowhere (0 0 0)", joint)
        limit = joint.find("limit")
        if limit is None and kind in ("revolute", "prismatic"):
            raise self.refuse(f"a {kind} joint needs a <limit>", joint)
        for element, keys in ((limit, ("lower", "upper")), (joint.find("dynamics"), ())):
            if element is not None:
                self._limit(element, keys, joint)

    def _limit(self, element: Element, signed: tuple[str, ...], joint: Element) -> None:
        for key in ("effort", "velocity", "damping", "friction", *signed):
            if element.get(key) is not None:
                (value,) = self._numbers(element, key, 1, joint, bounded=False)
                if value < 0 and key not in signed:
                    raise self.refuse(f"{key} is {value:g}, not at least 0", joint)
        if element.get("lower") is not None and element.get("upper") is not None:
            lower, upper = (float(element.get(key, "0")) for key in ("lower", "upper"))
            if joint.get("type") in ("revolute", "prismatic") and lower > upper:
                raise self.refuse(f"the lower limit {lower:g} is above the upper {upper:g}", joint)

    def _tree(self, links: list[Element], joints: list[Element]) -> None:
        names = {link.get("name", "") for link in links}
        if not names:
            raise self.refuse("has no link")
        parent_of: dict[str, str] = {}
        for joint in joints:
            parent, child = (self._end(joint, role, names) for role in ("parent", "child"))
            if child in parent_of:
                raise self.refuse(f"the link {shown(child)} is the child of two joints", joint)
            parent_of[child] = parent
        roots = sorted(names - parent_of.keys())
        if len(roots) != 1:
            found = (
                ", ".join(name[:60] for name in roots[:5])
                if roots
                else "none, the joints form a ring"
            )
            raise self.refuse(f"needs exactly one root link, has {len(roots)}: {found}")
        reached = _reached(roots[0], parent_of)
        if lost := sorted(names - reached):
            raise self.refuse(f"the joints form a ring through the link {shown(lost[0])}")

    def _end(self, joint: Element, role: str, names: set[str]) -> str:
        ends = joint.findall(role)
        if len(ends) != 1:
            raise self.refuse(f"needs one <{role}>, has {len(ends)}", joint)
        name = ends[0].get("link", "")
        if name not in names:
            raise self.refuse(f"its {role} link {shown(name)} does not exist", joint)
        return name

    def _link(self, link: Element) -> None:
        for inertial in link.findall("inertial"):
            self._inertial(inertial, link)
        for part in (*link.findall("visual"), *link.findall("collision")):
            for origin in part.findall("origin"):
                self._origin(origin, link)
            geometries = part.findall("geometry")
            if len(geometries) != 1 or len(geometries[0]) != 1:
                raise self.refuse(f"a <{part.tag}> needs one <geometry> with one shape", link)
            self._shape(geometries[0][0], link)

    def _inertial(self, inertial: Element, link: Element) -> None:
        for origin in inertial.findall("origin"):
            self._origin(origin, link)
        for mass in inertial.findall("mass"):
            (value,) = self._numbers(mass, "value", 1, link)
            if value < 0:
                raise self.refuse(f"the mass is {value:g} kg, not at least 0", link)
        for inertia in inertial.findall("inertia"):
            for key in ("ixx", "iyy", "izz"):
                (value,) = self._numbers(inertia, key, 1, link)
                if value < 0:
                    raise self.refuse(f"{key} is {value:g} kg m^2, not at least 0", link)
            for key in ("ixy", "ixz", "iyz"):
                self._numbers(inertia, key, 1, link, default=(0.0,))

    def _shape(self, shape: Element, link: Element) -> None:
        sizes = {
            "box": (("size", 3),),
            "sphere": (("radius", 1),),
            "cylinder": (("radius", 1), ("length", 1)),
            "capsule": (("radius", 1), ("length", 1)),
        }
        if shape.tag == "mesh":
            self._mesh(shape, link)
        elif shape.tag in sizes:
            for key, count in sizes[shape.tag]:
                if min(self._numbers(shape, key, count, link)) < _MIN_SIZE_M:
                    raise self.refuse(f"the {key} of a {shape.tag} is not above 0", link)
        else:
            known = ", ".join((*sizes, "mesh"))
            raise self.refuse(f"the shape {shown(shape.tag)} is none of {known}", link)

    def _mesh(self, mesh: Element, link: Element) -> None:
        if 0.0 in self._numbers(mesh, "scale", 3, link, default=(1.0, 1.0, 1.0)):
            raise self.refuse("the scale of a mesh is 0", link)
        name = mesh.get("filename", "")
        self._short(name, "mesh")
        if not name or "://" in name or not name.lower().endswith(_MESH_SUFFIXES):
            kinds = ", ".join(_MESH_SUFFIXES)
            reason = f"the mesh {shown(name)} is not a plain file name that ends in {kinds}"
            raise self.refuse(reason, link)
        target = require_inside(self.path.parent, name, self.path, f"<link {link.get('name')}>")
        if target not in self.meshes.values():
            try:
                check_mesh_file(target, _MESH_SUFFIXES)
            except NotFound:
                reason = f"the mesh file {shown(name)} does not exist"
                raise self.refuse(reason, link) from None
        self.meshes[str(PurePosixPath(name))] = target

    def _origin(self, origin: Element, owner: Element) -> None:
        for key in ("xyz", "rpy"):
            self._numbers(origin, key, 3, owner, default=(0.0, 0.0, 0.0))

    def _numbers(
        self,
        element: Element,
        key: str,
        count: int,
        owner: Element,
        default: tuple[float, ...] | None = None,
        bounded: bool = True,
    ) -> tuple[float, ...]:
        text = element.get(key)
        what = f"{key} of <{element.tag}>"
        if text is None:
            if default is None:
                raise self.refuse(f"{what} is missing", owner)
            return default
        try:
            values = tuple(float(word) for word in text.split())
        except ValueError:
            raise self.refuse(f"{what} is {shown(text)}, not a number", owner) from None
        if len(values) != count:
            needed = "one number" if count == 1 else f"{count} numbers"
            raise self.refuse(f"{what} is {shown(text)}, {needed} are needed", owner)
        finite = all(map(math.isfinite, values))
        if not finite or (bounded and max(map(abs, values)) > LIMITS.urdf_number):
            reason = f"{what} is {shown(text)}, not a finite sane number"
            raise self.refuse(reason, owner, "urdf_number" if finite else "")
        return values


def _reached(root: str, parent_of: dict[str, str]) -> set[str]:
    children: dict[str, list[str]] = {}
    for child, parent in parent_of.items():
        children.setdefault(parent, []).append(child)
    reached, open_ends = {root}, [root]
    while open_ends:
        new = children.get(open_ends.pop(), [])
        reached.update(new)
        open_ends.extend(new)
    return reached
