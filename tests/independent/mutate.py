"""Random changes of a recording's messages: frames, fields, orders, lengths, units, pairs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np

from independent.rays import Floats
from independent.writer import Message

Numbered = list[tuple[int, Message]]
"""Messages with their numbers, which a change keeps."""

Path = tuple[str, ...]

FRAMES = ("", "odom", "map", "base_link", "base_footprint", "laser", "imu_link", "/laser", "lidar")
UNITS = (1e3, 1e-3, 1e2, 1e-2, 180.0 / np.pi, np.pi / 180.0, 0.3048, -1.0, 2.0, 0.5)


@dataclass
class Mutation:
    """messages: after it. words: what was done, to be read by a person."""

    messages: Numbered
    words: str


def mutated(messages: Numbered, rng: np.random.Generator) -> Mutation:
    """One random change, or two; they may turn out to change nothing."""
    words: list[str] = []
    for _ in range(1 if rng.random() < 0.8 else 2):
        kind = KINDS[int(rng.choice(len(KINDS), p=SHARES))]
        messages, done = kind(messages, rng)
        words.append(done)
    return Mutation(messages, "; ".join(words))


def _topic(messages: Numbered, rng: np.random.Generator) -> str:
    return str(rng.choice(sorted({topic for _, (_, topic, _) in messages})))


def _part(count: int, rng: np.random.Generator) -> tuple[np.ndarray, str]:
    """Which of so many messages are changed."""
    index = np.arange(count)
    kind = int(rng.integers(4))
    if kind == 0:
        return index >= 0, "all"
    if kind == 1:
        return index > 0.5 * count, "second half"
    if kind == 2:
        begin = rng.uniform(0.1, 0.7) * count
        return (index > begin) & (index < begin + 0.2 * count), "a fifth"
    return rng.random(count) < 0.1, "one in ten"


Edit = Callable[[Any, int], None]


def _edited(
    messages: Numbered, topic: str, rng: np.random.Generator, edit: Edit
) -> tuple[Numbered, str]:
    """Messages of a topic, changed in part; edit: changes one in place, of this place in it."""
    rows = [row for row, (_, (_, name, _)) in enumerate(messages) if name == topic]
    chosen, words = _part(len(rows), rng)
    found = list(messages)
    for place, row in enumerate(rows):
        if chosen[place]:
            number, (received_ns, _, message) = messages[row]
            copy = deepcopy(message)
            edit(copy, place)
            found[row] = (number, (received_ns, topic, copy))
    return found, f"{words} of {topic}"


def _leaves(value: Any, path: Path = ()) -> Iterator[Path]:
    """Places of numbers and of sequences of numbers in a message, but not of its stamp."""
    if is_dataclass(value):
        for each in fields(value):
            if each.name not in ("stamp", "__msgtype__"):
                yield from _leaves(getattr(value, each.name), (*path, each.name))
    elif isinstance(value, list) and value and is_dataclass(value[0]):
        yield from _leaves(value[0], (*path, "0"))
    elif isinstance(value, int | float) or (isinstance(value, np.ndarray) and value.size):
        yield path


def _parents(message: Any, path: Path) -> list[Any]:
    """What holds the last member of the path; several where a list is on the way."""
    held = [message]
    for name in path[:-1]:
        if name == "0":
            held = [each for every in held for each in every]
        else:
            held = [getattr(each, name) for each in held]
    return held


def _field(messages: Numbered, rng: np.random.Generator) -> tuple[Numbered, str]:
    """A number is negated, scaled, shifted, set, or keeps its first value."""
    topic = _topic(messages, rng)
    first = next(message for _, (_, name, message) in messages if name == topic)
    paths = sorted(set(_leaves(first)))
    path = paths[int(rng.integers(len(paths)))]
    operation = OPERATIONS[int(rng.integers(len(OPERATIONS)))]
    by, was = float(rng.uniform(-1.0, 1.0)), deepcopy(first)

    def edit(message: Any, place: int) -> None:
        for held, old in zip(_parents(message, path), _parents(was, path), strict=False):
            value = np.asarray(getattr(held, path[-1]), dtype=np.float64)
            new = operation[1](value, np.asarray(getattr(old, path[-1])), by)
            now = getattr(held, path[-1])
            setattr(held, path[-1], new.astype(now.dtype) if value.ndim else float(new))

    found, words = _edited(messages, topic, rng, edit)
    return found, f"{'.'.join(path)} {operation[0]} ({by:.3g}) in {words}"


def _kept(value: Floats, first: Floats, by: float) -> Floats:
    return np.asarray(first if first.shape == value.shape else value, dtype=np.float64)


OPERATIONS: tuple[tuple[str, Callable[[Floats, Floats, float], Floats]], ...] = (
    ("negated", lambda value, first, by: -value),
    ("scaled", lambda value, first, by: value * (1.0 + by)),
    ("scaled a little", lambda value, first, by: value * (1.0 + 0.05 * by)),
    ("shifted", lambda value, first, by: value + by),
    ("shifted a little", lambda value, first, by: value + 0.1 * by),
    ("set to 0", lambda value, first, by: value * 0.0),
    ("not a number", lambda value, first, by: value * np.nan),
    ("as in the first", _kept),
)


def _unit(messages: Numbered, rng: np.random.Generator) -> tuple[Numbered, str]:
    """All numbers that stand beside each other, such as a vector, in another unit."""
    topic = _topic(messages, rng)
    first = next(message for _, (_, name, message) in messages if name == topic)
    paths = sorted(set(_leaves(first)))
    path, factor = paths[int(rng.integers(len(paths)))], float(rng.choice(UNITS))
    names = [one[-1] for one in paths if one[:-1] == path[:-1]] if len(path) > 1 else [path[-1]]

    def edit(message: Any, place: int) -> None:
        for held in _parents(message, path):
            for name in names:
                value = getattr(held, name)
                new = value * factor
                setattr(held, name, new.astype(value.dtype) if hasattr(value, "dtype") else new)

    found, words = _edited(messages, topic, rng, edit)
    return found, f"{'.'.join(path[:-1])} {names} x {factor:.4g} in {words}"


def _frame(messages: Numbered, rng: np.random.Generator) -> tuple[Numbered, str]:
    """Another frame is named."""
    topic, frame = _topic(messages, rng), str(rng.choice(FRAMES))
    child = bool(rng.random() < 0.5)

    def edit(message: Any, place: int) -> None:
        for each in getattr(message, "transforms", [message])[:1]:
            if child and hasattr(each, "child_frame_id"):
                each.child_frame_id = frame
            else:
                each.header.frame_id = frame

    found, words = _edited(messages, topic, rng, edit)
    return found, f"{'child' if child else 'frame'} {frame!r} in {words}"


def _stamps(messages: Numbered, rng: np.random.Generator) -> tuple[Numbered, str]:
    """Stamps are shifted, rounded, scattered, or repeat."""
    topic, kind = _topic(messages, rng), int(rng.integers(4))
    by_ns = float(rng.choice([-1.0, 1.0])) * 10 ** rng.uniform(6.0, 9.5)
    kept: list[int] = []

    def edit(message: Any, place: int) -> None:
        for each in getattr(message, "transforms", [message]):
            stamp = each.header.stamp
            now = stamp.sec * 1_000_000_000 + stamp.nanosec
            kept[1:] = [now] if place % 3 == 0 else kept[1:] or [now]
            new = (
                now + by_ns,
                now // abs(by_ns) * abs(by_ns),
                now + 0.1 * by_ns * rng.standard_normal(),
                (kept or [now])[-1],
            )[kind]
            stamp.sec, stamp.nanosec = divmod(max(int(new), 0), 1_000_000_000)

    found, words = _edited(messages, topic, rng, edit)
    done = ("shifted", "rounded", "scattered", "repeated")[kind]
    return found, f"stamps {done} ({by_ns * 1e-6:.3g} ms) in {words}"


def _order(messages: Numbered, rng: np.random.Generator) -> tuple[Numbered, str]:
    """Messages of a topic exchange their places, some are lost, or some are doubled; never all,
    for a recording may well lack a topic."""
    topic, kind = _topic(messages, rng), int(rng.integers(3))
    rows = [row for row, (_, (_, name, _)) in enumerate(messages) if name == topic]
    chosen, words = _part(len(rows), rng)
    if chosen.all():
        chosen, words = np.arange(len(rows)) > 0.5 * len(rows), "second half"
    picked = [row for row, one in zip(rows, chosen, strict=True) if one]
    if kind == 0:
        shuffled = list(rng.permutation(picked))
        found = list(messages)
        for row, other in zip(picked, shuffled, strict=True):
            number, (_, _, message) = messages[int(other)]
            found[row] = (number, (messages[row][1][0], topic, message))
        return found, f"shuffled {words} of {topic}"
    gone = set(picked) if kind == 1 else set()
    found = [message for row, message in enumerate(messages) if row not in gone]
    if kind == 2:
        found += [messages[row] for row in picked]
    return found, f"{'lost' if kind == 1 else 'doubled'} {words} of {topic}"


def _lengths(messages: Numbered, rng: np.random.Generator) -> tuple[Numbered, str]:
    """Fewer or more ranges or intensities, or readings moved round."""
    name = str(rng.choice(["ranges", "intensities"]))
    by, kind = int(rng.integers(1, 60)), int(rng.integers(3))

    def edit(message: Any, place: int) -> None:
        value = getattr(message, name)
        if not len(value):
            value = np.ones(len(message.ranges), np.float32)
        longer = np.concatenate([value, value[:by]])
        setattr(message, name, (value[:-by], longer, np.roll(value, by))[kind])

    found, words = _edited(messages, "/scan", rng, edit)
    return found, f"{name} {('shorter', 'longer', 'moved')[kind]} by {by} in {words}"


KINDS = (_field, _unit, _frame, _stamps, _order, _lengths)
SHARES = (0.4, 0.15, 0.15, 0.12, 0.1, 0.08)
