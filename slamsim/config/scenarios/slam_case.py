"""The study's SLAM case: a small labyrinth, and what went wrong with it."""

from __future__ import annotations

from pydantic import Field

from slamsim.config.base import Config
from slamsim.config.drive import DriveConfig, RouteConfig
from slamsim.config.layout import MazeLayout
from slamsim.config.lidar import LidarConfig
from slamsim.config.robot import RobotConfig
from slamsim.config.sensors import SensorsConfig
from slamsim.config.slam import MappingConfig, SlamConfig
from slamsim.config.world import WorldConfig


class SlamCaseConfig(Config):
    """One drive through a labyrinth, recorded rightly and wrongly."""

    delay_s: float = Field(default=0.1, gt=0.0, le=1.0)
    """How late the scans are stamped where the clock is bypassed; no stream tells of it."""
    world: WorldConfig = WorldConfig(name="study_labyrinth", maze=MazeLayout(rows=4, columns=4))
    """Where the robot drives."""
    robot: RobotConfig = RobotConfig()
    """What drives."""
    drive: DriveConfig = DriveConfig(route=RouteConfig(max_duration_s=60.0))
    """How it drives, and the physics."""
    sensors: SensorsConfig = SensorsConfig(lidar=LidarConfig(rate_hz=10.0))
    """What it measures."""
    slam: SlamConfig = SlamConfig()
    """How the recording becomes a trajectory."""
    mapping: MappingConfig = MappingConfig()
    """How the trajectory becomes a map."""
