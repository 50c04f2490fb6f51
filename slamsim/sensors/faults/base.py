"""What every fault has: a name, where it was met, its size, and how it spoils a recording."""

from __future__ import annotations

import difflib
from abc import ABC, abstractmethod
from typing import Annotated, ClassVar, Self

import numpy as np
from pydantic import Field, ValidationError, field_validator

from slamsim.config.base import Config
from slamsim.config.sensors import SensorsConfig
from slamsim.guard.errors import SlamsimError
from slamsim.recording import Recording
from slamsim.recording.fault_names import FAULT_NAMES
from slamsim.sensors.motion import Knots


class CannotInject(SlamsimError):
    """The recording lacks what this fault would spoil."""


class Fault(Config, ABC):
    """One thing that goes wrong with recordings; a file of ``configs/faults`` is one of these.

    A kind has further fields that say what it spoils and how. ``SIZE`` is the name of the one
    that is its size, None for a fault that is there or not. In a file the size is the clearly
    harmful one: whoever meets it loses the map or the pose.
    """

    SIZE: ClassVar[str | None] = None

    name: str = Field(pattern=r"[a-z][a-z0-9_]*", max_length=64)
    """What the fault is called; the name of its file."""
    title: str = Field(min_length=1, max_length=200)
    """What goes wrong, in one sentence."""
    kind: str
    """Which way of spoiling a recording."""
    expects: str
    """What the checker must call it."""
    also: tuple[str, ...] = Field(default=(), strict=False)
    """What the checker may say besides, since it follows from the fault."""
    hides: tuple[str, ...] = Field(default=(), strict=False)
    """What the checker cannot tell any more beside it."""
    source: str = Field(min_length=1, max_length=400)
    """The thread, code or study it was met in."""
    sizes: Annotated[tuple[float, ...], Field(strict=False)] = ()
    """Sizes for the curve of sensitivity, in the unit of the size."""

    @abstractmethod
    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """The recording with the fault in it; the one given is left as it was.

        Raises CannotInject where the recording has nothing that could be spoilt so.
        """

    @property
    def size(self) -> float | None:
        return None if self.SIZE is None else float(getattr(self, self.SIZE))

    def with_size(self, size: float) -> Self:
        """The same fault, larger or smaller. Raises SlamsimError for a size that cannot be."""
        if self.SIZE is None:
            raise SlamsimError(f"the fault {self.name} has no size: it is there or not")
        field = type(self).model_fields[self.SIZE]
        value = int(size) if field.annotation is int and size == int(size) else size
        try:
            return type(self).model_validate({**self.model_dump(), self.SIZE: value})
        except ValidationError as error:
            reason = error.errors()[0]["msg"]
            raise SlamsimError(f"the fault {self.name}: {self.SIZE} = {size:g}: {reason}") from None

    @field_validator("expects", "also", "hides")
    @classmethod
    def _is_a_known_name(cls, given: str | tuple[str, ...]) -> str | tuple[str, ...]:
        for name in (given,) if isinstance(given, str) else given:
            if name not in FAULT_NAMES:
                near = difflib.get_close_matches(name, FAULT_NAMES, n=1)
                hint = f"; did you mean {near[0]!r}?" if near else ""
                raise ValueError(f"{name!r} is nothing that the checker can say{hint}")
        return given


class SensedFault(Fault, ABC):
    """A fault of the sensing itself, which no finished recording can be given truly.

    In the simulator the drive is sensed with it and ``declare`` makes the messages say what they
    said without it; a foreign recording gets ``inject``, as near as that can be.
    """

    def sensors(self, config: SensorsConfig) -> SensorsConfig:
        """What is sensed with instead of the configured sensors."""
        return config

    def course(self, knots: Knots, config: SensorsConfig) -> Knots:
        """How the laser moves and looks instead of as it is mounted."""
        return knots

    @abstractmethod
    def declare(self, recording: Recording, config: SensorsConfig) -> Recording:
        """What is published of scans sensed so; config: of the healthy sensors."""
