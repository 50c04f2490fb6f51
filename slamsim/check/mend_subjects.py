"""Finding what a mend acts on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar, cast

from slamsim.check.findings import Mend
from slamsim.recording import RawStream, Recording, TransformEdge
from slamsim.safe.errors import SlamsimError

STREAMS = ("scans", "imus", "odometries", "ticks", "joints")
Stream = TypeVar("Stream", bound=RawStream)


def number(mend: Mend, name: str) -> float:
    """A parameter as a number. Raises SlamsimError without it."""
    try:
        return float(mend.parameters[name])
    except (KeyError, ValueError):
        raise SlamsimError(f"the mend {mend.operation} needs a number {name}") from None


def edge_subject(edge: TransformEdge) -> str:
    """How findings about stamps name an edge."""
    return f"{edge.topic} {edge.name}"


def with_topic(
    recording: Recording, kind: str, mend: Mend, change: Callable[[Stream], Stream]
) -> Recording:
    """The streams of one kind (a field of ``Recording``) on the mend's topic changed."""
    streams = getattr(recording, kind)
    if not any(stream.topic == mend.subject for stream in streams):
        raise SlamsimError(
            f"the mend {mend.operation} finds nothing of its kind on {mend.subject!r}"
        )
    changed = tuple(change(s) if s.topic == mend.subject else s for s in streams)
    return replace(recording, **cast("dict[str, Any]", {kind: changed}))


def with_edges(
    recording: Recording, change: Callable[[TransformEdge], TransformEdge | None]
) -> Recording:
    """Every edge changed; None leaves it out."""
    edges = [change(edge) for edge in recording.transforms]
    return replace(recording, transforms=tuple(edge for edge in edges if edge is not None))
