"""Transforms that no message of a recording holds yet, as messages of its own format."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from slamsim.logs.message_types import MessageTypes
from slamsim.recording import TransformEdge


def transform_messages(
    types: MessageTypes, edge: TransformEdge, first_ns: int
) -> Iterator[tuple[int, bytes]]:
    """(log time in ns, message) of each transform of an edge, as its topic has them.

    first_ns: log time for an edge that does not say
    when it was received: such a one holds from the begin.
    """
    topic, known = edge.topic, types.types(edge.topic)
    log_ns = edge.received_ns
    if log_ns is None:
        log_ns = np.full(edge.stamps_ns.size, first_ns)
    for row, at_ns in enumerate(np.maximum.accumulate(np.maximum(log_ns, 0)).tolist()):
        message = _part(known, types.type_name(topic), transforms=[_stamped(known, edge, row)])
        yield at_ns, types.serialize(topic, message)


def _stamped(known: Mapping[str, Any], edge: TransformEdge, row: int) -> Any:
    seconds, nanoseconds = divmod(int(edge.stamps_ns[row]), 1_000_000_000)
    stamp = _part(known, "builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
    x, y, z = edge.positions_m[row].tolist()
    qx, qy, qz, qw = edge.quats_xyzw[row].tolist()
    return _part(
        known,
        "geometry_msgs/msg/TransformStamped",
        header=_part(known, "std_msgs/msg/Header", stamp=stamp, frame_id=edge.parent, seq=row),
        child_frame_id=edge.child,
        transform=_part(
            known,
            "geometry_msgs/msg/Transform",
            translation=_part(known, "geometry_msgs/msg/Vector3", x=x, y=y, z=z),
            rotation=_part(known, "geometry_msgs/msg/Quaternion", x=qx, y=qy, z=qz, w=qw),
        ),
    )


def _part(known: Mapping[str, Any], name: str, **values: Any) -> Any:
    """An instance with those of the values that the recording's definition has: ROS 2 has no
    ``seq``."""
    kind = known[name]
    return kind(**{n: v for n, v in values.items() if n in kind.__dataclass_fields__})
