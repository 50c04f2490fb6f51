"""Encodes streams of a recording as rows of ROS 2 messages.

The meaning is that of REP 103/105/117/145: metres, radians, seconds; ``inf`` where a beam met
nothing; ``-1`` as first covariance where there is no orientation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamsim.core.types import Float32Array, IntArray
from slamsim.io.ros.layouts import (
    CdrLayout,
    Constants,
    Rows,
    columns_of,
    message_layout,
    set_stamps,
)
from slamsim.recording import (
    RawImu,
    RawJoints,
    RawScans,
    RawStream,
    RawTicks,
    Recording,
    TransformEdge,
)
from slamsim.recording.edits.messages import select
from slamsim.recording.schemas import (
    CLOCK,
    LASER_LAYOUT,
    SCANS,
    TRANSFORM,
    TRANSFORMS,
    Field,
    Schema,
)

_LONGEST_KEPT = 4096
"""Layouts of longer lists are made anew: packed images differ in length, each by its own."""

TEXT = "std_msgs/msg/String"

Which = IntArray | slice
"""Numbers of messages; a slice copies nothing."""
Values = Mapping[str, NDArray[Any] | None]
"""Of each field by its name: (n, ...) of n messages, () or (k,) for all of them, None for none."""


@dataclass(frozen=True, slots=True, eq=False)
class Outgoing:
    """Messages of one topic and one size. log_ns: (n,) when each was received, in file order.

    rows: the messages of these numbers.
    """

    topic: str
    type_name: str
    log_ns: IntArray
    rows: Callable[[Which], Rows]
    latched: bool = False

    @property
    def message_bytes(self) -> int:
        """How long each of them is."""
        return self.rows(np.zeros(0, dtype=np.int64)).dtype.itemsize


def encoded(
    schema: Schema,
    stamps_ns: IntArray,
    values: Values,
    texts: Mapping[str, str | Sequence[str]],
    constants: Mapping[str, Sequence[float]] | None = None,
) -> Rows:
    """(n,) messages of a kind of stream. texts: by their place in the message.

    constants: numbers that the stream does not hold, such as covariances, by their place.
    """
    shape = [part for place, text in texts.items() for part in _shape(place, text)]
    fixed = dict(constants or {})
    for field in schema.fields:
        value = values[field.name]
        if field.is_list and value is not None:
            shape.append((field.paths[0], value.shape[-1]))
        if field.covariance and value is None:
            fixed[field.covariance] = _no_covariance(fixed.get(field.covariance))
            fixed[field.paths[0]] = field.absent
    paths = (path for f in schema.fields if values[f.name] is not None for path in f.paths)
    made = _layout(schema.type_name, paths, shape, fixed).rows(stamps_ns.size)
    set_stamps(made, stamps_ns, schema.stamp)
    _fill(made, schema.fields, values)
    return made


def _layout(
    type_name: str,
    paths: Iterator[str],
    shape: Sequence[tuple[str, str | int]],
    constants: Mapping[str, Sequence[float]],
) -> CdrLayout:
    fixed: Constants = tuple((place, tuple(numbers)) for place, numbers in constants.items())
    longest = max((count for _, count in shape if isinstance(count, int)), default=0)
    made = message_layout if longest <= _LONGEST_KEPT else message_layout.__wrapped__
    return made(type_name, columns_of(paths), tuple(shape), fixed)


def _shape(place: str, text: str | Sequence[str]) -> Iterator[tuple[str, str | int]]:
    if isinstance(text, str):
        yield place, text
    else:
        yield place, len(text)
        yield from ((f"{place}.{number}", each) for number, each in enumerate(text))


def _no_covariance(known: Sequence[float] | None) -> tuple[float, ...]:
    return -1.0, *((known or (0.0,) * 9)[1:])


def _fill(rows: Rows, fields: Sequence[Field], values: Values, at: str = "") -> None:
    for field in fields:
        value = values[field.name]
        if value is None or value.shape[-1:] == (0,):
            continue
        if len(field.paths) == 1:
            rows[f"{at}{field.paths[0]}"] = value
        else:
            for number, path in enumerate(field.paths):
                rows[f"{at}{path}"] = value[..., number]


def encoded_transforms(edges: Sequence[TransformEdge], which: Which) -> Rows:
    """(n,) tf2_msgs/TFMessage that each hold the transforms of one number, of all edges."""
    shape: list[tuple[str, str | int]] = [("transforms", len(edges))]
    places = [f"transforms.{number}." for number in range(len(edges))]
    for edge, at in zip(edges, places, strict=True):
        shape += [(f"{at}{path}", getattr(edge, name)) for name, path in TRANSFORM.frames]
    paths = (f"{at}{path}" for at in places for path in TRANSFORM.paths)
    stamps = [edge.stamps_ns[which] for edge in edges]
    rows = _layout(TRANSFORMS, paths, shape, {}).rows(stamps[0].size if stamps else 1)
    for edge, at, stamps_ns in zip(edges, places, stamps, strict=True):
        set_stamps(rows, stamps_ns, f"{at}{TRANSFORM.stamp}")
        values = {field.name: edge.values(field)[which] for field in TRANSFORM.fields}
        _fill(rows, TRANSFORM.fields, values, at)
    return rows


def text(data: str) -> Rows:
    """One std_msgs/String."""
    return message_layout(TEXT, frozenset(), (("data", data),)).rows(1)


def outgoing(
    recording: Recording, constants: Mapping[str, Mapping[str, Sequence[float]]] | None = None
) -> list[Outgoing]:
    """All that a recording holds, static transforms and description first.

    constants: of topics, as for ``encoded``.
    """
    fixed = constants or {}
    found = [*_description(recording), *_static(recording), *_clock(recording)]
    for stream in sorted(recording.streams, key=_written_first):
        if isinstance(stream, RawScans):
            found += _scans(stream)
        else:
            found.append(stream_messages(stream, fixed.get(stream.topic)))
    return found + [_edge(edge) for edge in recording.moving]


def _written_first(stream: RawStream) -> int:
    """Of messages that came at one instant: the sensors, then what was made of them."""
    order = RawScans, RawImu, RawTicks, RawJoints
    return order.index(type(stream)) if type(stream) in order else len(order)


def stream_messages(
    stream: RawStream, constants: Mapping[str, Sequence[float]] | None = None
) -> Outgoing:
    """The messages of a stream that are all of one size."""
    schema, texts = stream.schema, _texts(stream)

    def rows(which: Which) -> Rows:
        values = {field.name: _values(stream, field, which) for field in schema.fields}
        return encoded(schema, stream.stamps_ns[which], values, texts, constants)

    log_ns = _received(stream.stamps_ns, stream.received_ns)
    return Outgoing(stream.topic, schema.type_name, log_ns, rows)


def _texts(stream: RawStream) -> dict[str, str | Sequence[str]]:
    texts: dict[str, str | Sequence[str]] = {
        path: _first(getattr(stream, name)) for name, path in stream.schema.frames
    }
    if isinstance(stream, RawJoints):
        texts["name"] = stream.names
    return texts


def _values(stream: RawStream, field: Field, which: Which) -> NDArray[Any] | None:
    value = stream.values(field)
    if value is None or field.is_constant:
        return None if value is None else np.asarray(value)
    return np.asarray(value[which])


def _received(stamps_ns: IntArray, received_ns: IntArray | None) -> IntArray:
    """Else at its stamp; never before the message above, for the order to stay."""
    log_ns = stamps_ns if received_ns is None else received_ns
    return np.maximum.accumulate(np.maximum(log_ns, 0))  # MCAP has no time before 0


def _first(names: Sequence[str]) -> str:
    return names[0] if names else ""


def _begin_ns(recording: Recording) -> IntArray:
    """When the recording began: as its clock shows, else by the first message of a sensor."""
    if recording.clock_ns is not None and len(recording.clock_ns):
        return recording.clock_ns[:1, 1]
    streams = (*recording.scans, *recording.imus, *recording.odometries, *recording.ticks)
    firsts = [int(_received(s.stamps_ns, s.received_ns).min()) for s in streams if len(s)]
    return np.array([min(firsts, default=0)], dtype=np.int64)


def _scans(scans: RawScans) -> list[Outgoing]:
    """One for each number of beams."""
    if isinstance(scans.ranges_m, np.ndarray):
        beams = np.full(len(scans), scans.ranges_m.shape[1])
    else:
        beams = np.array([len(row) for row in scans.ranges_m], dtype=np.int64)
    log_ns = _received(scans.stamps_ns, scans.received_ns)
    texts = _texts(scans)
    declared = {field.name: scans.values(field) for field in LASER_LAYOUT}
    found = []
    for count in np.unique(beams).tolist():
        mine = np.flatnonzero(beams == count)

        def rows(which: Which, mine: IntArray = mine, count: int = count) -> Rows:
            chosen = which if mine.size == len(scans) else mine[which]
            values: dict[str, NDArray[Any] | None] = {
                **{name: column[chosen] for name, column in declared.items()},
                "ranges_m": _chosen(scans.ranges_m, chosen, count),
                "intensities": None,
            }
            if scans.intensities is not None:
                values["intensities"] = _chosen(scans.intensities, chosen, count)
            return encoded(SCANS, scans.stamps_ns[chosen], values, texts)

        found.append(Outgoing(scans.topic, SCANS.type_name, log_ns[mine], rows))
    return found


def _chosen(
    values: Sequence[Float32Array] | Float32Array, which: Which, count: int
) -> Float32Array:
    if isinstance(values, np.ndarray):
        return values[which]
    rows = [values[i] for i in np.arange(len(values))[which].tolist()]
    return np.stack(rows) if rows else np.zeros((0, count), dtype=np.float32)


def _edge(edge: TransformEdge, since: int = 0) -> Outgoing:
    """From one of its transforms on, each in a message of its own."""
    log_ns = _received(edge.stamps_ns, edge.received_ns)[since:]
    topic = "/tf_static" if edge.is_static else edge.topic
    later = [select(edge, np.arange(since, edge.stamps_ns.size)) if since else edge]
    rows = partial(encoded_transforms, later)
    return Outgoing(topic, TRANSFORMS, log_ns, rows, latched=edge.is_static)


def _static(recording: Recording) -> list[Outgoing]:
    """The first of every edge in one message, as a latched topic has it; what is said later of
    an edge in messages of its own."""
    edges = [edge for edge in recording.transforms if edge.is_static and edge.stamps_ns.size]
    if not edges:
        return []
    begin_ns = min(int(_received(edge.stamps_ns, edge.received_ns)[0]) for edge in edges)
    firsts = partial(encoded_transforms, [select(edge, np.array([0])) for edge in edges])
    found = [Outgoing("/tf_static", TRANSFORMS, np.array([begin_ns]), firsts, latched=True)]
    return found + [_edge(edge, since=1) for edge in edges if edge.stamps_ns.size > 1]


def _description(recording: Recording) -> list[Outgoing]:
    description = recording.robot_description
    if description is None:
        return []
    at_ns = _begin_ns(recording)
    topic = "/robot_description"
    return [Outgoing(topic, TEXT, at_ns, lambda which: text(description), latched=True)]


def _clock(recording: Recording) -> list[Outgoing]:
    if recording.clock_ns is None:
        return []
    shown_ns, log_ns = recording.clock_ns.T
    log_ns = _received(shown_ns, log_ns)
    return [
        Outgoing(
            "/clock",
            CLOCK.type_name,
            log_ns,
            lambda which: encoded(CLOCK, shown_ns[which], {}, {}),
        )
    ]
