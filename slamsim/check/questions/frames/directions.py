"""Which way transforms lead: map, odom, base, sensors, each below the one before (REP 105)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding
from slamsim.check.motion.disagreement import disagreement
from slamsim.check.question import FaultKind, Question, QuestionGroup, anywhere, judge, same_subject
from slamsim.recording import RawStream, Recording, TransformEdge
from slamsim.recording.edits.frames import inverted_edge
from slamsim.recording.frame_graph import FrameGraph
from slamsim.recording.repairs.base import Repair

_LASERS = ("laser", "lidar", "scan", "hokuyo", "sick", "rplidar", "velodyne", "lds")

FIXED = Question(
    "tf.sensor_frame",
    "sensors name a frame that moves with the robot",
    (
        FaultKind(
            "scan_frame",
            "a sensor names a frame that does not move with the robot",
            (same_subject("tf_unknown_frame"), anywhere("tf_missing_link")),
        ),
    ),
    consequence="every scan is drawn where odometry began: the map is one heap of walls",
    repairs=("rename_frame",),
)
DIRECTION = Question(
    "tf.direction",
    "transforms lead from odom to the base",
    (
        FaultKind(
            "tf_inverted",
            "a transform has parent and child exchanged",
            (anywhere("tf_missing_link", "tf_coverage", "tf_loop", "tf_two_parents"),),
        ),
    ),
    consequence="a SLAM that publishes map -> odom gives odom a second parent",
    repairs=("invert_transform",),
)


def check_directions(evidence: RecordingEvidence) -> Iterator[Finding]:
    """Frames of lidars and inertial units, and the moving transforms between base, odom, map."""
    recording, graph = evidence.recording, evidence.frames
    for stream in (*recording.scans, *recording.imus):
        yield from _sensor(stream, recording, graph, evidence.base)
    for edge in recording.transforms:
        if not edge.is_static:
            yield from _inverted(
                edge, recording, graph.between(evidence.base, edge.parent) is not None
            )


GROUP = QuestionGroup("transforms", 21, (FIXED, DIRECTION), check_directions)


def _sensor(
    stream: RawStream, recording: Recording, graph: FrameGraph, base: str
) -> Iterator[Finding]:
    """A frame above the base, from which a moving transform leads down to it."""
    fixed = {edge.parent for edge in graph.moving_above((base,))}
    fixed |= {frame for odometry in recording.odometries for frame in odometry.frame_ids}
    named = [frame for frame in stream.frame_ids if frame in fixed and frame != base]
    if not named or recording.format == "carmen":
        return
    free = frames_without_sensor(recording, base)
    yield judge(
        FIXED,
        stream.topic,
        f"its messages name {named[0]}, in which the robot moves, and not a frame on the robot",
        verdict="fault",
        advice="Give the driver the frame in which its sensor sits.",
        repairs=(Repair("rename_frame", stream.topic, {"frame": free[0]}),)
        if len(free) == 1 and stream in recording.scans
        else (),
    )


def frames_without_sensor(recording: Recording, base: str) -> list[str]:
    """Frames fixed to the base, named like a laser, of which no messages come."""
    used = {frame for stream in recording.streams for frame in stream.frame_ids}
    graph = FrameGraph(edge for edge in recording.transforms if edge.is_static)
    return [
        frame
        for frame in sorted(graph.reached(base) - used)
        if any(word in frame.lower() for word in _LASERS)
    ]


def _inverted(edge: TransformEdge, recording: Recording, from_robot: bool) -> Iterator[Finding]:
    """from_robot: whether its parent is fixed to the base."""
    odoms = {frame for odometry in recording.odometries for frame in odometry.frame_ids}
    odoms |= {"odom"}
    if edge.child in odoms and from_robot:
        poses = "invert" if _is_inverse(edge, recording) else "keep"
        advice = "Publish the pose of the base in odom, with odom as parent and the base as child."
        repair = Repair("invert_transform", edge.name, {"poses": poses})
        what = "the inverse of" if poses == "invert" else "the very poses of"
        words = f"{edge.name} leads from the robot to the world, and holds {what} the odometry"
    else:
        return
    yield judge(DIRECTION, edge.name, words, verdict="fault", advice=advice, repairs=(repair,))


def _is_inverse(edge: TransformEdge, recording: Recording) -> bool:
    """Whether the poses have been inverted with the names, as the odometry tells; so without."""
    turned = inverted_edge(edge)
    for odometry in recording.odometries:
        apart = [disagreement(odometry, one) for one in (turned, edge)]
        if apart[0] is not None and apart[1] is not None:
            return bool(np.median(apart[0].off_m) <= np.median(apart[1].off_m))
    return True
