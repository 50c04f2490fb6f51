"""The robot inside the physics engine: its wheels, tyres, supports and springs.

PyBullet multiplies the friction coefficients of two touching bodies. The ground body therefore
has friction 1 and each wheel carries the product of its own coefficient and that of the floor
under it; it is changed when the wheel rolls onto a patch, so that a patch has no edge to bump
into and its border is exact to a control step.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from slamsim.config.robot import SuspensionConfig
from slamsim.core.geometry import matrix_from_xyzw, se3_from_parts
from slamsim.core.types import FloatArray
from slamsim.guard.errors import SlamsimError
from slamsim.sim.bullet import pybullet
from slamsim.sim.robot.as_built import spring_joint, spring_link
from slamsim.sim.robot.describe import urdf_text, weld_fixed_joints
from slamsim.sim.robot.model import WHEEL_JOINTS, RobotModel
from slamsim.sim.robot.urdf import Description
from slamsim.sim.robot.validate import rolling_links

STABLE_SHARE = 0.8
"""Of the limit beyond which an explicit spring and damper swing up."""


class Springs:
    """Force along each sliding joint: preload, less stiffness times the way that it went down.

    joints: left and right, their position counts upward, into the body, from where the robot
    stands level. The travel ends at the joint's own limits.
    """

    def __init__(
        self, client: int, body: int, joints: tuple[int, int], config: SuspensionConfig
    ) -> None:
        self._client, self._body, self._joints = client, body, joints
        self._preload_n, self._stiffness_n_m = config.preload_n, config.stiffness_n_m
        self._damping_n_s_m = config.damping_n_s_m

    def step(self) -> None:
        """Push, then one step of the physics."""
        states = pybullet.getJointStates(self._body, self._joints, self._client)
        pybullet.setJointMotorControlArray(
            self._body,
            self._joints,
            pybullet.TORQUE_CONTROL,
            forces=[self._force_n(state[0], state[1]) for state in states],
            physicsClientId=self._client,
        )
        pybullet.stepSimulation(self._client)

    def _force_n(self, up_m: float, up_m_s: float) -> float:
        """On the wheel, upward: the spring pushes it down and never pulls."""
        spring_n = max(self._preload_n + self._stiffness_n_m * up_m, 0.0)
        return -spring_n - self._damping_n_s_m * up_m_s


def refuse_unstable(config: SuspensionConfig, carried_kg: float, step_s: float) -> None:
    """Raises SlamsimError for springs that are too hard for the time step.

    carried_kg: of one wheel and its carrier, which swing on the spring when off the floor. The
    force is that of the step's beginning, the position that of its end: such an integration is
    stable while stiffness h^2 + 2 damping h < 4 mass.
    """
    needed_kg = 0.25 * (config.stiffness_n_m * step_s + 2.0 * config.damping_n_s_m) * step_s
    if needed_kg > STABLE_SHARE * carried_kg:
        raise SlamsimError(
            f"a suspension of {config.stiffness_n_m:g} N/m and {config.damping_n_s_m:g} N s/m is "
            f"too hard for a wheel of {carried_kg:g} kg at {1.0 / step_s:g} steps per second: "
            f"raise physics.rate_hz or make it softer"
        )


BODY_CONTACT_M = 0.001
"""The body's contacts further apart than this, which the engine's reach finds, are not solved."""


@dataclass(frozen=True, slots=True)
class WheelContact:
    """A wheel on the floor: its link index, its place on the robot, its own coefficient."""

    link: int
    x_m: float
    y_m: float
    friction: float


@dataclass(frozen=True, slots=True, eq=False)
class Engine:
    """Handles of a running PyBullet world. T_base_com: 4 x 4, the frame PyBullet reports.

    step: one time step of the physics.
    """

    client: int
    body: int
    walls: tuple[int, ...]
    wheels: tuple[int, int]
    feet: tuple[WheelContact, ...]
    T_base_com: FloatArray
    step: Callable[[], None]


def load_robot(
    client: int, walls: tuple[int, ...], robot: RobotModel, start_pose: FloatArray, step_s: float
) -> Engine:
    """The robot at (x, y, yaw) in a client's world that has a ground and walls already.

    Raises SlamsimError for springs that the time step cannot follow.
    """
    return _prepare(client, _load_body(client, robot, start_pose), walls, robot, step_s)


def _load_body(client: int, robot: RobotModel, start_pose: FloatArray) -> int:
    """The reduced robot at (x, y, yaw); PyBullet reads descriptions from files only."""
    x_m, y_m, yaw_rad = (float(value) for value in start_pose)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.urdf"
        path.write_text(urdf_text(_reduced(robot)), encoding="utf-8")
        return int(
            pybullet.loadURDF(
                str(path),
                basePosition=(x_m, y_m, 0.0),
                baseOrientation=pybullet.getQuaternionFromEuler((0.0, 0.0, yaw_rad)),
                # Without these flags PyBullet makes up the inertia and turns cylinders into
                # prisms of 32 sides.
                flags=pybullet.URDF_USE_INERTIA_FROM_FILE | pybullet.URDF_USE_IMPLICIT_CYLINDER,
                physicsClientId=client,
            )
        )


def _reduced(robot: RobotModel) -> Description:
    """What can move, or has a friction of its own: supports that do not roll are links that are
    fixed, for a motor that holds so light a ball would converge slowly."""
    welded = weld_fixed_joints(robot.body)
    if robot.supports_roll:
        return welded
    supports = set(rolling_links(robot.body)) - {
        joint.child for joint in robot.body.joints if joint.name in WHEEL_JOINTS
    }
    joints = (replace(j, kind="fixed") if j.child in supports else j for j in welded.joints)
    return replace(welded, joints=tuple(joints))


def _prepare(
    client: int, body: int, walls: tuple[int, ...], robot: RobotModel, step_s: float
) -> Engine:
    """Free the joints of PyBullet's own motors and the links of its damping."""
    free = {"linearDamping": 0.0, "angularDamping": 0.0, "jointDamping": 0.0, "restitution": 0.0}
    pybullet.changeDynamics(
        body,
        -1,
        lateralFriction=robot.body_friction,
        contactProcessingThreshold=BODY_CONTACT_M,
        physicsClientId=client,
        **free,
    )
    joint_index, link_index = dict[str, int](), dict[str, int]()
    for index in range(pybullet.getNumJoints(body, client)):
        info = pybullet.getJointInfo(body, index, client)
        joint_index[info[1].decode()], link_index[info[12].decode()] = index, index
        pybullet.setJointMotorControl2(
            body, index, pybullet.VELOCITY_CONTROL, force=0.0, physicsClientId=client
        )
        pybullet.changeDynamics(body, index, physicsClientId=client, **free)
    left, right = (joint_index[name] for name in WHEEL_JOINTS)
    wheels = left, right
    feet = _feet(robot, link_index, wheels)
    _fit_wheels(client, body, robot, wheels)
    centre_m, quat_xyzw = pybullet.getDynamicsInfo(body, -1, client)[3:5]
    T_base_com = se3_from_parts(matrix_from_xyzw(np.array(quat_xyzw)), np.array(centre_m))
    step = _step(client, body, robot, joint_index, step_s)
    return Engine(client, body, walls, wheels, feet, T_base_com, step)


def _feet(
    robot: RobotModel, link_index: dict[str, int], wheels: tuple[int, int]
) -> tuple[WheelContact, ...]:
    placed = robot.body.placements()
    return tuple(
        WheelContact(
            link=link_index[name],
            x_m=float(placed[name][0, 3]),
            y_m=float(placed[name][1, 3]),
            friction=robot.wheel_friction if link_index[name] in wheels else robot.support_friction,
        )
        for name in rolling_links(robot.body)
    )


def _fit_wheels(client: int, body: int, robot: RobotModel, wheels: tuple[int, int]) -> None:
    """Tyres that grip differently across their direction; rotors.

    A rotor adds inertia about the axle alone: no solid body is like that, so no description can
    say it.
    """
    for wheel in wheels:
        moments, _, quat_xyzw = pybullet.getDynamicsInfo(body, wheel, client)[2:5]
        axis = np.array(pybullet.getJointInfo(body, wheel, client)[13])
        axle = int(np.argmax(np.abs(matrix_from_xyzw(np.array(quat_xyzw)).T @ axis)))
        if robot.lateral_friction_ratio != 1.0:
            grip = [robot.lateral_friction_ratio if i == axle else 1.0 for i in range(3)]
            pybullet.changeDynamics(body, wheel, anisotropicFriction=grip, physicsClientId=client)
        if robot.motor.rotor_inertia_kg_m2 > 0.0:
            turned = list(moments)
            turned[axle] += robot.motor.rotor_inertia_kg_m2
            pybullet.changeDynamics(
                body, wheel, localInertiaDiagonal=turned, physicsClientId=client
            )


def _step(
    client: int, body: int, robot: RobotModel, joint_index: dict[str, int], step_s: float
) -> Callable[[], None]:
    """One step of the physics, with springs where the robot has any."""
    if robot.suspension is None:
        return partial(pybullet.stepSimulation, client)
    left, right = (joint_index[spring_joint(name)] for name in WHEEL_JOINTS)
    for name in WHEEL_JOINTS:
        child = next(joint.child for joint in robot.body.joints if joint.name == name)
        parts = [robot.body.links[link].inertial for link in (child, spring_link(name))]
        refuse_unstable(robot.suspension, sum(part.mass_kg for part in parts if part), step_s)
    return Springs(client, body, (left, right), robot.suspension).step


def set_floor_friction(engine: Engine, friction: float) -> None:
    """The floor under every wheel."""
    for foot in engine.feet:
        set_foot_friction(engine, foot, friction)


def set_wheel_friction(engine: Engine, left: float, right: float) -> None:
    """The floor under each drive wheel."""
    for foot in engine.feet:
        if foot.link in engine.wheels:
            set_foot_friction(engine, foot, left if foot.link == engine.wheels[0] else right)


def set_foot_friction(engine: Engine, foot: WheelContact, friction: float) -> None:
    """The floor under one wheel."""
    pybullet.changeDynamics(
        engine.body,
        foot.link,
        lateralFriction=foot.friction * friction,
        physicsClientId=engine.client,
    )


def hold_wheels(
    engine: Engine, speeds_rad_s: tuple[float, float], torques_n_m: tuple[float, float]
) -> None:
    """Velocity motors on (left, right) with a largest torque each."""
    pybullet.setJointMotorControlArray(
        engine.body,
        engine.wheels,
        pybullet.VELOCITY_CONTROL,
        targetVelocities=speeds_rad_s,
        forces=torques_n_m,
        physicsClientId=engine.client,
    )
