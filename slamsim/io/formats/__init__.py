"""Recording formats: one module each, found automatically.

A module of this folder calls ``register`` with a ``Format``; nothing else has to know of it.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Literal

from slamsim.guard.unpacking import PACKINGS
from slamsim.recording import RawOdometry, Recording
from slamsim.recording.choice import topics_of
from slamsim.recording.clouds import CloudsWanted

Truth = Literal["without", "with", "only"]
"""What of a recording is read: all but the truth in it, all, or the truth alone."""


@dataclass(frozen=True, slots=True, eq=False)
class Contents:
    """What was read of a file.

    truth: as a simulator recorded it, if it was asked for and is there. truth_damage: where it is
    and why it cannot be decoded.
    """

    recording: Recording
    truth: RawOdometry | None = None
    truth_damage: tuple[str, str] | None = None


@dataclass(frozen=True, slots=True)
class TopicFacts:
    """A topic as ``survey`` finds it.

    first_ns, last_ns: when its first and last message were received or, where that is not known,
    stamped; None if neither is. frames: that its messages name.
    """

    topic: str
    type_name: str
    messages: int
    first_ns: int | None = None
    last_ns: int | None = None
    frames: tuple[str, ...] = ()

    @property
    def rate_hz(self) -> float | None:
        if self.first_ns is None or self.last_ns is None or self.last_ns <= self.first_ns:
            return None
        return (self.messages - 1) / (1e-9 * (self.last_ns - self.first_ns))


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """What is in a recording. sample: itself, or a part in which each topic occurs."""

    topics: tuple[TopicFacts, ...]
    sample: Recording


def survey_of(recording: Recording) -> Survey:
    """Of a recording that was read as a whole."""
    facts = []
    for topic in topics_of(recording):
        mine = (each for each in recording.streams if each.topic == topic.topic)
        streams = [each for each in mine if each.schema.type_name == topic.type_name]
        times = [s.stamps_ns if s.received_ns is None else s.received_ns for s in streams if len(s)]
        facts.append(
            TopicFacts(
                topic.topic,
                topic.type_name,
                topic.messages,
                min((int(one.min()) for one in times), default=None),
                max((int(one.max()) for one in times), default=None),
                tuple(dict.fromkeys(f for s in streams for f in s.frame_ids)),
            )
        )
    return Survey(tuple(facts), recording)


def _not_found(_: Path) -> Path | None:
    return None


def _unchecked(_: Path) -> str:
    return "nothing: the format has no checksums"


@dataclass(frozen=True, slots=True)
class Format:
    """A format of files or folders that hold a recording.

    rank: of several recordings in one folder that of the lowest is read. suffixes: of its files,
    in lower case. is_packable: whether they may end in one of ``PACKINGS`` besides. about_files,
    about_folders: what it takes, as a user is told. in_folder: the recording in a folder, None for
    none. read: of (path, what of the truth). has_truth: whether recordings may hold one.
    checksums: reads a recording to its last byte and says in words what its checksums prove.
    sampled: surveys a large recording without reading it as a whole, where the format allows it.
    sliced: adds scans that are cut out of point clouds, where the format may hold some.
    """

    name: str
    rank: int
    read: Callable[[Path, Truth], Contents]
    suffixes: tuple[str, ...] = ()
    is_packable: bool = False
    about_files: str = ""
    about_folders: str = ""
    in_folder: Callable[[Path], Path | None] = _not_found
    has_truth: bool = False
    checksums: Callable[[Path], str] = _unchecked
    sampled: Callable[[Path], Survey] | None = None
    sliced: Callable[[Path, Recording, CloudsWanted], Recording] | None = None

    def survey(self, path: Path) -> Survey:
        """What is in a recording, without reading more of it than that takes."""
        if self.sampled is not None:
            return self.sampled(path)
        return survey_of(self.read(path, "without").recording)

    def is_file(self, path: Path) -> bool:
        """Whether the name is that of one of its files."""
        packed = self.is_packable and path.suffix.lower() in PACKINGS
        suffix = (path.with_suffix("") if packed else path).suffix.lower()
        return suffix in self.suffixes and path.is_file()

    def is_at(self, path: Path) -> bool:
        """Whether a path is a recording of this format."""
        return self.in_folder(path) == path if path.is_dir() else self.is_file(path)


_REGISTERED: dict[str, Format] = {}


def register(one: Format) -> None:
    """Read recordings of this format from now on."""
    _REGISTERED[one.name] = one


def formats() -> tuple[Format, ...]:
    """All of them, by rank."""
    for module in pkgutil.iter_modules(__path__):
        import_module(f"{__name__}.{module.name}")
    return tuple(sorted(_REGISTERED.values(), key=lambda each: each.rank))
