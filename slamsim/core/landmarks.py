"""Tags as landmarks in the plane: how they were seen, and where they are."""

from __future__ import annotations

from dataclasses import dataclass

from slamsim.core.types import FloatArray
from slamsim.guard.numbers import require_covariances, require_finite


@dataclass(frozen=True, slots=True, eq=False)
class TagObservation:
    """A tag as seen at stamp_ns. T_base_tag: (3,) its middle, and the way it faces.

    covariance: (3, 3) of these numbers.
    """

    stamp_ns: int
    number: int
    T_base_tag: FloatArray
    covariance: FloatArray

    def __post_init__(self) -> None:
        require_finite("where a tag was seen", self.T_base_tag, (3,))
        require_covariances("the covariance of a tag", self.covariance[None], (1, 3, 3))


@dataclass(frozen=True, slots=True, eq=False)
class KnownTag:
    """A surveyed tag: T_map_tag (3,) with covariance (3, 3) of these numbers."""

    number: int
    T_map_tag: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class TagsSeen:
    """What the images of a drive show of tags, and those whose places are known."""

    observations: tuple[TagObservation, ...] = ()
    known: tuple[KnownTag, ...] = ()


NO_TAGS = TagsSeen()


@dataclass(frozen=True, slots=True, eq=False)
class Landmark:
    """A tag in the finished map.

    T_map_tag: (3,) its middle, and the way it faces. covariance: (3, 3) of a small step in its own
    frame, relative to where the map is held: its first key frame, or the survey. seen: key frames
    that see it; doubted: of these, those that do not fit and count for nothing.
    """

    number: int
    T_map_tag: FloatArray
    covariance: FloatArray
    seen: int
    doubted: int
    is_surveyed: bool = False
