from __future__ import annotations

from collections.abc import Sequence


def remove_ros_args(args: Sequence[str]) -> list[str]:
    """Those from ``--ros-args`` to the end, or to ``--``, are ROS's."""
    kept, is_ros = [], False
    for word in args:
        if word == "--ros-args":
            is_ros = True
        elif is_ros and word == "--":
            is_ros = False
        elif not is_ros:
            kept.append(word)
    return kept
