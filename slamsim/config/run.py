"""Configuration of one run: everything that its result depends on."""

from __future__ import annotations

from pydantic import Field

from slamsim.config.base import Config
from slamsim.config.drive import DriveConfig
from slamsim.config.faults import FaultChoices
from slamsim.config.kinds import Sinks
from slamsim.config.robot import RobotConfig
from slamsim.config.sensors import SensorsConfig
from slamsim.config.slam import MappingConfig, SlamConfig
from slamsim.config.world import WorldConfig


class RunConfig(Config):
    """One run, from the world to the map; saved in full beside its results."""

    seed: int = Field(default=0, ge=0, lt=2**63)
    """All that is random in the run grows from this number."""
    world: WorldConfig = WorldConfig()
    """Where the robot drives."""
    robot: RobotConfig = RobotConfig()
    """What drives."""
    drive: DriveConfig = DriveConfig()
    """How and where to it drives, and the physics."""
    sensors: SensorsConfig = SensorsConfig()
    """What it measures, and with which errors."""
    faults: FaultChoices = ()
    """What is wrong with the recording on purpose, as ``slamsim fault --list`` has it."""
    sinks: Sinks = Field(default=(), strict=False)
    """Where the messages go besides the recording, each an entry with a type, while it is made."""
    slam: SlamConfig = SlamConfig()
    """How the recording becomes a trajectory."""
    mapping: MappingConfig = MappingConfig()
    """How the trajectory becomes a map."""
