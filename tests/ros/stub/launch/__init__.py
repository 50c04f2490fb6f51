"""What slamsim's launch file uses of https://github.com/ros2/launch, to be looked at."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass
class LaunchDescription:
    entities: list[Any]
