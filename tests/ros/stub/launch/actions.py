from __future__ import annotations

from dataclasses import dataclass


@dataclass
class DeclareLaunchArgument:
    name: str
    default_value: str | None = None
    description: str | None = None
