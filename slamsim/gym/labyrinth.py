"""A gymnasium environment: explore a world with the simulator's robot, lidar and wheels."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from slamsim.config.loading import load_run_config
from slamsim.config.run import RunConfig
from slamsim.core.geometry import yaw_from_xyzw
from slamsim.guard.errors import SlamsimError, shown
from slamsim.guard.numbers import require_finite
from slamsim.gym.seen import OCCUPIED, Seen
from slamsim.live.robot import LiveRobot, Window
from slamsim.sim.drive.drive_loop import BasePose
from slamsim.sim.drive.follow import Twist
from slamsim.sim.drive.pilot import STANDING
from slamsim.sim.robot.model import build_robot
from slamsim.simulation.header import log_header
from slamsim.world.build import build_world
from slamsim.world.model import World

Observation = dict[str, NDArray[Any]]
MOST_SEED = 2**31


class LabyrinthEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """Drive so that as much as possible is seen.

    Each step commands one twist and advances the physics by ``ticks_per_step`` control ticks
    (``drive.follow.control_rate_hz``, 40 Hz unless configured: 0.1 s). What the twist becomes is
    limited by ``drive.limits``, motors, friction and walls. The same seed and actions give the same
    bytes, however many environments a process has.

    Action: (2,) speed in m/s and yaw rate in rad/s.

    Observation: ``scan`` (beams,) the last whole scan in metres, with the lidar's errors; the
    largest range where nothing came back, 0 where it was too close to tell. It is there once its
    last beam is measured; a latency of messages is not simulated. ``odometry`` (5,) of the wheels
    as their driver publishes it: x, y, yaw in the frame of the start, speed, yaw rate. ``map``,
    only if ``map_cells`` are asked for: (cells, cells) about the robot, north up, 0 unknown, 1
    free, 2 occupied. It is drawn from the scans by the robot's TRUE poses, not by SLAM, which a
    real robot does not have.

    Reward: square metres of that map that a step saw first (of cells of ``mapping.resolution_m``),
    less ``contact_penalty`` if the robot touched a wall or a thing during the step.

    terminated: the robot tipped over or left the floor. truncated: after ``episode_s``.

    A new episode without a seed continues the random numbers of the last ``reset(seed=...)``. Its
    seed makes world and errors; ``reset(options={"world_seed": n})``, or ``world_seed`` for all
    episodes, makes the world alone, so that errors differ in one and the same labyrinth. A world
    file that names a seed of its own stays as it is.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012 - as in the base class

    def __init__(
        self,
        world: str | None = None,
        *,
        config: str = "labyrinth_gym",
        settings: Mapping[str, object] | None = None,
        world_seed: int | None = None,
        ticks_per_step: int = 4,
        episode_s: float = 120.0,
        map_cells: int = 0,
        contact_penalty: float = 0.1,
        render_mode: str | None = None,
    ) -> None:
        """world, config: names or paths, as of ``slamsim simulate``. settings: values by dotted
        key, as ``--set``. Raises SlamsimError for what is wrong with them."""
        overrides = [f"{key}={json.dumps(value)}" for key, value in (settings or {}).items()]
        self._config = load_run_config(world, config, overrides)
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise SlamsimError(f"render_mode is rgb_array or None, not {shown(render_mode)}")
        if ticks_per_step < 1 or map_cells < 0 or not episode_s > 0.0:
            raise SlamsimError("ticks_per_step and episode_s must be positive, map_cells not less")
        self.render_mode, self._map_cells = render_mode, map_cells
        self._world_seed, self._ticks, self._episode_s = world_seed, ticks_per_step, episode_s
        self._contact_penalty = contact_penalty
        self._model = build_robot(self._config.robot)
        self._header = log_header(self._model, self._config)
        self.action_space = _actions(self._config)
        self.observation_space = _observations(self._config, map_cells)
        self._driver = _Commanded()
        self._world: World | None = None
        self._robot: LiveRobot | None = None
        self._odometry = np.zeros(5, dtype=np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """The robot stands at the start until the first scan and odometry are there."""
        super().reset(seed=seed)
        drawn = int(self.np_random.integers(MOST_SEED))
        episode = drawn if seed is None else seed
        world_seed = _world_seed(options, episode if self._world_seed is None else self._world_seed)
        self.close()
        if self._world is None or self._world.seed != world_seed:
            self._world = build_world(self._config.world, world_seed)
        config = self._config.model_copy(update={"seed": episode})
        self._robot = LiveRobot(config, self._world, self._model, self._header)
        self._seen = Seen(config.mapping, config.sensors.lidar, self._model.T_base_laser)
        self._driver.twist, heard = STANDING, False
        while self._seen.scan is None or not heard:
            window = self._robot.advance(self._ticks, self._driver)
            heard |= self._take(window)
        return self._observation(), self._info(False)

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Raises BadNumbers for an action that is not two finite numbers."""
        robot = self._robot
        if robot is None:
            raise SlamsimError("reset the environment before its first step")
        twist = np.asarray(action, dtype=np.float64)
        require_finite("an action", twist, (2,))
        self._driver.twist = float(twist[0]), float(twist[1])
        before_m2 = self._seen.area_m2
        window = robot.advance(self._ticks, self._driver)
        self._take(window)
        touched = bool(window.drive.wall_contact.any())
        reward = self._seen.area_m2 - before_m2 - self._contact_penalty * touched
        late = robot.time_s >= self._episode_s
        return self._observation(), reward, bool(robot.ended), late, self._info(touched)

    def render(self) -> Any:
        """The map, the path and the robot, (height, width, 3) RGB; None without render_mode."""
        return None if self.render_mode is None or self._robot is None else self._seen.picture()

    def close(self) -> None:
        """End the physics."""
        robot, self._robot = self._robot, None
        if robot is not None:
            robot.close()

    def _take(self, window: Window) -> bool:
        """Whether odometry came with it."""
        self._seen.take(window)
        odometries = window.part.recording.odometries
        if not odometries:
            return False
        last = odometries[0]
        x_m, y_m = last.positions_m[-1, :2]
        yaw_rad = yaw_from_xyzw(last.quats_xyzw[-1:])[0]
        speed, turn = last.linear_m_s[-1, 0], last.angular_rad_s[-1, 2]
        self._odometry = np.array([x_m, y_m, yaw_rad, speed, turn], dtype=np.float32)
        return True

    def _observation(self) -> Observation:
        assert self._seen.scan is not None
        ranges_m = self._seen.scan.ranges_m
        farthest_m = np.float32(self._config.sensors.lidar.range_max_m)
        scan = np.where(np.isnan(ranges_m), np.float32(0.0), np.minimum(ranges_m, farthest_m))
        found: Observation = {"scan": scan, "odometry": self._odometry}
        if self._map_cells:
            found["map"] = self._seen.around(self._map_cells)
        return found

    def _info(self, touched: bool) -> dict[str, Any]:
        """pose: (3,) true x, y in metres and yaw, in the map frame."""
        assert self._robot is not None and self._world is not None
        return {
            "pose": self._seen.path[-1],
            "seen_m2": self._seen.area_m2,
            "touched": touched,
            "time_s": self._robot.time_s,
            "world_seed": self._world.seed,
            "ended": self._robot.ended,
        }


class _Commanded:
    """Drives as the last action says."""

    ended = ""

    def __init__(self) -> None:
        self.twist: Twist = STANDING

    def wanted(self, time_s: float, pose: BasePose) -> Twist:
        """See ``Driver``."""
        return self.twist


def _actions(config: RunConfig) -> Any:
    limits = config.drive.limits
    most = np.array([limits.max_speed_m_s, limits.max_yaw_rate_rad_s], dtype=np.float32)
    return spaces.Box(-most, most, dtype=np.float32)


def _observations(config: RunConfig, map_cells: int) -> Any:
    lidar = config.sensors.lidar
    if not lidar.enabled or not config.sensors.encoders.enabled:
        raise SlamsimError("the environment needs sensors.lidar and sensors.encoders enabled")
    parts: dict[str, spaces.Space[Any]] = {
        "scan": spaces.Box(0.0, lidar.range_max_m, (lidar.beam_count,), dtype=np.float32),
        "odometry": spaces.Box(-np.inf, np.inf, (5,), dtype=np.float32),
    }
    if map_cells:
        parts["map"] = spaces.Box(0, OCCUPIED, (map_cells, map_cells), dtype=np.uint8)
    return spaces.Dict(parts)


def _world_seed(options: Mapping[str, Any] | None, otherwise: int) -> int:
    given = dict(options or {})
    seed = given.pop("world_seed", otherwise)
    if given:
        raise SlamsimError(f"reset knows the option world_seed, not {shown(next(iter(given)))}")
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise SlamsimError(f"a world_seed is a whole number from 0, not {shown(seed)}")
    return int(seed)
