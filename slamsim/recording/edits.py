"""Recordings and streams with something changed in them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slamsim.core.types import BoolArray, IntArray
from slamsim.recording import Messages, Origin, RawOdometry, RawStream, Recording, TransformEdge


def kept(messages: Messages, which: BoolArray | IntArray) -> Messages:
    """Some messages of a topic or edge, or all in another order."""
    rows = np.arange(messages.stamps_ns.size)[which]
    per_message: dict[str, object] = {}
    fields = (field.name for field in messages.schema.fields if not field.is_constant)
    for name in ("stamps_ns", "received_ns", "samples", "origin", "layout_of", *fields):
        value = getattr(messages, name, None)
        if isinstance(value, np.ndarray | Origin):
            per_message[name] = value[rows]
        elif value is not None:
            per_message[name] = [value[row] for row in rows]
    return replace(messages, **per_message)  # type: ignore[arg-type]


def numbered(recording: Recording) -> Recording:
    """With the number of each message, which it keeps when others are lost."""

    return recording.changed(RawStream, lambda one: replace(one, samples=np.arange(len(one))))


def with_odometry_edge(recording: Recording, odometry: RawOdometry) -> Recording:
    """The edge between an odometry's frames says what the odometry does."""
    parent, child = odometry.frame_ids[0], odometry.child_frame_ids[0]
    moving = [edge for edge in recording.transforms if not edge.is_static]
    edge = TransformEdge(
        moving[0].topic if moving else "/tf",
        parent,
        child,
        False,
        odometry.stamps_ns,
        odometry.received_ns,
        odometry.positions_m,
        odometry.quats_xyzw,
    )
    for old in moving:  # published together: its messages stay, with new poses
        if (old.parent, old.child) == (parent, child) and np.array_equal(
            old.stamps_ns, odometry.stamps_ns
        ):
            edge = replace(old, positions_m=odometry.positions_m, quats_xyzw=odometry.quats_xyzw)
    others = [e for e in recording.transforms if e.child != child or e.is_static]
    return replace(recording, transforms=(*others, edge))
