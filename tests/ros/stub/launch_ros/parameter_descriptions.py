from __future__ import annotations

from dataclasses import dataclass

from launch.substitutions import LaunchConfiguration


@dataclass
class ParameterValue:
    value: LaunchConfiguration
    value_type: type
