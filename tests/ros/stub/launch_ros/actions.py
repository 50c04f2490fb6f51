from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from launch.substitutions import LaunchConfiguration


@dataclass(kw_only=True)
class Node:
    """Without a package, executable is a program to be run."""

    executable: LaunchConfiguration
    arguments: Sequence[str]
    name: str
    output: str
    parameters: Sequence[Mapping[str, Any]]
    sigterm_timeout: str = "5"
