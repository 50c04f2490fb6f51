"""What published odometry shows by itself and beside another: numbers that are no pose, two that
tell different drives, counters that stand while it goes on."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.check.disagreement import IN_COMMON, LIMIT_M, disagreement
from slamsim.check.findings import Estimate, Finding, Mend
from slamsim.core.types import BoolArray
from slamsim.recording import RawOdometry, Recording
from slamsim.recording.soundness import finite_poses, has_unit_length

REPLACED_SHARE = 0.5
"""Where more of the poses are broken than this, dropping them leaves no odometry."""


def check_published(recording: Recording) -> list[Finding]:
    """Sound numbers in every odometry, and one story from all of them."""
    return [
        *(_values(odometry, bool(recording.ticks)) for odometry in recording.odometries),
        *_contradictions(recording.odometries),
    ]


def _values(odometry: RawOdometry, has_ticks: bool) -> Finding:
    finite = finite_poses(odometry)
    unit = has_unit_length(odometry.quats_xyzw)
    broken = int((~(finite & unit)).sum())
    share = broken / max(len(odometry), 1)
    estimate = Estimate(100.0 * share, 0.0, "%")
    if not broken:
        words = "every pose is finite, every rotation of unit length"
        return Finding("odometry.values", odometry.topic, "ok", words, estimate=estimate, limit=0.0)
    words = (
        f"{broken} of {len(odometry)} messages hold numbers that are no pose: "
        f"{int((~finite).sum())} not finite, {int((~unit).sum())} with a quaternion that is not of "
        "unit length"
    )
    return Finding(
        *("odometry.values", odometry.topic, "bad", words, "odometry_invalid"),
        "Start the quaternion at w = 1, keep it of unit length, and publish nothing where nothing "
        "is known: one NaN stays in a filter for ever.",
        *(estimate, 0.0),
        _mends(odometry, finite, share, has_ticks),
    )


def _mends(
    odometry: RawOdometry, finite: BoolArray, share: float, has_ticks: bool
) -> tuple[Mend, ...]:
    length = np.linalg.norm(odometry.quats_xyzw, axis=1)
    if (finite & np.isfinite(length) & (length > 0.0)).all():
        return (Mend("normalise_rotations", odometry.topic),)
    if share < REPLACED_SHARE:
        return (Mend("drop_broken_poses", odometry.topic),)
    return (Mend("odometry_from_ticks", odometry.topic),) if has_ticks else ()


def _contradictions(odometries: tuple[RawOdometry, ...]) -> Iterator[Finding]:
    """Odometries of one body must show the same motion as the first, from wherever they count."""
    first: dict[str, RawOdometry] = {}
    for other in odometries:
        one = next((first[body] for body in other.child_frame_ids if body in first), None)
        first = {**dict.fromkeys(other.child_frame_ids, other), **first}
        if one is not None:
            yield _agreement(one, other)


def _agreement(one: RawOdometry, other: RawOdometry) -> Finding:
    subject = f"{one.topic} against {other.topic}"
    found = disagreement(one, other)
    if found is None:
        words = f"they have less than {IN_COMMON}"
        return Finding("odometry.others", subject, "cannot tell", words)
    if not found.matters:
        return Finding("odometry.others", subject, "ok", found.words, estimate=found.estimate)
    return Finding(
        *("odometry.others", subject, "bad", found.words, "odometries_contradict"),
        "Find out which of them is right before either is used: compare both with the scans.",
        *(found.estimate, LIMIT_M),
        plots=(found.plot(subject),),
    )
