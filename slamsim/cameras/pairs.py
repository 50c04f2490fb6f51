"""Which topics are the two images of a stereo pair."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from slamsim.cameras.survey import CameraSurvey

_NAMES = (("left", "right"), ("infra1", "infra2"), ("cam0", "cam1"), ("fisheye1", "fisheye2"))


def stereo_pairs(cameras: Sequence[CameraSurvey]) -> Iterator[tuple[CameraSurvey, CameraSurvey]]:
    """(left, right) by the names of their topics."""
    by_topic = {one.topic: one for one in cameras if one.kind != "depth"}
    for topic, left in by_topic.items():
        for one, other in _NAMES:
            right = by_topic.get(re.sub(one, other, topic))
            if right is not None and right is not left and right.size == left.size:
                yield left, right
