"""Repairs of clocks: the right stamps for the same messages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from slamsim.core.types import FloatArray, IntArray
from slamsim.recording import Messages, Recording
from slamsim.recording.edits.base import STAMPED, CannotEdit, Edit
from slamsim.recording.edits.beams import scan_durations_ns
from slamsim.recording.edits.cameras import ChangeCameras, shifted
from slamsim.recording.edits.messages import ChangeMessages, SelectMessages, copies, select
from slamsim.recording.edits.stamps import (
    Restamp,
    ScaleStamps,
    ShiftReceipt,
    ShiftStamps,
    clock_of,
)
from slamsim.recording.repairs.base import Repair

_SMOOTHED = 65
"""Messages over which scattered stamps are smoothed: a few seconds of scans."""
_STEP_PERIODS = 0.9
"""Of the period: a step of the smoothed stamps as large as this is a missing message."""


def shift_stamps(recording: Recording, repair: Repair) -> Edit:
    """Add offset_s to every stamp of the subject's clock."""
    offset_ns = round(repair.number("offset_s") * 1e9)
    clock = clock_of(recording, repair.subject)
    if any(camera.topic == repair.subject for camera in recording.cameras):
        together = clock.subjects or frozenset()
        return ChangeCameras(
            lambda camera: camera.topic in together, lambda camera: shifted(camera, offset_ns)
        )
    return ShiftStamps(clock, offset_ns, receipt_follows=True)


def rescale_stamps(recording: Recording, repair: Repair) -> Edit:
    """Take back that the subject's clock has gained drift_ppm since the stamp origin_ns."""
    gain, origin_ns = 1e-6 * repair.number("drift_ppm"), int(repair.parameters["origin_ns"])
    clock = clock_of(recording, repair.subject)
    return ScaleStamps(clock, gain, origin_ns, receipt_follows=True).inverse()


def undo_clock_step(recording: Recording, repair: Repair) -> Edit:
    """Take jump_s off the stamps of the messages that follow the one with the stamp after_ns."""
    jump_ns, after_ns = round(1e9 * repair.number("jump_s")), int(repair.parameters["after_ns"])

    def set_back(stamps_ns: IntArray) -> IntArray:
        # Until the leap they ascend, so that the first of them which is as late is the one before.
        reached = stamps_ns >= after_ns
        first = int(np.argmax(reached)) if reached.any() else stamps_ns.size
        last = first + int(reached.any() and stamps_ns[first] == after_ns)
        return np.asarray(stamps_ns - np.where(np.arange(stamps_ns.size) >= last, jump_ns, 0))

    return Restamp(clock_of(recording, repair.subject), set_back, receipt_follows=True)


def restamp_evenly(recording: Recording, repair: Repair) -> Edit:
    """Put every stamp on the even beat from which they scatter."""
    return Restamp(clock_of(recording, repair.subject), even_stamps, receipt_follows=True)


def drop_copies(recording: Recording, repair: Repair) -> Edit:
    """Leave out messages that are in every field a copy of an earlier one."""
    return SelectMessages(STAMPED.on(repair.subject), lambda messages: ~copies(messages))


def reorder(recording: Recording, repair: Repair) -> Edit:
    """Sort the messages by stamp; they count as received in that order."""

    def sorted_by_stamp(messages: Messages) -> Messages:
        found = select(messages, np.argsort(messages.stamps_ns, kind="stable"))
        if found.received_ns is None:
            return found
        return replace(found, received_ns=np.sort(found.received_ns))

    return ChangeMessages(clock_of(recording, repair.subject), sorted_by_stamp)


def stamp_by_receipt(recording: Recording, repair: Repair) -> Edit:
    """Take for the stamp when a message was received, less the time of measuring."""
    lasts_ns = {scans.topic: scan_durations_ns(scans) for scans in recording.scans}

    def by_receipt(messages: Messages) -> Messages:
        if messages.received_ns is None:
            raise CannotEdit(f"{repair.subject}: nothing tells when messages were received")
        measuring_ns = lasts_ns.get(repair.subject, 0)
        return replace(messages, stamps_ns=messages.received_ns - measuring_ns)

    return ChangeMessages(STAMPED.on(repair.subject), by_receipt)


def shift_receipt(recording: Recording, repair: Repair) -> Edit:
    """Add offset_s to every time of receipt."""
    offset_ns = round(repair.number("offset_s") * 1e9)
    return ShiftReceipt(STAMPED.on(repair.subject), offset_ns)


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
