"""What clients of any protocol may ask: topics that they publish, and services.

Messages are nested mappings with the fields of their ROS definitions, whatever carried them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from slamsim.guard.errors import SlamsimError, shown
from slamsim.guard.numbers import BadNumbers
from slamsim.live.controls import Controls

Fields = Mapping[str, object]

STEP_S = 0.1
"""What /slamsim/step lets pass where no ``seconds`` are given: std_srvs/Trigger has no room for
them, but rosbridge carries any field."""

MAP_FRAMES = ("", "map", "/map")
"""Of goals; one without a frame means the map."""


@dataclass(frozen=True, slots=True)
class Service:
    """type_name: in ROS 2. call: does it and tells what was done; raises SlamsimError."""

    type_name: str
    call: Callable[[Controls, Fields], str]


def publish(controls: Controls, topic: str, type_name: str, message: Fields) -> None:
    """Obey a message of a client on one of ``SUBSCRIBED``.

    Raises SlamsimError for what cannot be obeyed, BadNumbers for what is no such message.
    """
    if topic == "/cmd_vel":
        twist = _part(message, "twist") if type_name.endswith("TwistStamped") else message
        speed = _number(twist, "linear", "x")
        controls.drive(speed, _number(twist, "angular", "z"))
    else:
        _go_to(controls, message)


SUBSCRIBED: Mapping[str, tuple[str, ...]] = {
    "/cmd_vel": ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"),
    "/goal_pose": ("geometry_msgs/msg/PoseStamped",),
    "/move_base_simple/goal": ("geometry_msgs/msg/PoseStamped",),
}
"""Topics that clients may publish, and the types of their messages."""


def _go_to(controls: Controls, message: Fields) -> None:
    frame = _part(message, "header").get("frame_id", "")
    if frame not in MAP_FRAMES:
        raise BadNumbers(f"a goal is a place of the frame map, not of {shown(frame)}")
    pose = _part(message, "pose")
    x_m, y_m = (_number(pose, "position", axis) for axis in "xy")
    qx, qy, qz, qw = (_number(pose, "orientation", axis) for axis in "xyzw")
    turned = (qx, qy, qz, qw) != (0.0, 0.0, 0.0, 0.0)  # a message that sets none means any
    yaw_rad = math.atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))
    controls.go_to(x_m, y_m, yaw_rad if turned else None)


def _number(message: Fields, *place: str) -> float:
    """Zero where it is not given, as in a ROS message that was not filled."""
    for name in place[:-1]:
        message = _part(message, name)
    value = message.get(place[-1], 0.0)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise BadNumbers(f"{'.'.join(place)} must be a number, not {shown(value)}")
    try:
        return float(value)
    except OverflowError:
        raise BadNumbers(f"{'.'.join(place)} is too large: {shown(value)}") from None


def _part(message: Fields, name: str) -> Fields:
    value = message.get(name, {})
    if not isinstance(value, Mapping):
        raise BadNumbers(f"{name} must hold fields, not be {shown(value)}")
    return value


def _reset(controls: Controls, request: Fields) -> str:
    controls.reset()
    return "the drive begins anew"


def _save_map(controls: Controls, request: Fields) -> str:
    return f"the map is in {controls.save_map()}"


def _step(controls: Controls, request: Fields) -> str:
    if not controls.status().paused:
        raise SlamsimError("a step is for a paused robot; set /slamsim/paused first")
    seconds = _number(request, "seconds") if "seconds" in request else STEP_S
    controls.step(seconds)
    return f"{seconds:g} s passed"


def _pause(controls: Controls, request: Fields) -> str:
    controls.pause(True)
    return "time stands still"


def _resume(controls: Controls, request: Fields) -> str:
    controls.pause(False)
    return "time goes on"


def _record(controls: Controls, request: Fields) -> str:
    on = request.get("data", False)
    if not isinstance(on, bool):
        raise BadNumbers(f"data must be true or false, not {shown(on)}")
    folder = controls.record(on)
    if on:
        return f"recording into {folder}"
    return "nothing was being recorded" if folder is None else f"the recording is in {folder}"


TRIGGER, SET_BOOL = "std_srvs/srv/Trigger", "std_srvs/srv/SetBool"
SERVICES: Mapping[str, Service] = {
    "/slamsim/reset": Service(TRIGGER, _reset),
    "/slamsim/save_map": Service(TRIGGER, _save_map),
    "/slamsim/pause": Service(TRIGGER, _pause),
    "/slamsim/resume": Service(TRIGGER, _resume),
    "/slamsim/step": Service(TRIGGER, _step),
    "/slamsim/record": Service(SET_BOOL, _record),
}
"""Their responses have the fields ``success`` and ``message``."""
