"""The as-built robot: the designed one with unequal wheels and springs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from slamsim.config.robot import (
    DriveWheelsConfig,
    RobotConfig,
    SuspensionConfig,
    VariationConfig,
)
from slamsim.core.randomness import random_stream
from slamsim.sim.robot.inertia import Inertial
from slamsim.sim.robot.urdf import Description, Joint, Link, LinkShape

CARRIER_SHARE = 0.1
"""Of a sprung wheel's mass belongs to what does not turn: PyBullet needs some mass between the
spring and the wheel."""
UPWARD = np.array([0.0, 0.0, 1.0])
"""The direction in which wheels are sprung."""
LARGEST_DEVIATION = 3.0
"""In sigmas: a worse robot would not leave the factory."""


def drawn_robot(config: RobotConfig, seed: int) -> RobotConfig:
    """The robot of one run: each varying quantity drawn from a random stream of its own.

    The variation of what is returned is zero, for it has been drawn.
    """

    def factor(name: str) -> float:
        sigma = float(getattr(config.variation, name))
        z = random_stream(seed, "robot", name).standard_normal()
        return float(np.exp(sigma * np.clip(z, -LARGEST_DEVIATION, LARGEST_DEVIATION)))

    return multiplied(config, {name: factor(name) for name in VariationConfig.model_fields})


def multiplied(config: RobotConfig, factors: Mapping[str, float]) -> RobotConfig:
    """The robot with each of these quantities of its variation so many times as large.

    Its own variation becomes zero. Quantities that are missing stay as they are.
    """

    def factor(name: str) -> float:
        return factors.get(name, 1.0)

    wheels, motor, supports = config.drive_wheels, config.motor, config.support_wheels
    gain, floor = factor("motor_gain"), factor("floor_friction")
    changed_wheels = {
        "radius_scale": wheels.radius_scale * factor("radius"),
        "radius_ratio": wheels.radius_ratio * factor("radius_ratio"),
        "track_scale": wheels.track_scale * factor("track"),
        "friction": wheels.friction * floor,
    }
    changed_motor = {
        "gear_friction_n_m": motor.gear_friction_n_m * factor("gear_friction"),
        "gear_friction_ratio": motor.gear_friction_ratio * factor("gear_friction_ratio"),
        "pid_proportional": motor.pid_proportional * gain,
        "pid_integral": motor.pid_integral * gain,
    }
    return config.model_copy(
        update={
            "drive_wheels": wheels.model_copy(update=changed_wheels),
            "motor": motor.model_copy(update=changed_motor),
            "support_wheels": supports.model_copy(update={"friction": supports.friction * floor}),
            "variation": VariationConfig(),
        }
    )


def as_built_robot(
    description: Description, wheel_joints: tuple[str, str], config: DriveWheelsConfig
) -> Description:
    """The description with the true radii and track, and with springs if it has any.

    wheel_joints: of the left and the right drive wheel, mirrored on the y axis of the root. A
    robot that is as designed is returned as it is.
    """
    designed_m = config.radius_m
    for name, radius_m in zip(wheel_joints, config.true_radii_m, strict=True):
        if radius_m != designed_m or config.track_scale != 1.0:
            description = _resized(description, name, radius_m / designed_m, config.track_scale)
        if config.suspension is not None:
            description = _sprung(description, name, config.suspension)
    return description


def _resized(description: Description, name: str, scale: float, track_scale: float) -> Description:
    """One wheel grown about its axle, which is raised so that it still touches the floor."""
    joint = next(joint for joint in description.joints if joint.name == name)
    placed = description.placements()
    T_root_wheel = placed[joint.child].copy()
    T_root_wheel[1:3, 3] *= track_scale, scale
    T_parent_child = np.linalg.inv(placed[joint.parent]) @ T_root_wheel
    wheel = _grown(description.links[joint.child], scale)
    return replace(
        description,
        links={**description.links, wheel.name: wheel},
        joints=tuple(
            replace(other, T_parent_child=T_parent_child) if other is joint else other
            for other in description.joints
        ),
    )


def _grown(wheel: Link, scale: float) -> Link:
    """As wide as before: only the radius of its shapes grows, and the inertia with its square."""

    def shape(old: LinkShape) -> LinkShape:
        return replace(old, size_m=(old.size_m[0] * scale, *old.size_m[1:]))

    body = wheel.inertial
    return Link(
        wheel.name,
        body and Inertial(body.mass_kg, body.centre_m, body.inertia_kg_m2 * scale**2),
        tuple(shape(old) for old in wheel.collisions),
        tuple(shape(old) for old in wheel.visuals),
    )


def _sprung(description: Description, name: str, spring: SuspensionConfig) -> Description:
    """One wheel on a carrier that slides along z; its zero is where the robot stands level."""
    joint = next(joint for joint in description.joints if joint.name == name)
    wheel = description.links[joint.child]
    assert wheel.inertial is not None
    carrier = Link(spring_link(name), _share(wheel.inertial, CARRIER_SHARE), (), ())
    lightened = replace(wheel, inertial=_share(wheel.inertial, 1.0 - CARRIER_SHARE))
    slide = Joint(
        spring_joint(name),
        "prismatic",
        joint.parent,
        carrier.name,
        joint.T_parent_child,
        description.placements()[joint.child][:3, :3].T @ UPWARD,
        (-spring.travel_m, spring.travel_m),
    )
    turning = replace(joint, parent=carrier.name, T_parent_child=np.eye(4))
    at = description.joints.index(joint)
    return replace(
        description,
        links={**description.links, wheel.name: lightened, carrier.name: carrier},
        joints=(*description.joints[:at], slide, turning, *description.joints[at + 1 :]),
    )


def _share(body: Inertial, share: float) -> Inertial:
    return Inertial(share * body.mass_kg, body.centre_m, share * body.inertia_kg_m2)


def spring_joint(wheel_joint: str) -> str:
    """Name of the sliding joint that carries a wheel's joint."""
    return wheel_joint.removesuffix("_joint") + "_spring_joint"


def spring_link(wheel_joint: str) -> str:
    """Name of what slides."""
    return wheel_joint.removesuffix("_joint") + "_spring_link"
