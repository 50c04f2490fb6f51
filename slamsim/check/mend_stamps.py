"""Mends of clocks: the right stamps for the same messages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from slamsim.check.findings import Mend
from slamsim.check.mend_subjects import edge_subject, number
from slamsim.check.stamp_series import are_copies, series_of
from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.errors import SlamsimError
from slamsim.recording import Messages, Recording
from slamsim.recording.edits import kept

CLOCKS = ("shift_stamps", "rescale_stamps", "restamp_evenly", "reorder")
"""Operations that a clock needs, and so all streams that are stamped together."""

_TOGETHER = 0.9
_SMOOTHED = 65
_STEP_PERIODS = 0.9


def on_clock_of(recording: Recording, subject: str) -> set[str]:
    """The subjects that are stamped together with this one, itself included.

    Wheels have one clock for counters, joints, odometry and its transform: these belong
    together where nearly all stamps of one are stamps of the other.
    """
    stamps = {
        subject_of: values for subject_of, kind, values in _stamps(recording) if kind == "wheels"
    }
    if subject not in stamps:
        return {subject}
    mine = stamps[subject]

    def shared(other: IntArray) -> bool:
        small, large = sorted((mine, other), key=lambda values: values.size)
        return bool(small.size and np.isin(small, large).mean() >= _TOGETHER)

    return {name for name, values in stamps.items() if shared(values)} | {subject}


def _stamps(recording: Recording) -> list[tuple[str, str, IntArray]]:
    """(subject, kind, stamps) of everything that has stamps."""
    found = [(s.topic, "lidar", s.stamps_ns) for s in recording.scans]
    found += [(s.topic, "imu", s.stamps_ns) for s in recording.imus]
    found += [
        (s.topic, "wheels", s.stamps_ns)
        for s in (*recording.odometries, *recording.ticks, *recording.joints)
    ]
    moving = [edge for edge in recording.transforms if not edge.is_static]
    return found + [(edge_subject(edge), "wheels", edge.stamps_ns) for edge in moving]


def shift_stamps(recording: Recording, mend: Mend) -> Recording:
    """Add offset_s to every stamp."""
    offset_ns = round(number(mend, "offset_s") * 1e9)
    return _each_stamp(recording, mend, lambda stamps_ns: stamps_ns + offset_ns)


def rescale_stamps(recording: Recording, mend: Mend) -> Recording:
    """Take a gain of drift_ppm back, counted from the stamp origin_ns."""
    origin_ns = int(mend.parameters["origin_ns"])
    factor = 1.0 / (1.0 + 1e-6 * number(mend, "drift_ppm"))

    def rescaled(stamps_ns: IntArray) -> IntArray:
        since_ns = np.rint((stamps_ns - origin_ns) * factor)
        return np.asarray(origin_ns + since_ns, dtype=np.int64)

    return _each_stamp(recording, mend, rescaled)


def restamp_evenly(recording: Recording, mend: Mend) -> Recording:
    """Put every stamp on the even beat from which they scatter."""
    return _each_stamp(recording, mend, even_stamps)


def reorder(recording: Recording, mend: Mend) -> Recording:
    """Sort the messages by stamp; they count as received in that order."""

    def sorted_by_stamp(messages: Messages) -> Messages:
        found = kept(messages, np.argsort(messages.stamps_ns, kind="stable"))
        if found.received_ns is None:
            return found
        return replace(found, received_ns=np.sort(found.received_ns))

    return _each(recording, mend, sorted_by_stamp)


def stamp_by_receipt(recording: Recording, mend: Mend) -> Recording:
    """Take for the stamp when a message was received, less the time of measuring."""
    series = {s.subject: s for s in series_of(recording)}

    def by_receipt(messages: Messages) -> Messages:
        mine = series.get(mend.subject)
        if messages.received_ns is None or mine is None:
            raise SlamsimError(f"{mend.subject}: nothing tells when messages were received")
        return replace(messages, stamps_ns=messages.received_ns - mine.lasts_ns)

    return _each(recording, mend, by_receipt)


def shift_receipt(recording: Recording, mend: Mend) -> Recording:
    """Add offset_s to every time of receipt."""
    offset_ns = round(number(mend, "offset_s") * 1e9)

    def shifted(messages: Messages) -> Messages:
        if messages.received_ns is None:
            return messages
        return replace(messages, received_ns=messages.received_ns + offset_ns)

    return _each(recording, mend, shifted)


def even_stamps(stamps_ns: IntArray) -> IntArray:
    """(n,) stamps of the same messages without the scatter about their beat.

    What is left of the stamps less the beat goes through a running median, which keeps the
    steps that missing messages make, and between such steps through a running mean.
    """
    if stamps_ns.size < 3:
        return stamps_ns
    since_ns = (stamps_ns - stamps_ns[0]).astype(np.float64)
    beat_ns = _period_ns(since_ns) * np.arange(stamps_ns.size)
    off_ns = since_ns - beat_ns
    pairs_ns = 0.5 * (off_ns + np.append(off_ns[1:], off_ns[-2]))
    smooth_ns = _running(np.median, pairs_ns)
    steps = _running(np.ptp, smooth_ns) > _STEP_PERIODS * _period_ns(since_ns)
    smooth_ns = np.where(steps, smooth_ns, _running(np.mean, smooth_ns))
    found_ns = np.maximum.accumulate(np.rint(beat_ns + smooth_ns))
    return np.asarray(stamps_ns[0] + found_ns, dtype=np.int64)


def _period_ns(since_ns: FloatArray) -> float:
    """The slope that most pairs of messages a good way apart agree on."""
    apart = max(since_ns.size // 4, 1)
    return float(np.median(since_ns[apart:] - since_ns[:-apart])) / apart


def _running(middle: Callable[..., Any], values: FloatArray) -> FloatArray:
    width = min(_SMOOTHED, values.size // 2 * 2 - 1)
    padded = np.pad(values, width // 2, mode="symmetric")
    windows = np.lib.stride_tricks.sliding_window_view(padded, width)
    return np.asarray(middle(windows, axis=1), dtype=np.float64)


def _each_stamp(
    recording: Recording, mend: Mend, change: Callable[[IntArray], IntArray]
) -> Recording:
    """Stamps changed, and with them times of receipt that are nothing but copies of them."""

    def stamped(messages: Messages) -> Messages:
        stamps_ns = change(messages.stamps_ns)
        copied = are_copies(messages.received_ns, messages.stamps_ns)
        received_ns = stamps_ns if copied else messages.received_ns
        return replace(messages, stamps_ns=stamps_ns, received_ns=received_ns)

    return _each(recording, mend, stamped)


def _each(recording: Recording, mend: Mend, change: Callable[[Any], Any]) -> Recording:
    """Everything stamped by the subject's clock changed; a CARMEN line is scan and odometry."""
    subjects = {mend.subject}
    if mend.operation in CLOCKS:
        subjects = on_clock_of(recording, mend.subject)
    streams = (change(s) if s.topic in subjects else s for s in recording.streams)
    edges = tuple(
        change(edge) if not edge.is_static and edge_subject(edge) in subjects else edge
        for edge in recording.transforms
    )
    if not any(subject in subjects for subject, _, _ in _stamps(recording)):
        raise SlamsimError(f"the mend {mend.operation} finds no stream {mend.subject!r}")
    return replace(recording, streams=tuple(streams), transforms=edges)
