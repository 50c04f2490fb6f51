"""``python -m slamsim.ros`` is the ROS 2 node; without ROS it says what is missing."""

from __future__ import annotations

import sys
from dataclasses import fields
from pathlib import Path

from slamsim.console.reporter import write_result
from slamsim.entry import run
from slamsim.guard.errors import NotFound, reason_of
from slamsim.ros.parameters import NodeParameters

LAUNCH_FILE = Path(__file__).with_name("slamsim.launch.py")


def main() -> None:
    """Entry point of the node."""
    run(_node)


def _node() -> None:
    if "--launch-file" in sys.argv:
        write_result(f"{LAUNCH_FILE}\n")
    elif {"-h", "--help"} & {*sys.argv}:
        write_result(_help())
    else:
        _require_ros()
        from slamsim.ros.node import run_node

        run_node(sys.argv)


def _help() -> str:
    rows = "".join(
        f"  {one.name:<14} {one.metadata['help']}"
        f"{f' ({str(one.default).lower()})' if one.default != '' else ''}\n"
        for one in fields(NodeParameters)
    )
    return (
        "Map a robot as a ROS 2 node: python -m slamsim.ros --ros-args -p scan_topic:=/scan\n"
        "With ros2 launch: ros2 launch $(python -m slamsim.ros --launch-file) scan_topic:=/scan\n"
        f"\nParameters:\n{rows}"
    )


def _require_ros() -> None:
    """Raises NotFound where rclpy is missing, or made for another Python."""
    setups = sorted(map(str, Path("/opt/ros").glob("*/setup.bash")))
    source = " or ".join(f"source {one}" for one in setups) or "source /opt/ros/<distro>/setup.bash"
    try:
        import rclpy  # noqa: F401
    except ModuleNotFoundError as error:
        if error.name != "rclpy":
            raise NotFound(_unusable(error)) from None
        raise NotFound(
            f"there is no ROS 2 here (no module rclpy): {source}, then start again"
        ) from None
    except ImportError as error:
        raise NotFound(_unusable(error)) from None


def _unusable(error: ImportError) -> str:
    version = ".".join(map(str, sys.version_info[:2]))
    return (
        f"rclpy cannot be loaded by this Python {version} ({reason_of(error)}): install slamsim "
        "for the Python that this release of ROS 2 is made for"
    )


if __name__ == "__main__":
    main()
