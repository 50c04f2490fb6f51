"""Is the transform tree complete? map, odom, base_footprint, base_link, sensors (REP 105)."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding
from slamsim.check.question import FaultKind, Question, QuestionGroup, anywhere, judge, unanswered
from slamsim.check.questions.frames.transform_times import (
    AGREEMENT,
    COVERAGE,
    UPRIGHT,
    check_agreement,
    check_coverage,
)
from slamsim.core.types import BoolArray, FloatArray
from slamsim.guard.errors import nearest_name
from slamsim.guard.numbers import is_sound
from slamsim.recording import RawOdometry, RawStream, Recording, TransformEdge
from slamsim.recording.frame_graph import FrameGraph
from slamsim.recording.repairs.base import Repair

MAX_STATIC_CHANGE = 1e-3
"""Metres, or the entries of a rotation: a fixed transform moves by less, whatever rounds it."""
_RIGID_TOLERANCE = 0.01
"""Of the norm of a quaternion: those written with three decimals are off by 0.001."""
_LINK = re.compile(r'<link\s+name="([^"]*)"')


MAP_FRAME = "map"
MAP_RECORDED = FaultKind(
    "tf_map_recorded", "the recording holds a map's transform: a SLAM has run already"
)
RIGID = Question(
    "tf.rigid",
    "every transform is a rotation and a translation",
    (
        FaultKind(
            "tf_not_rigid",
            "a transform is no rotation and translation",
            (anywhere("tf_contradicts_odometry"),),
        ),
    ),
    consequence="one NaN makes every pose behind it one",
)
PARENTS = Question(
    "tf.parents",
    "every frame has one parent",
    (FaultKind("tf_two_parents", "a frame has two parents"),),
    consequence="the robot jumps between two places",
    repairs=("drop_transform",),
)
LOOP = Question(
    "tf.loop",
    "the transforms make a tree",
    (FaultKind("tf_loop", "transforms run in a circle"),),
    consequence="no transform of these frames can be looked up",
)
MAP = Question(
    "tf.map",
    "no map's transform was recorded",
    (MAP_RECORDED,),
    consequence="the SLAM that replays the recording and the recorded one both move the robot",
    repairs=("drop_transform",),
)
LINKS = Question(
    "tf.links",
    "every frame that messages name is joined to the base",
    (FaultKind("tf_missing_link", "frames that should be connected are not"),),
    consequence="a SLAM drops every message of the frame",
    excitation_wanted="recorded transforms",
    repairs=("add_odometry_transform",),
)
FRAMES = Question(
    "tf.frames",
    "every frame that messages name is known to a transform",
    (FaultKind("tf_unknown_frame", "messages name a frame that no transform knows"),),
    consequence="a SLAM drops every message of the frame",
    repairs=("rename_frame", "rename_child_frame"),
)
STATIC = Question(
    "tf.static",
    "fixed transforms do not change",
    (FaultKind("tf_static_changes", "a fixed transform changes"),),
    limit=MAX_STATIC_CHANGE,
    consequence="which of the poses a consumer sees depends on when it joins",
    repairs=("freeze_static_transform",),
)


def check_transforms(evidence: RecordingEvidence) -> list[Finding]:
    """Missing links, two parents, loops, unknown frames, changes, coverage, contradictions."""
    recording, graph = evidence.recording, evidence.frames
    if not recording.transforms:
        words = "the recording holds no transforms; where the sensors sit is not known"
        return [unanswered(LINKS, "/tf", words)]
    return [
        *_not_rigid(recording.transforms),
        *_two_parents(graph),
        *_loops(graph),
        *_maps(recording.transforms),
        *_links(recording, graph, evidence.base),
        *_static_changes(recording.transforms),
        *check_coverage(recording, graph),
        *check_agreement(recording),
    ]


GROUP = QuestionGroup(
    "transforms",
    20,
    (RIGID, PARENTS, LOOP, MAP, LINKS, FRAMES, STATIC, COVERAGE, AGREEMENT, UPRIGHT),
    check_transforms,
)


def _not_rigid(edges: tuple[TransformEdge, ...]) -> Iterator[Finding]:
    for edge in edges:
        broken = int((~_is_rigid(edge)).sum())
        if broken:
            yield judge(
                RIGID,
                edge.name,
                f"{broken} of {edge.stamps_ns.size} transforms are not finite or not of unit "
                "rotation",
                verdict="fault",
                advice="Normalise the quaternion, and publish nothing where nothing is known.",
            )


def _is_rigid(edge: TransformEdge) -> BoolArray:
    with np.errstate(invalid="ignore", over="ignore"):
        norm = np.linalg.norm(edge.quats_xyzw, axis=1)
        finite = is_sound(edge.positions_m)
        return np.asarray(finite & (np.abs(norm - 1.0) < _RIGID_TOLERANCE))


def _two_parents(graph: FrameGraph) -> Iterator[Finding]:
    for child, edges in graph.with_two_parents().items():
        told = ", ".join(f"{edge.parent} ({edge.stamps_ns.size} messages)" for edge in edges)
        yield judge(
            PARENTS,
            child,
            f"{child} has {len(edges)} parents: {told}; a tree allows one",
            verdict="fault",
            advice="Let one node publish this frame; two localisers, or a robot model and an "
            "odometry that both do, make the robot jump between them.",
            repairs=tuple(Repair("drop_transform", edge.name) for edge in edges[1:]),
        )


def _loops(graph: FrameGraph) -> Iterator[Finding]:
    for circle in graph.loops():
        shown = " -> ".join((*circle, circle[0]))
        yield judge(
            LOOP,
            circle[0],
            f"the transforms run in a circle: {shown}",
            verdict="fault",
            advice="Turn one of these transforms round; every frame but the root has one parent.",
        )


def _maps(edges: tuple[TransformEdge, ...]) -> Iterator[Finding]:
    """A recording that a SLAM is to read must not hold another one's answer."""
    for edge in edges:
        if MAP_FRAME in (edge.parent, edge.child):
            yield judge(
                MAP,
                edge.name,
                f"{edge.name} on {edge.topic} is what a SLAM or localiser publishes; one that maps "
                "this recording will publish it as well",
                verdict="fault",
                advice="Leave it out, and record without SLAM or localiser.",
                repairs=(Repair("drop_transform", edge.name),),
            )


def _links(recording: Recording, graph: FrameGraph, base: str) -> list[Finding]:
    """Frames that messages name: known to transforms or robot description, joined to the base."""
    odometry = recording.odometries[0] if recording.odometries else None
    findings = [
        *_sensor_links(recording, graph, base),
        *(_odometry_link(recording, graph, odometry, base) if odometry else ()),
        *_odometry_children(recording, graph),
    ]
    if findings:
        return findings
    words = f"every frame that messages name is joined to {base}"
    return [judge(LINKS, base, words, verdict="ok")]


def _sensor_links(recording: Recording, graph: FrameGraph, base: str) -> Iterator[Finding]:
    streams: list[RawStream] = [*recording.scans, *recording.imus]
    links = set(_LINK.findall(recording.robot_description or ""))
    # Of several robots in one recording, each has sensors of its own.
    bases = {
        base,
        *(frame for odometry in recording.odometries for frame in odometry.child_frame_ids),
    }
    for stream in streams:
        for frame in stream.frame_ids:
            if frame not in graph and frame not in links:
                yield _unknown_frame(stream, frame, graph)
            elif not any(graph.connects(each, frame) for each in bases):
                yield judge(
                    LINKS,
                    f"{base} -> {frame}",
                    f"no chain of transforms leads from {base} to {frame}, the frame of "
                    f"{stream.topic}",
                    verdict="fault",
                    advice=f"Publish the missing transform; {base} reaches {graph.listed(base)}.",
                )


def _unknown_frame(stream: RawStream, frame: str, graph: FrameGraph) -> Finding:
    nearest = graph.nearest(frame)
    hint = f"; {nearest!r} is the nearest that exists" if nearest else ""
    named = repr(frame) if frame else "an empty frame"
    return judge(
        FRAMES,
        stream.topic,
        f"its messages name {named}, which no transform knows{hint}",
        verdict="fault",
        advice="Give the driver the frame of the robot model, or publish a transform to its own.",
        repairs=(Repair("rename_frame", stream.topic, {"frame": nearest}),) if nearest else (),
    )


def _odometry_children(recording: Recording, graph: FrameGraph) -> Iterator[Finding]:
    """The frame whose pose an odometry gives; drivers that leave it empty mean the base."""
    links = set(_LINK.findall(recording.robot_description or ""))
    for odometry in recording.odometries if recording.format != "carmen" else ():
        # What another odometry gives is its frame, unless the names are alike.
        others = (other for other in recording.odometries if other is not odometry)
        given = {child for other in others for child in other.child_frame_ids}
        for frame in odometry.child_frame_ids:
            if frame and frame not in graph and frame not in links:
                moved = [
                    edge.child
                    for edge in recording.transforms
                    if edge.parent in odometry.frame_ids and edge.child not in given
                ]
                nearest = nearest_name(frame, moved, 0.0) or graph.nearest(frame)
                yield judge(
                    FRAMES,
                    odometry.topic,
                    f"it gives the pose of {frame!r}, which no transform knows",
                    verdict="fault",
                    advice="Give the driver the name of the base as child_frame_id.",
                    repairs=(Repair("rename_child_frame", odometry.topic, {"frame": nearest}),)
                    if nearest
                    else (),
                )


def _odometry_link(
    recording: Recording, graph: FrameGraph, odometry: RawOdometry, base: str
) -> Iterator[Finding]:
    """Formats with a transform tree need odom -> base in it: SLAM asks the tree, not the topic."""
    if recording.format == "carmen" or not odometry.frame_ids:
        return
    odom = odometry.frame_ids[0]
    if not graph.connects(odom, base):
        yield judge(
            LINKS,
            f"{odom} -> {base}",
            f"{odometry.topic} gives {base} in {odom}, but no transform does: SLAM that asks the "
            "transform tree drops every scan",
            verdict="fault",
            advice=f"Publish {odom} -> {base} from the odometry.",
            repairs=(Repair("add_odometry_transform", odometry.topic),),
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
            yield judge(
                STATIC,
                edge.name,
                f"the fixed transform changes by up to {change:.3g} (metres, or of the rotation) "
                f"over {edge.stamps_ns.size} messages",
                verdict="fault",
                limit=MAX_STATIC_CHANGE,
                advice="Publish it once; two publishers, or a restart with other numbers, do this.",
                repairs=(Repair("freeze_static_transform", edge.name),),
            )


def _spread(values: FloatArray) -> float:
    return float((values.max(axis=0) - values.min(axis=0)).max())


def _signed(quats_xyzw: FloatArray) -> FloatArray:
    """The same rotations on one side of the sphere: q and -q are one."""
    sign = np.sign(quats_xyzw @ quats_xyzw[0])
    return np.asarray(quats_xyzw * np.where(sign == 0.0, 1.0, sign)[:, None])
