"""Finding what a mend acts on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

from slamsim.check.findings import Mend
from slamsim.guard.errors import SlamsimError
from slamsim.recording import RawStream, Recording, TransformEdge

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
    recording: Recording, kind: type[Stream], mend: Mend, change: Callable[[Stream], Stream]
) -> Recording:
    """The streams of one kind on the mend's topic changed."""
    if not any(stream.topic == mend.subject for stream in recording.of(kind)):
        raise SlamsimError(
            f"the mend {mend.operation} finds nothing of its kind on {mend.subject!r}"
        )
    return recording.changed(kind, lambda one: change(one) if one.topic == mend.subject else one)


def with_edges(
    recording: Recording, change: Callable[[TransformEdge], TransformEdge | None]
) -> Recording:
    """Every edge changed; None leaves it out."""
    edges = [change(edge) for edge in recording.transforms]
    return replace(recording, transforms=tuple(edge for edge in edges if edge is not None))
