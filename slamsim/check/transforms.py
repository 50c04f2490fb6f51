"""Is the transform tree whole? map -> odom -> base_footprint -> base_link -> sensors (REP 105)."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from slamsim.check.findings import Finding, Mend
from slamsim.check.transform_times import check_agreement, check_coverage
from slamsim.core.types import BoolArray, FloatArray
from slamsim.guard.numbers import is_sound
from slamsim.recording import RawOdometry, RawStream, Recording, TransformEdge
from slamsim.recording.frame_graph import FrameGraph

MAX_STATIC_CHANGE = 1e-3
"""Metres, or the entries of a rotation: a fixed transform moves by less, whatever rounds it."""
_RIGID_TOLERANCE = 0.01
MAP_FRAME = "map"
_LINK = re.compile(r'<link\s+name="([^"]*)"')


def check_transforms(recording: Recording) -> list[Finding]:
    """Missing links, two parents, loops, unknown frames, changes, coverage, contradictions."""
    if not recording.transforms:
        words = "the recording holds no transforms; where the sensors sit is not known"
        return [Finding("tf.links", "/tf", "cannot tell", words)]
    graph = FrameGraph(recording.transforms)
    return [
        *_not_rigid(recording.transforms),
        *_two_parents(graph),
        *_loops(graph),
        *_maps(recording.transforms),
        *_links(recording, graph),
        *_static_changes(recording.transforms),
        *check_coverage(recording, graph),
        *check_agreement(recording),
    ]


def _not_rigid(edges: tuple[TransformEdge, ...]) -> Iterator[Finding]:
    for edge in edges:
        broken = int((~_is_rigid(edge)).sum())
        if broken:
            yield Finding(
                "tf.rigid",
                edge.name,
                "bad",
                f"{broken} of {edge.stamps_ns.size} transforms are not finite or not of unit "
                "rotation",
                "tf_not_rigid",
                "Normalise the quaternion, and publish nothing where nothing is known.",
            )


def _is_rigid(edge: TransformEdge) -> BoolArray:
    with np.errstate(invalid="ignore", over="ignore"):
        norm = np.linalg.norm(edge.quats_xyzw, axis=1)
        finite = is_sound(edge.positions_m)
        return np.asarray(finite & (np.abs(norm - 1.0) < _RIGID_TOLERANCE))


def _two_parents(graph: FrameGraph) -> Iterator[Finding]:
    for child, edges in graph.with_two_parents().items():
        told = ", ".join(f"{edge.parent} ({edge.stamps_ns.size} messages)" for edge in edges)
        yield Finding(
            "tf.parents",
            child,
            "bad",
            f"{child} has {len(edges)} parents: {told}; a tree allows one",
            "tf_two_parents",
            "Let one node publish this frame; two localisers, or a robot model and an odometry "
            "that both do, make the robot jump between them.",
            mends=tuple(Mend("drop_transform", edge.name) for edge in edges[1:]),
        )


def _loops(graph: FrameGraph) -> Iterator[Finding]:
    for circle in graph.loops():
        shown = " -> ".join((*circle, circle[0]))
        yield Finding(
            "tf.loop",
            circle[0],
            "bad",
            f"the transforms run in a circle: {shown}",
            "tf_loop",
            "Turn one of these transforms round; every frame but the root has one parent.",
        )


def _maps(edges: tuple[TransformEdge, ...]) -> Iterator[Finding]:
    """A recording that a SLAM is to read must not hold another one's answer."""
    for edge in edges:
        if edge.parent == MAP_FRAME:
            yield Finding(
                "tf.map",
                edge.name,
                "bad",
                f"{edge.name} on {edge.topic} is what a SLAM or localiser publishes; one that maps "
                "this recording will publish it as well",
                "tf_map_recorded",
                "Leave it out, and record without SLAM or localiser.",
                mends=(Mend("drop_transform", edge.name),),
            )


def _links(recording: Recording, graph: FrameGraph) -> list[Finding]:
    """Frames that messages name: known to transforms or robot description, joined to the base."""
    odometry = recording.odometries[0] if recording.odometries else None
    base = graph.base(odometry.child_frame_ids if odometry else ())
    findings = [
        *_sensor_links(recording, graph, base),
        *(_odometry_link(recording, graph, odometry, base) if odometry else ()),
    ]
    if findings:
        return findings
    words = f"every frame that messages name is joined to {base}"
    return [Finding("tf.links", base, "ok", words)]


def _sensor_links(recording: Recording, graph: FrameGraph, base: str) -> Iterator[Finding]:
    streams: list[RawStream] = [*recording.scans, *recording.imus]
    links = set(_LINK.findall(recording.robot_description or ""))
    for stream in streams:
        for frame in stream.frame_ids:
            if frame not in graph and frame not in links:
                yield _unknown_frame(stream, frame, graph)
            elif not graph.connects(base, frame):
                yield Finding(
                    "tf.links",
                    f"{base} -> {frame}",
                    "bad",
                    f"no chain of transforms leads from {base} to {frame}, the frame of "
                    f"{stream.topic}",
                    "tf_missing_link",
                    f"Publish the missing transform; {base} reaches {graph.listed(base)}.",
                )


def _unknown_frame(stream: RawStream, frame: str, graph: FrameGraph) -> Finding:
    nearest = graph.nearest(frame)
    hint = f"; {nearest!r} is the nearest that exists" if nearest else ""
    named = repr(frame) if frame else "an empty frame"
    return Finding(
        "tf.frames",
        stream.topic,
        "bad",
        f"its messages name {named}, which no transform knows{hint}",
        "tf_unknown_frame",
        "Give the driver the frame of the robot model, or publish a transform to its own.",
        mends=(Mend("rename_frame", stream.topic, {"frame": nearest}),) if nearest else (),
    )


def _odometry_link(
    recording: Recording, graph: FrameGraph, odometry: RawOdometry, base: str
) -> Iterator[Finding]:
    """Formats with a transform tree need odom -> base in it: SLAM asks the tree, not the topic."""
    if recording.format == "carmen" or not odometry.frame_ids:
        return
    odom = odometry.frame_ids[0]
    if not graph.connects(odom, base):
        yield Finding(
            "tf.links",
            f"{odom} -> {base}",
            "bad",
            f"{odometry.topic} gives {base} in {odom}, but no transform does: SLAM that asks the "
            "transform tree drops every scan",
            "tf_missing_link",
            f"Publish {odom} -> {base} from the odometry.",
            mends=(Mend("add_odometry_transform", odometry.topic),),
        )


def _static_changes(edges: tuple[TransformEdge, ...]) -> Iterator[Finding]:
    """A latched transform that says two things; one that is latched and moving as well."""
    for edge in edges:
        if not edge.is_static or edge.stamps_ns.size < 2:
            continue
        sound = _is_rigid(edge)
        if not sound.any():
            continue
        change = max(_spread(edge.positions_m[sound]), _spread(_signed(edge.quats_xyzw[sound])))
        if change > MAX_STATIC_CHANGE:
            yield Finding(
                "tf.static",
                edge.name,
                "bad",
                f"the fixed transform changes by up to {change:.3g} (metres, or of the rotation) "
                f"over {edge.stamps_ns.size} messages",
                "tf_static_changes",
                "Publish it once; two publishers, or a restart with other numbers, do this.",
                limit=MAX_STATIC_CHANGE,
                mends=(Mend("freeze_static_transform", edge.name),),
            )


def _spread(values: FloatArray) -> float:
    return float((values.max(axis=0) - values.min(axis=0)).max())


def _signed(quats_xyzw: FloatArray) -> FloatArray:
    """The same rotations on one side of the sphere: q and -q are one."""
    sign = np.sign(quats_xyzw @ quats_xyzw[0])
    return np.asarray(quats_xyzw * np.where(sign == 0.0, 1.0, sign)[:, None])
