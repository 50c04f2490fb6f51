"""The springs of the drive wheels, pushed anew before each physics step."""

from __future__ import annotations

from slamsim.config.robot import SuspensionConfig
from slamsim.guard.errors import SlamsimError
from slamsim.sim.bullet import pybullet

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
