"""Tags as landmarks in the plane: how they were seen, and where they are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from slamsim.core.types import FloatArray
from slamsim.guard.numbers import require_covariances, require_finite


@dataclass(frozen=True, slots=True, eq=False)
class TagObservation:
    """A tag as seen at stamp_ns. T_base_tag: (3,) its middle, and the way it faces.

    covariance: (3, 3) of these numbers. camera: the one that saw it, by its name in
    ``TagsSeen.cameras``; any other has no errors that its views share. row: how far down the image,
    0 to 1.
    """

    stamp_ns: int
    number: int
    T_base_tag: FloatArray
    covariance: FloatArray
    camera: str = ""
    row: float = 0.0

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
class CameraErrors:
    """What all observations of a camera have in common: where it is on the base, and standard
    deviations of that place, of the way it looks, of how late its images and their last rows are,
    and of its scale, as a share of all distances.

    By default those of a camera as its recording claims it: place, way and scale may be off by what
    ``slamsim calibrate`` calls a fault once in twenty, clock and shutter by most of a period of
    30 Hz, which no message tells.
    """

    middle_m: tuple[float, float] = (0.0, 0.0)
    place_m: float = 0.005
    yaw_rad: float = 0.0044
    late_s: float = 0.02
    readout_s: float = 0.02
    scale: float = 0.0025

    @property
    def sigmas(self) -> tuple[float, ...]:
        """x, y, yaw, late, readout, scale."""
        placed = (self.place_m, self.place_m, self.yaw_rad)
        return (*placed, self.late_s, self.readout_s, self.scale)


AS_CLAIMED = CameraErrors()


@dataclass(frozen=True, slots=True, eq=False)
class TagsSeen:
    """What the images of a drive show of tags, and those whose places are known. cameras: by the
    names that observations have. continues: whether the drive goes on with a map, in whose frame it
    then is; known tags are that map's. joined: whether anything but a guess says where in it.
    family: of the tags, empty if not told."""

    observations: tuple[TagObservation, ...] = ()
    known: tuple[KnownTag, ...] = ()
    cameras: Mapping[str, CameraErrors] = field(default_factory=dict)
    continues: bool = False
    joined: bool = True
    family: str = ""


NO_TAGS = TagsSeen()


@dataclass(frozen=True, slots=True, eq=False)
class Landmark:
    """A tag in the finished map.

    T_map_tag: (3,) its middle, and the way it faces. covariance: (3, 3) of a small step in its own
    frame, relative to where the map is held: its first key frame, the survey, or the map that it
    goes on with. seen: key frames that see it; doubted: of these, those that do not fit and count
    for nothing. family: whose number that is, empty if not told.
    """

    number: int
    T_map_tag: FloatArray
    covariance: FloatArray
    seen: int
    doubted: int
    is_surveyed: bool = False
    family: str = ""
