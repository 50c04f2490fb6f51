"""What a session and the process beside it say to each other, besides key frames and outcome."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from slamsim.config.slam import SlamConfig
from slamsim.slam.back_end import Correction
from slamsim.types import GraphEdge


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """journal: descriptor of a file whose first ``journal_bytes`` are the key frames to begin
    with; closures: what an earlier process found among them."""

    config: SlamConfig
    gyro: bool
    journal: int
    journal_bytes: int
    closures: Sequence[GraphEdge]


@dataclass(frozen=True, slots=True, eq=False)
class News:
    """After a key frame: where it is, and the closures that hold the map together since then."""

    correction: Correction
    closures: tuple[GraphEdge, ...]


@dataclass(frozen=True, slots=True)
class Finish:
    """Asks for the outcome."""


@dataclass(frozen=True, slots=True)
class Done:
    """Progress of the finish."""

    share: float
