"""The request for a repair, as a finding states it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

from slamsim.guard.errors import SlamsimError
from slamsim.recording import RawStream, Recording
from slamsim.recording.edits.base import Edit, Target

Choice = TypeVar("Choice", bound=str)


@dataclass(frozen=True, slots=True)
class Repair:
    """One correction that ``slamsim fix`` can apply.

    operation: its name in ``OPERATIONS`` (repairs/apply.py). subject: topic, frame or transform
    that it acts on. parameters: numbers and words under names with units.
    """

    operation: str
    subject: str
    parameters: dict[str, float | str] = field(default_factory=dict)

    def number(self, name: str) -> float:
        """A parameter as a number. Raises SlamsimError without it."""
        try:
            return float(self.parameters[name])
        except (KeyError, ValueError):
            raise SlamsimError(f"the repair {self.operation} needs a number {name}") from None

    def choice(self, name: str, values: tuple[Choice, ...]) -> Choice:
        """A parameter that is one of some words; the first if it is not given. Raises SlamsimError
        for another."""
        found = self.parameters.get(name, values[0])
        for value in values:
            if value == found:
                return value
        raise SlamsimError(f"{name} of the repair {self.operation} is one of {', '.join(values)}")

    def target(self, kind: type[RawStream]) -> Target:
        """The streams of a kind on its subject."""
        return Target((kind,), f"stream that {self.operation} could repair").on(self.subject)


Declaration = Callable[[Recording, Repair], Edit]
"""From a recording and the repair that is asked for to the edit that does it."""
