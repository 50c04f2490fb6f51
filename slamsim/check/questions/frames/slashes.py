"""Names of frames with a leading slash, as ROS 1 had them, in messages of ROS 2."""

from __future__ import annotations

from collections.abc import Iterator

from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding
from slamsim.check.question import FaultKind, Question, QuestionGroup, judge
from slamsim.recording import RawOdometry, RawStream
from slamsim.recording.repairs.base import Repair

SLASH = Question(
    "tf.slash",
    "no message names its frame with a leading slash",
    (FaultKind("frame_slash", "messages name a frame with a leading slash"),),
    consequence="tf2 looks no such frame up: a SLAM drops the messages, or ends",
    repairs=("rename_frame", "rename_child_frame"),
)


def check_slashes(evidence: RecordingEvidence) -> Iterator[Finding]:
    """Each stream that names some so. Transforms are none of them: tf2 strips theirs itself."""
    for stream in evidence.recording.streams:
        if stream.slashed:
            yield judge(
                SLASH,
                stream.topic,
                f"its messages name {', '.join(repr(f'/{name}') for name in stream.slashed)}, and "
                "tf2 knows no frame that begins with a slash",
                verdict="fault",
                advice="Give the driver the name of the frame without the slash.",
                repairs=_without(stream),
            )


def _without(stream: RawStream) -> Iterator[Repair]:
    """Where there is one name for all messages to have, which a slash alone is not."""
    named = [("rename_frame", stream.frame_ids)]
    if isinstance(stream, RawOdometry):
        named.append(("rename_child_frame", stream.child_frame_ids))
    for operation, frames in named:
        if len(frames) == 1 and frames[0] in stream.slashed and frames[0]:
            yield Repair(operation, stream.topic, {"frame": frames[0]})


GROUP = QuestionGroup("transforms", 23, (SLASH,), check_slashes)
