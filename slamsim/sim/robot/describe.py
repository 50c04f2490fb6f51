"""Generates robot descriptions: from a configuration, reduced to the moving parts, and as URDF."""

from __future__ import annotations

from collections.abc import Sequence
from xml.sax.saxutils import quoteattr

import numpy as np

from slamsim.config.robot import CylinderConfig, RobotConfig, SensorBodyConfig
from slamsim.core.geometry import matrix_from_rpy, mount_transform, se3_from_parts
from slamsim.core.types import FloatArray
from slamsim.sim.robot.inertia import Inertial, join
from slamsim.sim.robot.urdf import Description, Joint, Link, LinkShape

AXIS_Y = np.array([0.0, 1.0, 0.0])
LYING = se3_from_parts(matrix_from_rpy(-np.pi / 2.0, 0.0, 0.0), np.zeros(3))
"""Turns a cylinder, whose axis is z, into a wheel about y."""


def translation(x_m: float, y_m: float, z_m: float) -> FloatArray:
    """4 x 4 shift."""
    return se3_from_parts(np.eye(3), np.array([x_m, y_m, z_m]))


def describe(config: RobotConfig) -> Description:
    """The robot of a configuration: base_footprint -> base_link -> wheels, bodies, sensors."""
    wheels, supports = config.drive_wheels, config.support_wheels
    T_base_link = translation(0.0, 0.0, wheels.radius_m)
    parts: list[tuple[Link, str, FloatArray]] = [
        (_upright("body_link", config.base), "fixed", _upright_place(config.base)),
        (_upright("plate_link", config.plate), "fixed", _upright_place(config.plate)),
        (_upright("weight_link", config.weight), "fixed", _upright_place(config.weight)),
        (_frame("imu_link"), "fixed", mount_transform(config.imu)),
        (_sensor("laser_link", config.lidar), "fixed", mount_transform(config.lidar.mount)),
        (_sensor("camera_link", config.camera), "fixed", mount_transform(config.camera.mount)),
    ]
    for side, y_m in (("left", 0.5 * wheels.track_m), ("right", -0.5 * wheels.track_m)):
        tyre = LinkShape("cylinder", (wheels.radius_m, wheels.width_m), LYING)
        # A ball touches the floor at one point, so that the distance between the points of
        # contact is the track exactly; the edges of a cylinder would share the load at random.
        contact = LinkShape("sphere", (wheels.radius_m,), np.eye(4))
        wheel = _solid(f"wheel_{side}_link", tyre, wheels.mass_kg, contact)
        parts.append((wheel, "continuous", translation(0.0, y_m, wheels.radius_m)))
    for end, x_m, gap_m in (
        ("front", supports.front_x_m, supports.front_gap_m),
        ("rear", supports.rear_x_m, supports.rear_gap_m),
    ):
        ball = LinkShape("sphere", (supports.radius_m,), np.eye(4))
        link = _solid(f"caster_{end}_link", ball, supports.mass_kg, ball)
        parts.append((link, "continuous", translation(x_m, 0.0, supports.radius_m + gap_m)))
    return _assemble(config.name, T_base_link, parts)


def _assemble(
    name: str, T_base_link: FloatArray, parts: Sequence[tuple[Link, str, FloatArray]]
) -> Description:
    links = {"base_footprint": _frame("base_footprint"), "base_link": _frame("base_link")}
    joints = [
        Joint("base_joint", "fixed", "base_footprint", "base_link", T_base_link, np.eye(3)[0])
    ]
    T_link_base = np.linalg.inv(T_base_link)
    for link, kind, T_base_part in parts:
        links[link.name] = link
        joint = link.name.removesuffix("_link") + "_joint"
        joints.append(Joint(joint, kind, "base_link", link.name, T_link_base @ T_base_part, AXIS_Y))
    return Description(name, "base_footprint", links, tuple(joints))


def _frame(name: str) -> Link:
    return Link(name, None, (), ())


def _solid(name: str, shape: LinkShape, mass_kg: float, contact: LinkShape) -> Link:
    body = Inertial(mass_kg, np.zeros(3), shape.solid_inertia(mass_kg))
    return Link(name, body.seen_from(shape.T_link_shape), (contact,), (shape,))


def _upright(name: str, config: CylinderConfig) -> Link:
    shape = LinkShape("cylinder", (config.radius_m, config.height_m), np.eye(4))
    return _solid(name, shape, config.mass_kg, shape)


def _upright_place(config: CylinderConfig) -> FloatArray:
    return translation(config.x_m, config.y_m, config.bottom_z_m + 0.5 * config.height_m)


def _sensor(name: str, config: SensorBodyConfig) -> Link:
    shape = LinkShape("box", config.size_m, translation(*config.body_centre_m))
    return _solid(name, shape, config.mass_kg, shape)


def weld_fixed_joints(description: Description) -> Description:
    """The same robot with every rigidly attached link made part of its carrier.

    Mass, centre and inertia are joined exactly; a frame without mass adds none. Physics
    engines put a body of 1 kg and 1 kg m^2 where they find none, and spend time on each link.
    """
    carrier = {description.root: (description.root, np.eye(4))}
    for joint in description.joints:
        owner, T_owner_parent = carrier[joint.parent]
        T_owner_child = T_owner_parent @ joint.T_parent_child
        moves = joint.kind != "fixed"
        carrier[joint.child] = (joint.child, np.eye(4)) if moves else (owner, T_owner_child)
    links = {
        owner: _weld(
            owner, [(description.links[n], T) for n, (o, T) in carrier.items() if o == owner]
        )
        for owner in dict.fromkeys(owner for owner, _ in carrier.values())
    }
    joints = tuple(
        Joint(
            joint.name,
            joint.kind,
            carrier[joint.parent][0],
            joint.child,
            carrier[joint.parent][1] @ joint.T_parent_child,
            joint.axis,
            joint.limits,
        )
        for joint in description.joints
        if joint.kind != "fixed"
    )
    return Description(description.name, description.root, links, joints)


def _weld(name: str, members: Sequence[tuple[Link, FloatArray]]) -> Link:
    bodies = [link.inertial.seen_from(T) for link, T in members if link.inertial is not None]
    shapes = {
        key: tuple(
            LinkShape(shape.kind, shape.size_m, T @ shape.T_link_shape)
            for link, T in members
            for shape in (link.collisions if key == "collision" else link.visuals)
        )
        for key in ("collision", "visual")
    }
    return Link(name, join(bodies) if bodies else None, shapes["collision"], shapes["visual"])


def urdf_text(description: Description) -> str:
    """URDF (https://wiki.ros.org/urdf/XML) of a description."""
    lines = ['<?xml version="1.0"?>', f"<robot name={quoteattr(description.name)}>"]
    for link in description.links.values():
        lines += _link_lines(link)
    for joint in description.joints:
        lines += _joint_lines(joint)
    return "\n".join([*lines, "</robot>", ""])


def _numbers(values: Sequence[float] | FloatArray) -> str:
    # Twelve digits keep every micrometre and hide the rounding of the arithmetic; adding zero
    # turns -0 into 0.
    return " ".join(f"{round(float(value), 12) + 0.0:.12g}" for value in values)


def _origin(T: FloatArray) -> str:
    return f'<origin xyz="{_numbers(T[:3, 3])}" rpy="{_numbers(rpy_from_matrix(T[:3, :3]))}"/>'


def rpy_from_matrix(rotation: FloatArray) -> FloatArray:
    """(roll, pitch, yaw) of matrix_from_rpy; at a pitch of +-90 degrees yaw is put to 0."""
    r = rotation
    pitch = np.arctan2(-r[2, 0], np.hypot(r[0, 0], r[1, 0]))
    if np.hypot(r[0, 0], r[1, 0]) < 1e-9:
        roll = np.arctan2(np.sign(pitch) * r[0, 1], r[1, 1])
        return np.array([roll, pitch, 0.0])
    return np.array([np.arctan2(r[2, 1], r[2, 2]), pitch, np.arctan2(r[1, 0], r[0, 0])])


def _shape_lines(tag: str, shape: LinkShape) -> list[str]:
    size = [_numbers([value]) for value in shape.size_m]
    geometry = {
        "box": lambda: f'<box size="{" ".join(size)}"/>',
        "cylinder": lambda: f'<cylinder radius="{size[0]}" length="{size[1]}"/>',
        "sphere": lambda: f'<sphere radius="{size[0]}"/>',
    }[shape.kind]()
    place = _origin(shape.T_link_shape)
    return [f"    <{tag}>{place}<geometry>{geometry}</geometry></{tag}>"]


def _link_lines(link: Link) -> list[str]:
    name = quoteattr(link.name)
    if link.inertial is None and not link.collisions and not link.visuals:
        return [f"  <link name={name}/>"]
    lines = [f"  <link name={name}>"]
    if link.inertial is not None:
        body = link.inertial
        # Moments of light parts are tiny: relative digits, not absolute ones.
        i = np.where(
            np.abs(body.inertia_kg_m2) < 1e-12 * np.abs(body.inertia_kg_m2).max(),
            0.0,
            body.inertia_kg_m2,
        )
        tensor = (
            f'ixx="{i[0, 0]:.12g}" ixy="{i[0, 1]:.12g}" ixz="{i[0, 2]:.12g}" '
            f'iyy="{i[1, 1]:.12g}" iyz="{i[1, 2]:.12g}" izz="{i[2, 2]:.12g}"'
        )
        place = _origin(translation(*body.centre_m))
        mass = f'<mass value="{body.mass_kg:.12g}"/>'
        lines += [f"    <inertial>{place}{mass}<inertia {tensor}/></inertial>"]
    for shape in link.visuals:
        lines += _shape_lines("visual", shape)
    for shape in link.collisions:
        lines += _shape_lines("collision", shape)
    return [*lines, "  </link>"]


def _joint_lines(joint: Joint) -> list[str]:
    lines = [
        f"  <joint name={quoteattr(joint.name)} type={quoteattr(joint.kind)}>",
        f"    {_origin(joint.T_parent_child)}",
        f"    <parent link={quoteattr(joint.parent)}/><child link={quoteattr(joint.child)}/>",
    ]
    if joint.kind != "fixed":
        lines.append(f'    <axis xyz="{_numbers(joint.axis)}"/>')
    if joint.limits is not None:
        low, high = (_numbers([value]) for value in joint.limits)
        lines.append(f'    <limit lower="{low}" upper="{high}" effort="1e4" velocity="1e3"/>')
    return [*lines, "  </joint>"]
