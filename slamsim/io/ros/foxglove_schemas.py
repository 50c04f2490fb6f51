"""Messages in the schemas of Foxglove (``foxglove.LaserScan``), as programs with its SDK write
them, turned into the ROS messages that say the same.

Schemas: github.com/foxglove/foxglove-sdk, folder schemas; encoded as Protocol Buffers or JSON.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from slamsim.guard.errors import Excessive
from slamsim.guard.limits import LIMITS
from slamsim.io.ros.values import WrongMessage, cdr_of
from slamsim.recording.schemas import TRANSFORMS

_POINT_FIELDS = (0, 2, 1, 4, 3, 6, 5, 7, 8)
"""The number that sensor_msgs/PointField has for each of PackedElementField.NumericType."""

_FIXED_BYTES, _MOST_BITS = {1: 8, 5: 4}, 64
_ROUNDED = 1e-6
"""Metres, or of a quaternion: what rounding to single precision leaves of nothing."""

Values = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Translation:
    """How the messages of one channel become those of ``type_name``.

    schema_name, encoding, schema: as the channel is declared.
    """

    schema_name: str
    encoding: str
    schema: bytes

    @property
    def type_name(self) -> str:
        """Of ROS."""
        return _KINDS[self.schema_name][0]

    def cdr(self, data: bytes) -> bytes:
        """One message as ROS 2 serialises it.

        Raises ValueError and what the libraries raise for one that is damaged, or says what has
        no place in ROS.
        """
        type_name, values = _KINDS[self.schema_name]
        try:
            if self.encoding == "json":
                _require_few(data.count(b"{"))
                message = _parsed_json(data)
            else:
                _require_few(_fields_in(data))
                message = _message_class(self.schema_name, self.schema).FromString(data)
            return cdr_of(type_name, values(message), 0)
        except AttributeError as error:
            raise ValueError(f"a {self.schema_name} without {error.name!r}") from None
        except WrongMessage as error:
            raise ValueError(str(error)) from None


def translation(schema_name: str, encoding: str, schema: bytes) -> Translation | None:
    """For a channel that is declared so; None where it is not read.

    encoding: of its messages.
    """
    known = schema_name in _KINDS and encoding in ("protobuf", "json")
    return Translation(schema_name, encoding, schema) if known else None


@lru_cache(maxsize=64)
def _message_class(schema_name: str, schema: bytes) -> Any:
    """schema: a FileDescriptorSet. Raises ValueError for one that does not hold the name."""
    from google.protobuf import descriptor_pb2, message_factory
    from google.protobuf.message import DecodeError

    if len(schema) > LIMITS.bag_definition_characters:
        raise Excessive(f"a schema of {len(schema):,} bytes", "bag_definition_characters")
    try:
        files = descriptor_pb2.FileDescriptorSet.FromString(schema).file
        return message_factory.GetMessages(list(files))[schema_name]  # in whatever order they are
    except (DecodeError, KeyError, TypeError) as error:
        raise ValueError(f"the schema of {schema_name} is damaged: {error}") from None


def _require_few(parts: int) -> None:
    """A part that takes two bytes in a message takes thousands once it is read."""
    most = LIMITS.bag_array_elements
    if parts > most:
        raise Excessive(f"a message of more than {most:,} parts", "bag_array_elements")


def _fields_in(data: bytes) -> int:
    """How many fields of Protocol Buffers follow each other, counted until they are too many.

    Raises ValueError for what is none, and IndexError where they are cut off.
    """
    at = count = 0
    while at < len(data) and count <= LIMITS.bag_array_elements:
        tag, at = _varint(data, at)
        kind = tag & 7
        if kind == 0:
            _, at = _varint(data, at)
        elif kind == 2:
            size, at = _varint(data, at)
            at += size
        elif kind in _FIXED_BYTES:
            at += _FIXED_BYTES[kind]
        else:
            raise ValueError("no message of Protocol Buffers")
        count += 1
    return count


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """(number, where it ends)"""
    value = shift = 0
    while data[at] & 0x80:
        value |= (data[at] & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if shift > _MOST_BITS:  # or a number of millions of digits would be made, digit by digit
            raise ValueError("no message of Protocol Buffers")
    return value | data[at] << shift, at + 1


def _parsed_json(data: bytes) -> Any:
    return json.loads(data, object_hook=lambda values: SimpleNamespace(**values))


def _time(stamp: Any) -> Values:
    if isinstance(stamp, SimpleNamespace):  # JSON
        return {"sec": stamp.sec, "nanosec": stamp.nsec}
    return {"sec": stamp.seconds, "nanosec": stamp.nanos}


def _header(message: Any) -> Values:
    return {"stamp": _time(message.timestamp), "frame_id": message.frame_id}


def _vector(vector: Any) -> Values:
    return {axis: getattr(vector, axis) for axis in "xyz"}


def _rotation(quaternion: Any) -> Values:
    """None at all is none: a program that leaves it out turns nothing."""
    values = {axis: getattr(quaternion, axis) for axis in "xyzw"}
    return values if any(values.values()) else {**values, "w": 1.0}


def _floats(values: Any) -> Any:
    """JSON has null for what is not finite."""
    return np.array(values, dtype=np.float64)


def _told(message: Any, name: str) -> Any:
    """An optional field, None where it is left out."""
    is_there = isinstance(message, SimpleNamespace) or message.HasField(name)
    return getattr(message, name, None) if is_there else None


def _yaw_rad(pose: Any) -> float:
    """By how much data are turned about z in their frame: no message of ROS has a place for more of
    a pose. Raises ValueError for more."""
    turned = _rotation(pose.orientation)
    tilt = math.hypot(turned["x"], turned["y"])
    if max(tilt, *(abs(each) for each in _vector(pose.position).values())) > _ROUNDED:
        raise ValueError("it has a pose in its frame; put that into a transform instead")
    return math.remainder(2.0 * math.atan2(turned["z"], turned["w"]), 2.0 * math.pi)


def _laser_scan(message: Any) -> Values:
    """Neither the lidar's limits nor the times of its beams are known."""
    ranges_m = _floats(message.ranges)
    yaw_rad = _yaw_rad(message.pose)
    span_rad = message.end_angle - message.start_angle
    return {
        "header": _header(message),
        "angle_min": message.start_angle + yaw_rad,
        "angle_max": message.end_angle + yaw_rad,
        "angle_increment": span_rad / max(ranges_m.size - 1, 1),
        "range_max": math.inf,
        "ranges": ranges_m,
        "intensities": _floats(message.intensities),
    }


def _odometry(message: Any) -> Values:
    pose: Values = {"pose": _pose(message.pose)}
    speeds = {kind: _told(message, f"{kind}_velocity") for kind in ("linear", "angular")}
    told = {kind: _vector(speed) for kind, speed in speeds.items() if speed is not None}
    twist: Values = {"twist": told}
    for values, name in ((pose, "pose"), (twist, "velocity")):
        covariance = getattr(message, f"{name}_covariance", None)
        if covariance is not None and len(covariance):
            values["covariance"] = _floats(covariance)
    return {
        "header": _header(message),
        "child_frame_id": message.body_frame_id,
        "pose": pose,
        "twist": twist,
    }


def _pose(pose: Any) -> Values:
    return {"position": _vector(pose.position), "orientation": _rotation(pose.orientation)}


def _transform(message: Any) -> Values:
    return {
        "header": {"stamp": _time(message.timestamp), "frame_id": message.parent_frame_id},
        "child_frame_id": message.child_frame_id,
        "transform": {
            "translation": _vector(message.translation),
            "rotation": _rotation(message.rotation),
        },
    }


def _joints(message: Any) -> Values:
    joints = list(message.joints)
    return {
        "header": {"stamp": _time(message.timestamp)},
        "name": [each.name for each in joints],
        **{name: _of_joints(joints, name) for name in ("position", "velocity", "effort")},
    }


def _of_joints(joints: list[Any], name: str) -> Any:
    """Empty where no joint tells it, as in ROS; nan of those that do not."""
    values = [_told(each, name) for each in joints]
    return _floats([] if all(value is None for value in values) else values)


def _image(message: Any) -> Values:
    sizes = {name: getattr(message, name) for name in ("height", "width", "step", "encoding")}
    return {"header": _header(message), **sizes, "data": message.data}


def _compressed_image(message: Any) -> Values:
    return {"header": _header(message), "format": message.format, "data": message.data}


def _camera_info(message: Any) -> Values:
    matrices = {name: _floats(getattr(message, name.upper())) for name in "dkrp"}
    return {
        "header": _header(message),
        "height": message.height,
        "width": message.width,
        "distortion_model": message.distortion_model,
        **{name: values for name, values in matrices.items() if values.size},
    }


def _cloud(message: Any) -> Values:
    if abs(_yaw_rad(message.pose)) > _ROUNDED:
        raise ValueError("it is turned in its frame; put that into a transform instead")
    stride, data = message.point_stride, message.data
    size = len(base64.b64decode(data)) if isinstance(data, str) else len(data)
    return {
        "header": _header(message),
        "height": 1,
        "width": size // max(stride, 1),
        "point_step": stride,
        "row_step": size,
        "is_dense": True,
        "fields": [
            {
                "name": field.name,
                "offset": field.offset,
                "datatype": _POINT_FIELDS[field.type],
                "count": 1,
            }
            for field in message.fields
        ],
        "data": data,
    }


_KINDS: Mapping[str, tuple[str, Callable[[Any], Values]]] = {
    "foxglove.LaserScan": ("sensor_msgs/msg/LaserScan", _laser_scan),
    "foxglove.Odometry": ("nav_msgs/msg/Odometry", _odometry),
    "foxglove.FrameTransform": (TRANSFORMS, lambda one: {"transforms": [_transform(one)]}),
    "foxglove.FrameTransforms": (
        TRANSFORMS,
        lambda many: {"transforms": [_transform(one) for one in many.transforms]},
    ),
    "foxglove.JointStates": ("sensor_msgs/msg/JointState", _joints),
    "foxglove.RawImage": ("sensor_msgs/msg/Image", _image),
    "foxglove.CompressedImage": ("sensor_msgs/msg/CompressedImage", _compressed_image),
    "foxglove.CameraCalibration": ("sensor_msgs/msg/CameraInfo", _camera_info),
    "foxglove.PointCloud": ("sensor_msgs/msg/PointCloud2", _cloud),
}
