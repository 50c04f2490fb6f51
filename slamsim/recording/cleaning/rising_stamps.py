"""Makes stamps strictly increasing, whatever the recording contains.

Stamps may be equal (a driver that writes none), coarse (whole seconds), wrong for some messages
or fall back (a clock that was set, messages that arrived out of order). In that order are used:
the times of receipt, to undo that a clock was set; sorting, where messages were only delayed; the
neighbours' stamps, with the messages between them spread evenly; the times at which they were
received; the order of the messages alone.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass

import numpy as np

from slamsim.core.types import BoolArray, Epoch, FloatArray, IntArray

MOST_DELAY_NS = 1_000_000_000
"""Transport delays a message by less; a stamp that falls back further is wrong."""
MOST_PER_STAMP = 100
"""More messages on one stamp than a 100 Hz sensor on a clock of whole seconds has: no clock."""
ALIKE_FACTOR, ALIKE_SHARE = 3.0, 0.5
"""The time between messages is known if for that share of them it is within the factor of its
median."""
ALIKE_SIZE = 0.9
"""Of the longest part between two settings of a clock, a part that is about as long."""
LARGEST_NS = 2.0**61
"""Nonsense that is spread evenly still adds up to 64 bits."""

LEAST_DEFAULT = 3
"""A clock that is set back passes a stamp twice, not so often."""
LEAST_PERIOD_NS = 100_000
"""No sensor is faster than 10 kHz: what counts faster is no clock."""
_YEAR_2000_NS = 946_684_800 * 1_000_000_000


class NoTime(ValueError):
    """Neither stamps nor times of receipt tell when messages were taken."""


@dataclass(frozen=True, slots=True, eq=False)
class Times:
    """order: (k,) the messages to use, by their places in the recording, in the order of time.
    stamps_ns: (k,) rising. told: what was done to them, in words. made_anew: whether stamps are
    other than written."""

    order: IntArray
    stamps_ns: IntArray
    told: tuple[str, ...] = ()
    made_anew: bool = False


def rising_times(
    stamps_ns: IntArray,
    received_ns: IntArray | None = None,
    *,
    is_repeat: BoolArray | None = None,
    sorting: bool | None = None,
    period_ns: int | None = None,
    what: str = "scans",
) -> Times:
    """Strictly rising stamps for messages in the order of the recording.

    stamps_ns: (n,) as written. received_ns: (n,) when each was received, on any clock; None if not
    known. is_repeat: (n,) whether a message equals the one before bit for bit. sorting: whether
    messages out of order are to be sorted by their stamps, None to tell by how far they fall
    back. period_ns: between messages of which no time is known; without it NoTime is raised for
    such. what: the messages, in words.
    """
    order = np.arange(stamps_ns.size)
    stamps_ns, told = unset(stamps_ns, received_ns)
    made_anew = bool(told)
    late = int((np.diff(stamps_ns) < 0).sum())
    if late and (sorting or (sorting is None and not is_late(stamps_ns))):
        order = np.argsort(stamps_ns, kind="stable")
        told.append(f"{late:,} of {order.size:,} {what} are stamped before the one above: sorted")
    order = _without_repeats(stamps_ns, order, is_repeat, told)
    stamps_ns = stamps_ns[order]
    if (np.diff(stamps_ns) > 0).all():
        return Times(order, stamps_ns, tuple(told), made_anew)
    received_ns = None if received_ns is None else received_ns[order]
    source, rising_ns = _made_anew(stamps_ns, received_ns, period_ns)
    words = f"{_wrong(stamps_ns, what)}: {source}"
    return Times(order, rising_ns, (*told, words), made_anew=True)


def unset(stamps_ns: IntArray, received_ns: IntArray | None) -> tuple[IntArray, list[str]]:
    """(stamps as if their clock had gone on, what was odd), where one was set back.

    stamps_ns: (n,) in the order of the recording. received_ns: (n,) on any clock. As written where
    nothing tells the receipt, or stamps would fall back or repeat all the same.
    """
    if received_ns is None or not is_late(stamps_ns):
        return stamps_ns, []
    ahead_ns = stamps_ns - received_ns
    ahead_ns -= ahead_ns[0]  # else a median of doubles loses nanoseconds
    starts = np.flatnonzero(np.abs(np.diff(ahead_ns)) > MOST_DELAY_NS) + 1
    if not starts.size:
        return stamps_ns, []
    parts = np.split(ahead_ns, starts)
    sizes = np.array([part.size for part in parts])
    # The first of two that are about as long: the same for all streams of one clock.
    kept = int(np.argmax(sizes >= ALIKE_SIZE * sizes.max()))
    offsets_ns = np.array([int(np.median(part)) for part in parts])
    on_ns = stamps_ns - np.repeat(offsets_ns - offsets_ns[kept], sizes)
    if is_late(on_ns) or np.unique(on_ns).size < on_ns.size:
        return stamps_ns, []
    leap_s = 1e-9 * float(offsets_ns[1] - offsets_ns[0])
    told = f"the clock of the stamps was set (by {leap_s:+.4g} s): the times of receipt undo it"
    return on_ns, [told]


def is_late(stamps_ns: IntArray) -> bool:
    """Whether any message is stamped before an earlier one by more than transport explains.

    stamps_ns: (n,).
    """
    return int((np.maximum.accumulate(stamps_ns) - stamps_ns).max(initial=0)) > MOST_DELAY_NS


def _without_repeats(
    stamps_ns: IntArray, order: IntArray, is_repeat: BoolArray | None, told: list[str]
) -> IntArray:
    """Leaves out messages that stand in the recording twice, and sorted ones on a taken stamp.

    Where most messages equal the one before, the scene is still and the stamps are at fault.
    """
    same = np.concatenate([[False], np.diff(stamps_ns[order]) == 0])
    twice = same & np.concatenate([[False], np.diff(order) != 1])
    if is_repeat is not None:
        repeats = same & is_repeat[order]
        if repeats.sum() <= ALIKE_SHARE * order.size:
            twice |= repeats
    if twice.any():
        told.append(f"{int(twice.sum()):,} scans carry the stamp of another one: left out")
    return np.asarray(order[~twice])


def _wrong(stamps_ns: IntArray, what: str) -> str:
    equal = stamps_ns.size - np.unique(stamps_ns).size
    late = int((np.diff(stamps_ns) < 0).sum())
    found = [
        *([f"{equal} carry the stamp of another one"] if equal else []),
        *([f"{late} are stamped before the one above"] if late else []),
    ]
    return f"of {stamps_ns.size} {what} {' and '.join(found)}"


def _made_anew(
    stamps_ns: IntArray, received_ns: IntArray | None, period_ns: int | None
) -> tuple[str, IntArray]:
    """(what is used instead, rising stamps) for stamps that do not rise."""
    known = _known(stamps_ns)
    period = _period(stamps_ns, known)
    is_late = bool((np.diff(stamps_ns) < 0).any())
    by_receipt = None if received_ns is None else _of_receipt(stamps_ns, received_ns)
    if by_receipt is not None and (is_late or period is None):
        return "the times at which they were received are used", by_receipt
    if period is not None:
        told = f"{stamps_ns.size - known.size} are spread evenly between their neighbours' stamps"
        return told, _between_neighbours(stamps_ns, known, period)
    if period_ns is None:
        raise NoTime
    told = f"in the order of the recording they are taken to be {period_ns * 1e-9:.3g} s apart"
    return told, np.asarray(stamps_ns[0] + np.arange(stamps_ns.size) * period_ns)


def _known(stamps_ns: IntArray) -> IntArray:
    """Places of the most stamps that rise, the first of equal ones in a row among them.

    A stamp that stands in ``LEAST_DEFAULT`` places is what a driver writes where it has none.
    """
    first = np.flatnonzero(np.concatenate([[True], np.diff(stamps_ns) != 0]))
    values, places = np.unique(stamps_ns[first], return_counts=True)
    is_default = np.isin(stamps_ns[first], values[places >= LEAST_DEFAULT])
    first = first if is_default.all() else first[~is_default]
    tails: list[int] = []  # the least stamp that ends a rising sequence of each length
    ends: list[int] = []
    before = np.full(first.size, -1, dtype=np.int64)
    for place, stamp_ns in enumerate(stamps_ns[first].tolist()):
        length = bisect_left(tails, stamp_ns)
        tails[length : length + 1] = [stamp_ns]
        ends[length : length + 1] = [place]
        before[place] = ends[length - 1] if length else -1
    chain, place = [], ends[-1]
    while place >= 0:
        chain.append(place)
        place = int(before[place])
    return np.asarray(first[chain[::-1]])


def _period(stamps_ns: IntArray, known: IntArray) -> float | None:
    """Nanoseconds between messages by the known stamps, None where these are too few or uneven."""
    if known.size < 3 or known.size * MOST_PER_STAMP < stamps_ns.size:
        return None
    steps = np.diff(known)
    periods = np.diff(stamps_ns[known]) / steps
    middle = float(np.median(np.repeat(periods, steps)))
    if middle < LEAST_PERIOD_NS:
        return None
    alike = (periods < ALIKE_FACTOR * middle) & (periods > middle / ALIKE_FACTOR)
    return middle if steps[alike].sum() >= ALIKE_SHARE * steps.sum() else None


def _between_neighbours(stamps_ns: IntArray, known: IntArray, period: float) -> IntArray:
    """Unknown stamps spread evenly between the known ones around them.

    After a pause they follow their known neighbour by the period. Where the known ones leave them
    no room, the clock was set back: all later stamps are moved on.
    """
    period = min(period, LARGEST_NS / stamps_ns.size)
    steps: FloatArray = np.full(stamps_ns.size, period)
    for left, right in zip(known[:-1].tolist(), known[1:].tolist(), strict=True):
        gap_ns = float(stamps_ns[right] - stamps_ns[left])
        even = gap_ns / (right - left)
        if right - left == 1 or period / ALIKE_FACTOR < even <= ALIKE_FACTOR * period:
            steps[left + 1 : right + 1] = even
        elif even > period:
            steps[right] = gap_ns - (right - left - 1) * period
    steps[0] = 0.0
    # Double precision would lose nanoseconds beside steps of months.
    after_ns = np.round(np.cumsum(steps, dtype=np.longdouble)).astype(np.int64)
    return np.asarray(stamps_ns[known[0]] + after_ns - after_ns[known[0]])


def _of_receipt(stamps_ns: IntArray, received_ns: IntArray) -> IntArray | None:
    """Rising times of receipt on the clock of most stamps, None where they do not rise either."""
    if (stamps_ns == received_ns).all():
        return None
    known = _known(received_ns)
    period = _period(received_ns, known)
    if period is None:
        return None
    rising_ns = _between_neighbours(received_ns, known, period)
    ahead_ns = stamps_ns - rising_ns
    middle_ns = int(np.median(ahead_ns))
    same_clock = np.abs(ahead_ns - middle_ns) < MOST_DELAY_NS
    return rising_ns + middle_ns if same_clock.mean() >= ALIKE_SHARE else rising_ns


def epoch_of(stamp_ns: int) -> Epoch:
    """UNIX time if the stamp lies after the year 2000; a smaller one does not say what it is."""
    return "unix" if stamp_ns >= _YEAR_2000_NS else "unknown"
