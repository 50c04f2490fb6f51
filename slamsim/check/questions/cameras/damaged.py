"""Can all images of a camera be decoded?"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import starmap

from slamsim.cameras.survey import CameraSurvey
from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding, Measurement
from slamsim.check.question import FaultKind, Question, judge, same_subject
from slamsim.recording.repairs.base import Repair

_MOST_NAMED = 5
_ADVICE = (
    "Look for a full disk, a bus or network that loses packets, or a recorder that was killed."
)


def check_damaged(evidence: RecordingEvidence) -> Iterator[Finding]:
    """Images whose bytes are cut off or contradict their checksums, and those that were decoded in
    vain; topics of which not one could be read."""
    yield from map(_judged, (one for one in evidence.recording.cameras if len(one)))
    yield from starmap(_unread, evidence.recording.unread_cameras)


DAMAGED = Question(
    "camera.damaged",
    "images are whole and of one kind",
    (
        FaultKind(
            "camera_damaged",
            "images of a camera cannot be decoded",
            # What is left of an empty image is alike in each.
            (same_subject("camera_frozen", "camera_duplicated"),),
        ),
    ),
    consequence="programs stop at the first of them, or take half an image for a whole one",
    ask=check_damaged,
    repairs=("drop_damaged_images",),
)


def _judged(camera: CameraSurvey) -> Finding:
    count = len(camera.damaged)
    begins = ", ".join(f"{number + 1:,}" for number in camera.damaged[:_MOST_NAMED].tolist())
    more = ", ..." if count > _MOST_NAMED else ""
    return judge(
        DAMAGED,
        camera.topic,
        {
            "ok": f"all of {len(camera):,} images are whole, as far as their bytes tell",
            "fault": f"{count:,} of {len(camera):,} images cannot be decoded, or are of another "
            f"kind than the first: image {begins}{more}",
        },
        Measurement(count / len(camera), 0.0, ""),
        verdict="fault" if count else "ok",
        repairs=[Repair("drop_damaged_images", camera.topic)],
        advice=_ADVICE,
    )


def _unread(topic: str, reason: str) -> Finding:
    words = f"not one of the images that were tried can be decoded: {reason}"
    return judge(DAMAGED, topic, words, verdict="fault", advice=_ADVICE)
