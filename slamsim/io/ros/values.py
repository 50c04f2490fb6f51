"""ROS messages as plain values, by the names of their fields, and back.

As rosbridge_suite writes them (``message_conversion.py``): times are ``{sec, nanosec}``, and what
is left out of a message that comes in has its default.
"""

from __future__ import annotations

import base64
import binascii
import struct
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype

from slamsim.guard.errors import SlamsimError, shown
from slamsim.io.ros.message_types import normal_type_name, ros2_types

_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_HEADER = "std_msgs/msg/Header"
_ROS1_TIME = {"secs": "sec", "nsecs": "nanosec"}

_DTYPES: Mapping[str, np.dtype[Any]] = {
    **{name: np.dtype(name) for name in ("bool", "float32", "float64")},
    **{
        f"{sign}int{bits}": np.dtype(f"{sign}int{bits}")
        for sign in ("u", "")
        for bits in (8, 16, 32, 64)
    },
    "byte": np.dtype("int8"),  # to rosbags
    "char": np.dtype("uint8"),
}

_TAKEN: Mapping[str, tuple[type, ...]] = {"b": (bool,), "f": (int, float, type(None))}
"""What may stand in a list for an array of numbers of a kind; else integers alone."""


class WrongMessage(SlamsimError):
    """What came over a connection is not what its protocol or a message type says."""


def known_type(name: str) -> str:
    """The ROS 2 name of a type that is asked for by its ROS 1 or ROS 2 name; raises WrongMessage
    for one that is not known."""
    normal = normal_type_name(name)
    if normal not in ros2_types().fielddefs:
        raise WrongMessage(f"message type {shown(name)} is not known")
    return normal


def is_ros1_name(name: str) -> bool:
    """Whether a type is called ``package/Type``, without ``msg``."""
    return name.count("/") == 1


def plain_values(type_name: str, data: bytes, ros1: bool) -> dict[str, Any]:
    """The fields of a CDR message; arrays of numbers stay NumPy arrays.

    ros1: for clients of ROS 1 a time has ``secs`` and ``nsecs`` besides, and a header ``seq``:
    many ask for a type by its ROS 1 name of either ROS, so that both find what they read.
    """
    return _plain(type_name, ros2_types().deserialize_cdr(data, type_name), ros1)


def _plain(type_name: str, message: Any, ros1: bool) -> dict[str, Any]:
    plain: dict[str, Any] = {}
    if ros1 and type_name == _HEADER:
        plain["seq"] = 0
    name: str
    kind: Nodetype
    spec: Any
    for name, (kind, spec) in ros2_types().fielddefs[type_name][1]:
        value = getattr(message, name)
        if kind == Nodetype.NAME:
            value = _plain(spec, value, ros1)
        elif kind != Nodetype.BASE and spec[0][0] == Nodetype.NAME:
            value = [_plain(spec[0][1], one, ros1) for one in value]
        plain[name] = value
    if ros1 and type_name in _TIMES:
        plain |= {"secs": plain["sec"], "nsecs": plain["nanosec"]}
    return plain


def cdr_of(type_name: str, values: object, now_ns: int) -> bytes:
    """A message of plain values, which may be of a client of ROS 1 or ROS 2, as CDR.

    now_ns: for headers without a stamp. Raises WrongMessage naming the field.
    """
    try:
        message = _message(type_name, values, "", now_ns)
        return bytes(ros2_types().serialize_cdr(message, type_name))
    except (ValueError, OverflowError, TypeError, struct.error) as error:
        reason = f"a message of {type_name} cannot be made of this: {error}"
        raise WrongMessage(reason) from None


def cdr_of_message(type_name: str, message: object) -> bytes:
    """A message object of another store, such as of ROS 1, as CDR of the known type of that name.

    Raises WrongMessage for a field that the known type does not have.
    """
    return cdr_of(known_type(type_name), _fields(message), 0)


def _fields(value: object) -> Any:
    if is_dataclass(value):
        names = [field.name for field in fields(value) if field.name != "__msgtype__"]
        return {name: _fields(getattr(value, name)) for name in names}
    return [_fields(one) for one in value] if isinstance(value, list) else value


def ros1_of(type_name: str, data: bytes) -> bytes:
    """A CDR message as ROS 1 serialises it."""
    return bytes(ros2_types().cdr_to_ros1(data, type_name))


def _message(type_name: str, values: object, place: str, now_ns: int) -> Any:
    if not isinstance(values, Mapping):
        raise WrongMessage(f"{place or 'msg'}: {type_name} is needed, not {shown(values)}")
    nodes = ros2_types().fielddefs[type_name][1]
    known = {name for name, _ in nodes}
    if type_name in _TIMES:
        values = {_ROS1_TIME.get(name, name): value for name, value in values.items()}
    elif type_name == _HEADER:
        stamp = {"sec": now_ns // 10**9, "nanosec": now_ns % 10**9}
        values = {"stamp": stamp} | {k: v for k, v in values.items() if k != "seq"}
    for name in values:
        if name not in known:
            raise WrongMessage(
                f"{type_name} has no field {shown(name)}, only {', '.join(sorted(known))}"
            )
    made = {
        name: _field(node, values[name], f"{place}.{name}".lstrip("."), now_ns)
        if name in values
        else _default(node, now_ns)
        for name, node in nodes
    }
    return ros2_types().types[type_name](**made)


def _default(node: Any, now_ns: int) -> Any:
    """Of a field that is left out."""
    kind, spec = node
    if kind == Nodetype.BASE:
        return "" if spec[0] not in _DTYPES else _DTYPES[spec[0]].type().item()
    if kind == Nodetype.NAME:
        return _message(spec, {}, "", now_ns)
    item, count = spec[0], spec[1] if kind == Nodetype.ARRAY else 0
    if (dtype := _number_type(item)) is not None:
        return np.zeros(count, dtype)
    return [_default(item, now_ns) for _ in range(count)]


def _field(node: Any, value: object, place: str, now_ns: int) -> Any:
    kind, spec = node
    if kind == Nodetype.BASE:
        return _base(spec[0], value, place)
    if kind == Nodetype.NAME:
        return _message(spec, value, place, now_ns)
    item, most = spec
    if (dtype := _number_type(item)) is not None:
        made = _numbers(dtype, value, place)
    elif isinstance(value, list):
        made = [_field(item, one, f"{place}[{n}]", now_ns) for n, one in enumerate(value)]
    else:
        raise WrongMessage(f"{place}: a list is needed, not {shown(value)}")
    if len(made) > most > 0 or (kind == Nodetype.ARRAY and len(made) != most):
        raise WrongMessage(f"{place}: {most} values are needed, not {len(made)}")
    return made


def _number_type(item: Any) -> np.dtype[Any] | None:
    """Of the elements of an array, None where they are not numbers."""
    return _DTYPES.get(item[1][0]) if item[0] == Nodetype.BASE else None


def _numbers(dtype: np.dtype[Any], value: object, place: str) -> Any:
    """An array of a list, of a typed array of CBOR, or of bytes in base64."""
    if isinstance(value, str) and dtype == np.uint8:
        try:
            value = base64.b64decode(value, validate=True)
        except binascii.Error as error:
            raise WrongMessage(f"{place}: this is not base64: {error}") from None
    if isinstance(value, bytes) and dtype == np.uint8:
        return np.frombuffer(value, dtype)
    if isinstance(value, np.ndarray):
        floats = value.dtype.kind == dtype.kind == "f"
        if floats or np.can_cast(value.dtype, dtype):
            with np.errstate(over="ignore"):
                return value.astype(dtype)
    elif isinstance(value, list):
        taken = _TAKEN.get(dtype.kind, (int,))
        if set(map(type, value)).issubset(taken):
            with np.errstate(over="ignore"):
                return np.array(value, dtype)
    raise WrongMessage(f"{place}: a list of {dtype.name} is needed, not {shown(value)}")


def _base(name: str, value: object, place: str) -> Any:
    """One number or string; null stands for a float that is not finite, which JSON cannot hold."""
    kind = _DTYPES[name].kind if name in _DTYPES else "U"
    if kind == "f" and value is None:
        return float("nan")
    if kind == "f" and type(value) is int:
        return float(value)
    wanted = {"U": str, "b": bool, "f": float}.get(kind, int)
    if type(value) is not wanted:
        raise WrongMessage(f"{place}: {name} is needed, not {shown(value)}")
    return value


def type_details(type_name: str) -> Sequence[Mapping[str, Any]]:
    """A message type and all that it holds, as ``rosapi_msgs/msg/TypeDef``. Raises WrongMessage."""
    found: dict[str, Mapping[str, Any]] = {}
    left = [known_type(type_name)]
    while left:
        name = left.pop()
        if name in found:
            continue
        constants, nodes = ros2_types().fielddefs[name]
        kinds = [_field_type(node) for _, node in nodes]
        found[name] = {
            "type": name,
            "fieldnames": [field for field, _ in nodes],
            "fieldtypes": [kind for kind, _ in kinds],
            "fieldarraylen": [length for _, length in kinds],
            "examples": ["" for _ in nodes],
            "constnames": [constant for constant, _, _ in constants],
            "constvalues": [str(value) for _, _, value in constants],
        }
        left += [kind for kind, _ in kinds if kind in ros2_types().fielddefs]
    return list(found.values())


def _field_type(node: Any) -> tuple[str, int]:
    """Type and length of a field: -1 of a single value, 0 of an array of any length."""
    kind, spec = node
    if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        return _field_type(spec[0])[0], spec[1] if kind == Nodetype.ARRAY else 0
    return (spec if kind == Nodetype.NAME else spec[0]), -1
