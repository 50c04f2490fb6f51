"""Base class of faults: name, source, size, and the edit that injects the fault."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Annotated, ClassVar, Self

import numpy as np
from pydantic import Field, ValidationError

from slamsim.config.base import Config
from slamsim.config.sensors import SensorsConfig
from slamsim.core.types import BoolArray, IntArray
from slamsim.guard.errors import SlamsimError
from slamsim.recording import RawStream, Recording
from slamsim.recording.edits.base import CannotEdit, Edit, Edits
from slamsim.sensors.motion import PoseSamples


class Fault(Config, ABC):
    """One thing that goes wrong with recordings; a file of ``configs/faults`` is one of these.

    A kind has further fields that say what it changes and how. The first that is a number is
    its size (``SIZE`` has its name), unless the kind says ``SIZE = None``: it is there or not. In a
    file the size is the clearly harmful one: with it the map or the pose is lost.
    """

    SIZE: ClassVar[str | None] = None

    name: str = Field(pattern=r"[a-z][a-z0-9_]*", max_length=64)
    """What the fault is called; the name of its file."""
    title: str = Field(min_length=1, max_length=200)
    """What goes wrong, in one sentence."""
    kind: str
    """Which kind of fault."""
    expects: str = Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=64)
    """What the checker must call it: the name of a ``FaultKind`` of one of its questions."""
    also: tuple[str, ...] = Field(default=(), strict=False)
    """What the checker may say besides, since it follows from the fault."""
    hides: tuple[str, ...] = Field(default=(), strict=False)
    """What the checker cannot tell any more beside it."""
    source: str = Field(min_length=1, max_length=400)
    """The thread, code or study it was met in."""
    sizes: Annotated[tuple[float, ...], Field(strict=False)] = ()
    """Sizes for the curve of sensitivity, in the unit of the size."""

    @classmethod
    def __pydantic_init_subclass__(cls, **given: object) -> None:
        super().__pydantic_init_subclass__(**given)
        if "SIZE" not in cls.__dict__:
            own = (
                (name, f) for name, f in cls.model_fields.items() if name not in Fault.model_fields
            )
            cls.SIZE = next((name for name, field in own if field.annotation in (int, float)), None)

    @abstractmethod
    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        """What puts the fault into this recording, once; rng: for what is random in it.

        Raises CannotEdit where the recording has nothing that could have the fault.
        """

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """The recording with the fault in it; the one given is left as it was.

        Raises CannotEdit as ``edit`` and the edit itself do.
        """
        return self.edit(recording, rng).apply(recording)

    def told_apart(self, other: Fault) -> bool:
        """Whether both may be in one recording: neither hides the other, nor looks like it."""
        names = ({self.expects, *self.also}, {other.expects, *other.also})
        if names[0] & names[1]:
            return False
        return other.expects not in self.hides and self.expects not in other.hides

    @property
    def size(self) -> float | None:
        return None if self.SIZE is None else float(getattr(self, self.SIZE))

    def with_size(self, size: float) -> Self:
        """The same fault, larger or smaller. Raises SlamsimError for a size that cannot be."""
        if self.SIZE is None:
            raise SlamsimError(f"the fault {self.name} has no size: it is there or not")
        field = type(self).model_fields[self.SIZE]
        value = int(size) if field.annotation is int and float(size).is_integer() else size
        try:
            return type(self).model_validate({**self.model_dump(), self.SIZE: value})
        except ValidationError as error:
            reason = error.errors()[0]["msg"]
            raise SlamsimError(f"the fault {self.name}: {self.SIZE} = {size:g}: {reason}") from None


class SensedFault(Fault, ABC):
    """A fault of the sensing itself, which is no edit: it changes what each ray meets.

    What a laser would have seen in another direction, or at another instant, is not in its
    scans. So the simulator senses the drive with the fault, and ``declare`` is the edit after
    which the messages declare what they did without it. A recording of others, which cannot be
    sensed again, gets ``edit``: the same from its own scans, as near as that can be
    (``resensing``).
    """

    def sensors(self, config: SensorsConfig) -> SensorsConfig:
        """What is sensed with instead of the configured sensors."""
        return config

    def override(self, samples: PoseSamples, config: SensorsConfig) -> PoseSamples:
        """How the laser moves and looks instead of as it is mounted."""
        return samples

    def declare(self, config: SensorsConfig) -> Edit:
        """What is changed in scans sensed so; config: of the healthy sensors."""
        return Edits(())


def some_of(count: int, share: float, rng: np.random.Generator) -> BoolArray:
    """(count,) so many of them at random, at least one."""
    chosen = rng.random(count) < share
    chosen[count // 2 :][:1] = True
    return np.asarray(chosen)


def spells(stamps_ns: IntArray, count: int, length_s: float) -> BoolArray:
    """(n,) whether each of (n,) stamps lies in one of so many spells, evenly spread over all."""
    if stamps_ns.size == 0:
        return np.zeros(0, dtype=np.bool_)
    first, last = float(stamps_ns.min()), float(stamps_ns.max())
    middles = first + (last - first) * (np.arange(count) + 1.0) / (count + 1.0)
    apart_ns = np.abs(stamps_ns[:, None] - middles)
    return np.asarray((apart_ns < 0.5e9 * length_s).any(axis=1))


def span_ns(recording: Recording) -> tuple[int, int]:
    """The first and the last stamp of all streams. Raises CannotEdit if they hold no message."""
    streams: tuple[RawStream, ...] = (
        *recording.scans,
        *recording.imus,
        *recording.odometries,
        *recording.ticks,
    )
    stamps = [stream.stamps_ns for stream in streams if len(stream)]
    if not stamps:
        raise CannotEdit(f"{recording.name} holds no messages")
    return min(int(s.min()) for s in stamps), max(int(s.max()) for s in stamps)
