"""From a robot configuration, or a foreign description, to a checked model of the robot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slamsim.config.robot import MotorConfig, RobotConfig, SuspensionConfig
from slamsim.core.geometry import StaticTransform
from slamsim.core.types import FloatArray
from slamsim.guard.errors import InputRefused
from slamsim.guard.urdf import read_urdf
from slamsim.sim.robot.as_built import as_built_robot
from slamsim.sim.robot.describe import describe, urdf_text
from slamsim.sim.robot.urdf import Description, read_description
from slamsim.sim.robot.validate import model_faults

WHEEL_JOINTS = LEFT_WHEEL_JOINT, RIGHT_WHEEL_JOINT = "wheel_left_joint", "wheel_right_joint"
REQUIRED_FRAMES = ("base_footprint", "base_link", "laser_link", "imu_link", "camera_link")


@dataclass(frozen=True, slots=True, eq=False)
class RobotModel:
    """A robot that passed validation. base is base_footprint.

    urdf, description: the robot as it was designed, for others. body: as it is, for the physics.
    wheel_radius_m, track_m: as designed, which is what drivers believe. footprint_radius_m: of
    the smallest circle about the base's vertical axis that holds every contact shape. height_m:
    of the highest one. static_transforms: every rigid joint, from the root outwards.
    """

    name: str
    urdf: str
    description: Description
    body: Description
    footprint_radius_m: float
    height_m: float
    wheel_radius_m: float
    track_m: float
    T_base_laser: FloatArray
    T_base_imu: FloatArray
    static_transforms: tuple[StaticTransform, ...]
    motor: MotorConfig
    wheel_friction: float
    lateral_friction_ratio: float
    suspension: SuspensionConfig | None
    support_friction: float
    supports_roll: bool
    body_friction: float


def build_robot(config: RobotConfig) -> RobotModel:
    """The model of a configured robot; with ``urdf_file`` set, of that description.

    Raises InputRefused, naming every fault with its numbers, if the model is not sane.
    """
    if config.urdf_file is None:
        source = f"robot {config.name}"
        text = urdf_text(describe(config))
    else:
        source = config.urdf_file
        text, _ = read_urdf(Path(config.urdf_file))
    description = read_description(text, source)
    refuse_faulty(description, source, config.max_contact_gap_m)
    return _model(text, description, config)


def refuse_faulty(description: Description, source: str, max_gap_m: float) -> None:
    """Raises InputRefused with every fault of the model in one sentence each."""
    faults = [
        f"there is no link {name}" for name in REQUIRED_FRAMES if name not in description.links
    ]
    joints = {joint.name: joint for joint in description.joints}
    for name in WHEEL_JOINTS:
        if name not in joints:
            faults.append(f"there is no joint {name}")
        elif joints[name].kind != "continuous":
            faults.append(f"joint {name} is {joints[name].kind}, a driven wheel is continuous")
    if description.root != "base_footprint":
        faults.append(f"the root is {description.root}, it must be base_footprint")
    faults = faults or [fault.words for fault in model_faults(description, max_gap_m)]
    faults = faults or _wheel_faults(description)
    if faults:
        raise InputRefused(source, "; ".join(faults))


def _wheel_faults(description: Description) -> list[str]:
    left, right = _drive_wheel_centres(description)
    mirrored = left * np.array([1.0, -1.0, 1.0])
    if np.abs(mirrored - right).max() < 1e-4 and abs(left[0]) < 1e-4 and left[1] > 0.0:
        return []
    shown = [", ".join(f"{value:.4f}" for value in wheel) for wheel in (left, right)]
    return [
        "the drive wheels must stand mirrored on the y axis of base_footprint: the left one is at "
        f"({shown[0]}) m, the right one at ({shown[1]}) m"
    ]


def _drive_wheel_centres(description: Description) -> tuple[FloatArray, FloatArray]:
    placed = description.placements()
    child = {joint.name: joint.child for joint in description.joints}
    left, right = placed[child[LEFT_WHEEL_JOINT]], placed[child[RIGHT_WHEEL_JOINT]]
    return left[:3, 3], right[:3, 3]


def _outline(description: Description) -> tuple[float, float]:
    """(radius about the vertical axis, height) that hold every contact shape."""
    placed = description.placements()
    directions = np.radians(np.arange(0.0, 360.0, 1.0))
    radius_m = height_m = 0.0
    for name, link in description.links.items():
        for shape in link.collisions:
            T = placed[name]
            height_m = max(height_m, shape.reach_m(T, np.array([0.0, 0.0, 1.0])))
            for angle in directions:
                reach = shape.reach_m(T, np.array([np.cos(angle), np.sin(angle), 0.0]))
                radius_m = max(radius_m, reach)
    return radius_m, height_m


def _model(text: str, description: Description, config: RobotConfig) -> RobotModel:
    placed = description.placements()
    left, right = _drive_wheel_centres(description)
    radius_m, height_m = _outline(description)
    return RobotModel(
        name=description.name,
        urdf=text,
        description=description,
        body=as_built_robot(description, WHEEL_JOINTS, config.drive_wheels),
        footprint_radius_m=radius_m,
        height_m=height_m,
        wheel_radius_m=float(left[2]),
        track_m=float(left[1] - right[1]),
        T_base_laser=placed["laser_link"],
        T_base_imu=placed["imu_link"],
        static_transforms=tuple(
            StaticTransform(joint.parent, joint.child, joint.T_parent_child)
            for joint in description.joints
            if joint.kind == "fixed"
        ),
        motor=config.motor,
        wheel_friction=config.drive_wheels.friction,
        lateral_friction_ratio=config.drive_wheels.lateral_friction_ratio,
        suspension=config.drive_wheels.suspension,
        support_friction=config.support_wheels.friction,
        supports_roll=config.support_wheels.rolling,
        body_friction=config.body_friction,
    )
