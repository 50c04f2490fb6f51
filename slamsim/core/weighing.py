"""Warnings of a run in order of weight: what harms the map most is told first."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from slamsim.core.result import Event, EventKind, SlamResult

TOLD_PER_KIND = 5

BY_WEIGHT: tuple[EventKind, ...] = (
    *("kidnapped", "torn", "joined", "odometry", "lost", "lidar", "open loop"),
    *("unrefined", "blind", "frozen", "jump", "slip", "gap"),
)
"""From what makes a map wrong, over what may have done so, to what the map has coped with."""
_GRAVE = BY_WEIGHT[: BY_WEIGHT.index("open loop") + 1]


def weighed(result: SlamResult, of_recording: Sequence[str]) -> tuple[str, ...]:
    """The warnings, the gravest first: a line for each kind of event.

    of_recording: what is wrong with the recording itself: it stands after events that make a map
    wrong, and before those that the map has coped with.
    """
    told = by_weight(result.events, _begin_ns(result))
    grave = [words for kind, words in told if kind in _GRAVE]
    light = [words for kind, words in told if kind not in _GRAVE]
    return (*map(str, result.failed), *grave, *of_recording, *light)


def all_weighed(result: SlamResult, of_recording: Sequence[str]) -> tuple[str, ...]:
    """All warnings in the order of ``weighed``, with several events of a kind; last, those of the
    result that no event tells."""
    begin_ns = _begin_ns(result)
    grave = in_words((each for each in result.events if each.kind in _GRAVE), begin_ns)
    light = in_words((each for each in result.events if each.kind not in _GRAVE), begin_ns)
    told = (*map(str, result.failed), *grave, *of_recording, *light)
    return (*told, *(words for words in result.warnings if words not in told))


def in_words(events: Iterable[Event], begin_ns: int) -> tuple[str, ...]:
    """One line per event, times in seconds since the log's begin: the gravest kind first, of each
    the longest, in order of time."""
    told: list[str] = []
    for alike in _by_kind(events).values():
        longest = sorted(alike, key=lambda one: one.start_ns - one.end_ns)[:TOLD_PER_KIND]
        in_time = sorted(longest, key=lambda one: one.start_ns)
        told += [f"{_when(one, begin_ns)}: {one.words}" for one in in_time]
        if rest := len(alike) - len(longest):
            told.append(f"{rest} more like the last, shorter")
    return tuple(told)


def by_weight(events: Iterable[Event], begin_ns: int) -> list[tuple[EventKind, str]]:
    """A line for each kind, the gravest first: its longest event, and how many more there are."""
    told: list[tuple[EventKind, str]] = []
    for kind, alike in _by_kind(events).items():
        longest = max(alike, key=lambda one: one.end_ns - one.start_ns)
        more = f" ({rest} more like this)" if (rest := len(alike) - 1) else ""
        told.append((kind, f"{_when(longest, begin_ns)}: {longest.words}{more}"))
    return told


def _by_kind(events: Iterable[Event]) -> dict[EventKind, list[Event]]:
    """The gravest kind first."""
    found = list(events)
    kinds = {kind: [each for each in found if each.kind == kind] for kind in BY_WEIGHT}
    return {kind: alike for kind, alike in kinds.items() if alike}


def _begin_ns(result: SlamResult) -> int:
    stamps_ns = result.trajectory.stamps_ns
    return int(stamps_ns[0]) if stamps_ns.size else 0


def _when(event: Event, begin_ns: int) -> str:
    start_s, end_s = (event.start_ns - begin_ns) * 1e-9, (event.end_ns - begin_ns) * 1e-9
    if end_s - start_s < 0.1:
        return f"at {start_s:.1f} s"
    return f"{start_s:.1f} to {end_s:.1f} s"
