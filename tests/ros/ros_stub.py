"""rclpy is the stub of this folder here, also where ROS 2 is installed; a robot of it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from rclpy.node import Node

STUB = Path(__file__).parent / "stub"
STUBBED = {path.stem for path in STUB.iterdir()} | {
    *("sensor_msgs", "nav_msgs", "tf2_msgs", "diagnostic_msgs", "std_msgs", "rosgraph_msgs"),
    *("half_built_msgs", "slamsim.ros"),
}


def forget() -> None:
    for name in [*sys.modules]:
        if any(name == one or name.startswith(f"{one}.") for one in STUBBED):
            del sys.modules[name]


@pytest.fixture(autouse=True)
def stub(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Fresh in each test: a context, and a graph without nodes."""
    monkeypatch.syspath_prepend(STUB)
    forget()
    yield
    forget()


TIMEOUT_S = 30.0


def node(name: str, *arguments: str) -> Node:
    import rclpy
    from rclpy.context import Context

    context = Context()
    context.init(["--ros-args", *arguments])
    return rclpy.create_node(name, context=context)


def quality(reliable: bool, kept: bool, depth: int = 10) -> Any:
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if kept else DurabilityPolicy.VOLATILE,
    )


def message_type(kind: str) -> Any:
    package, folder, name = kind.split("/")
    return getattr(import_module(f"{package}.{folder}"), name)


def publisher(
    robot: Node, topic: str, kind: str, *, reliable: bool = True, kept: bool = False
) -> Any:
    return robot.create_publisher(message_type(kind), topic, quality(reliable, kept))
