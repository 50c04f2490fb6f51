"""A transform that repeats an odometry: at the same instants, and over the same distances?

Both come from one node, so that they differ by nothing but rounding, or by a mistake. A transform
of another source, such as a filter of wheels and gyroscope, is not held against these limits.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Curve, Finding, Measurement, Plot
from slamsim.check.motion.clustered import clustered_fit
from slamsim.check.motion.inputs import as_odometry
from slamsim.check.motion.integrated import IntegratedMotion, integrated_odometry
from slamsim.check.question import Question, QuestionGroup, judge
from slamsim.check.questions.frames.transform_times import TF_CONTRADICTS, joins_frames_of
from slamsim.check.wording import signed_words
from slamsim.core.types import FloatArray
from slamsim.recording.repairs.base import Repair

MAX_LATE_S = 5e-3
"""At 1 rad/s a wall 10 m away stands 5 cm aside: the harm of a stamp that is off by so much."""
MAX_SCALE = 5e-3
"""5 cm in 10 m. Rounding to single precision is a thousandth of that."""
SAME_SHARE = 0.01
"""Of the motion in a second, that two copies differ by: what a filter adds to wheels is more."""
STEP_S, SPAN_S, FARTHEST_S = 0.1, 1.0, 0.5
LONGEST_S = 3600.0
BLOCK_S, MIN_BLOCKS = 5.0, 4
LEAST_M, LEAST_RAD = 0.02, 0.02
"""In a second, on average: a robot that moves less tells nothing."""

TIME = Question(
    "tf.odometry_time",
    "the transform repeats the odometry at its instants",
    (TF_CONTRADICTS,),
    limit=1e3 * MAX_LATE_S,
    unit="ms",
    consequence="consumers of the transforms place scans where the robot was before or after",
    repairs=("add_odometry_transform",),
)
SCALE = Question(
    "tf.odometry_scale",
    "the transform goes as far and turns as much as the odometry that it repeats",
    (TF_CONTRADICTS,),
    limit=100.0 * MAX_SCALE,
    unit="%",
    consequence="a map made by the transforms is larger or smaller than one made by the messages",
    repairs=("add_odometry_transform",),
)


@dataclass(frozen=True, slots=True, eq=False)
class _Repetition:
    """How late, ms; how much more path and turn, %, of those of which there is any; when, and what
    is left, (k, 2)."""

    late: Measurement
    more: dict[str, Measurement]
    times_s: FloatArray
    left: FloatArray


def check_repetitions(evidence: RecordingEvidence) -> Iterator[Finding]:
    """Each transform between the frames of an odometry against its messages."""
    recording = evidence.recording
    for odometry in recording.odometries:
        for edge in recording.transforms:
            if not joins_frames_of(odometry, edge):
                continue
            said, shown = map(integrated_odometry, (odometry, as_odometry(edge)))
            found = _repetition(said, shown) if said is not None and shown is not None else None
            if found is not None:
                subject = f"{edge.name} against {odometry.topic}"
                yield from _judged(found, subject, odometry.topic)


GROUP = QuestionGroup("transforms", 22, (TIME, SCALE), check_repetitions)


def _repetition(odometry: IntegratedMotion, transform: IntegratedMotion) -> _Repetition | None:
    """The offset in time at which one is most like the other; None if it is no copy."""
    begin_ns = max(odometry.origin_ns, transform.origin_ns)
    end_ns = min(int(odometry.stamps_ns[-1]), int(transform.stamps_ns[-1]))
    span_s = min((end_ns - begin_ns) * 1e-9, LONGEST_S) - 2.0 * FARTHEST_S
    if span_s < MIN_BLOCKS * BLOCK_S:
        return None
    times_s = FARTHEST_S + np.arange(0.0, span_s - SPAN_S, STEP_S)
    apart_s = (begin_ns - odometry.origin_ns) * 1e-9
    shown = _moved(transform, times_s + (begin_ns - transform.origin_ns) * 1e-9)
    usual, least = np.sqrt(np.mean(np.square(shown), axis=0)), np.array([LEAST_M, LEAST_RAD])
    if (usual < least).all():
        return None
    offsets = np.linspace(-FARTHEST_S, FARTHEST_S, 51)
    apart = [np.abs(shown - _moved(odometry, times_s + apart_s - one)).sum() for one in offsets]
    late_s = float(offsets[np.argmin(apart)])
    for _ in range(5):
        told = _moved(odometry, times_s + apart_s - late_s)
        found, sigma = _step(told, _rates(odometry, times_s + apart_s - late_s), shown, times_s)
        late_s -= float(np.clip(found[0], -FARTHEST_S, FARTHEST_S))
    left = shown - told * found[1:]
    off = np.sqrt(np.mean(np.square(left), axis=0))
    if (off > SAME_SHARE * np.maximum(usual, least)).any():
        return None
    more = {
        name: Measurement(100.0 * float(found[k] - 1.0), 100.0 * float(sigma[k]), "%")
        for k, name in ((1, "path"), (2, "turn"))
        if usual[k - 1] >= least[k - 1]
    }
    late = Measurement(1e3 * late_s, 1e3 * float(sigma[0]), "ms")
    return _Repetition(late, more, times_s, left)


def _moved(motion: IntegratedMotion, times_s: FloatArray) -> FloatArray:
    """(k, 2) path and turn in the second from each time on."""
    return np.asarray(motion.at(times_s + SPAN_S) - motion.at(times_s))


def _rates(motion: IntegratedMotion, times_s: FloatArray) -> FloatArray:
    """(k, 2) by how much these grow for each second that one looks later."""
    later, before = (_moved(motion, times_s + sign * 0.5 * STEP_S) for sign in (1.0, -1.0))
    return np.asarray((later - before) / STEP_S)


def _step(
    told: FloatArray, rates: FloatArray, shown: FloatArray, times_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(3,) how much later to look, and the factors of path and turn, with (3,) their sigmas."""
    zero = np.zeros(len(told))
    path = np.column_stack([rates[:, 0], told[:, 0], zero])
    turn = np.column_stack([rates[:, 1], zero, told[:, 1]])
    block = np.unique(times_s // BLOCK_S, return_inverse=True)[1]
    found, covariance = clustered_fit(
        np.concatenate([path, turn]),
        np.concatenate([shown[:, 0], shown[:, 1]]),
        np.concatenate([block, block]),
    )
    return found, np.sqrt(np.diag(covariance))


def _judged(found: _Repetition, subject: str, topic: str) -> Iterator[Finding]:
    repairs = (Repair("add_odometry_transform", topic),)
    curves = tuple(
        Curve(name, found.times_s, left, "line")
        for name, left in zip(("path (m)", "turn (rad)"), found.left.T, strict=True)
    )
    plot = Plot(f"{subject}: what is left", "time (s)", "in a second", curves)
    late = signed_words(found.late.value, "ms", "later", "earlier")
    yield judge(
        TIME,
        subject,
        f"the transform shows what the odometry says {late}",
        found.late,
        advice=f"Stamp the transform with the stamp of the message on {topic}.",
        repairs=repairs,
        fault_plots=(plot,),
    )
    told = [
        signed_words(size.value, f"% {what}", "more", "less") for what, size in found.more.items()
    ]
    yield judge(
        SCALE,
        subject,
        f"the transform shows {' and '.join(told)} than the odometry",
        max(found.more.values(), key=lambda one: abs(one.value)),
        advice=f"Let the node that makes {topic} publish the transform as well, alone.",
        repairs=repairs,
        fault_plots=(plot,),
    )
