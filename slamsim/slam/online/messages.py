"""What a session and the process beside it say to each other, besides key frames and outcome."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from slamsim.config.slam import SlamConfig
from slamsim.core.result import GraphEdge
from slamsim.core.types import FloatArray
from slamsim.slam.backend.correction import Correction


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """journal: descriptor of a file whose first ``journal_bytes`` are the key frames to begin
    with. Those up to ``taken`` were dealt with by an earlier process: it kept those of ``kept``
    and found ``closures`` among them."""

    config: SlamConfig
    journal: int
    journal_bytes: int
    taken: int
    kept: Sequence[int]
    closures: Sequence[GraphEdge]


@dataclass(frozen=True, slots=True, eq=False)
class News:
    """After a key frame. taken: its index. kept: those that came to be kept since the last news.
    correction: of the last of them. closures: those that came to hold the map together. poses:
    (n, 3) T_map_base of all that were kept, where the map changed since they were last sent."""

    taken: int
    kept: tuple[int, ...]
    correction: Correction
    closures: tuple[GraphEdge, ...]
    poses: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class Finish:
    """Asks for the outcome."""


@dataclass(frozen=True, slots=True)
class Done:
    """Progress of the finish."""

    share: float
