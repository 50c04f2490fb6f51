"""Result of SLAM on a log: trajectory, pose graph, events and covariances.

As in ``types``, constructors refuse what is not finite: no map is drawn from such numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from slamsim.core.landmarks import Landmark
from slamsim.core.types import BoolArray, FloatArray, Log, PlanarPoses, PlanarTrajectory
from slamsim.guard.numbers import (
    FINITE,
    require_array,
    require_covariances,
    require_finite,
    require_number,
)

EdgeKind = Literal["prior", "odometry", "match", "closure"]


@dataclass(frozen=True, slots=True, eq=False)
class GraphEdge:
    """A measured ``T_source_target``: (x_m, y_m, yaw_rad), covariance (3, 3) in the source frame.

    weight is what the robust estimator left of a closure: 1 believed, 0 withdrawn.
    """

    source: int
    target: int
    T_source_target: FloatArray
    covariance: FloatArray
    kind: EdgeKind
    weight: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class MapGraph:
    """Key frames of one or several drives, by their numbers, and their optimised ``T_map_base``.

    covariances: (n, 3, 3) of a small step (dx_m, dy_m, dyaw_rad) of each key frame's base in its
    own frame, the first key frame being exact.
    """

    keyframes: PlanarPoses
    covariances: FloatArray
    edges: tuple[GraphEdge, ...]

    def __post_init__(self) -> None:
        shape = (len(self.keyframes), 3, 3)
        require_covariances("the covariances of key frames", self.covariances, shape)


@dataclass(frozen=True, slots=True, eq=False)
class PoseGraph(MapGraph):
    """That of one drive, whose key frames are in order of time.

    in_map: (n, 3, 3) covariances like the others, but relative to the map as a whole, laid onto the
    truth as for the ATE: how far off each key frame is where the first one's error, which moves all
    the others together, does not count. The drive is the map where it continues an earlier one.
    None where that is not known.
    """

    keyframes: PlanarTrajectory
    in_map: FloatArray | None = None

    def __post_init__(self) -> None:
        MapGraph.__post_init__(self)
        if self.in_map is not None:
            shape = self.covariances.shape
            require_covariances("the covariances within the map", self.in_map, shape)

    @property
    def position_covariances(self) -> FloatArray:
        """(n, 2, 2) of the position in the map, in the base's own frame; relative to the first key
        frame where they are not known relative to the map as a whole."""
        return (self.covariances if self.in_map is None else self.in_map)[:, :2, :2]


EventKind = Literal[
    "slip",
    "gap",
    "jump",
    "frozen",
    "blind",
    "lost",
    "kidnapped",
    "joined",
    "torn",
    "lidar",
    "unrefined",
    "odometry",
    "open loop",
]
"""What may happen on the way.

slip: wheels that turned without moving the robot so. gap: no scans, or no odometry. jump: a step
of the odometry that no robot makes. frozen: odometry that stood while the scans moved. blind:
scans without enough returns. lost: scans that fitted nowhere. kidnapped: a local map begun anew.
joined: a place that only odometry joins to the rest. torn: scans that contradict the map, or a
step that no robot makes among places that look alike. lidar: a lidar that does not see what its
mounting says. unrefined: a final refinement that was not used.
odometry: most of the path is known from odometry alone, and the map no better than that. open
loop: a stretch of path that no loop checks, at whose end the position is unsure.
"""


@dataclass(frozen=True, slots=True)
class Event:
    """Something a user should know of, and when: stamps on the log's clock, both included.

    words: what happened, in plain English, without the time.
    """

    start_ns: int
    end_ns: int
    kind: EventKind
    words: str


@dataclass(frozen=True, slots=True)
class FailedStage:
    """A stage of SLAM that failed; the result is that of the stages before it.

    keyframe: the number of the key frame at which it failed first. times: how often.
    """

    stage: str
    keyframe: int
    reason: str
    times: int = 1

    def __str__(self) -> str:
        often = f" and {self.times - 1} times more" if self.times > 1 else ""
        return f"{self.stage} failed at key frame {self.keyframe}{often}: {self.reason}"


@dataclass(frozen=True, slots=True)
class Calibrated:
    """A number of the robot as the drive shows it, with its standard deviation.

    observed: whether it was the drive that told it; if not, it is little more than an assumption.
    """

    value: float
    sigma: float
    observed: bool

    def __post_init__(self) -> None:
        require_number("a calibrated number", self.value)
        require_number("the standard deviation of a calibrated number", self.sigma, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class SlamResult:
    """What SLAM made of a log.

    trajectory: ``T_map_base`` at each used scan's stamp. front_end: the same before any loop was
    closed. odometry: ``T_odom_base`` as the log's own odometry has it at the same stamps, or the
    prediction from wheels and gyroscope without it.
    match_quality: (n,) inlier ratio of each scan's match. degenerate: (n,) whether some direction
    of the match was left to odometry.
    closure_refusals: why how many searches for a closure led to none; "score" means that
    nothing was found at all, which is no rejection. events: in time order. failed: stages that
    failed, whose work is missing from the result.
    parts: ``T_map_base`` after each part of the work, at the stamps of scans or of key frames.
    match_information: (n, 3, 3) of a small step of the base in its own frame, zero where a scan
    told nothing. calibration: of wheels, gyroscope and laser, under names that carry their units;
    without what the log does not tell. calibration_beside: of the robot's other lidars, by their
    topics. log: what was mapped, its laser corrected. landmarks: tags
    in the map, by their numbers, where images were looked at.
    """

    trajectory: PlanarTrajectory
    odometry: PlanarTrajectory
    graph: PoseGraph
    match_quality: FloatArray
    degenerate: BoolArray
    closures_accepted: int
    closures_rejected: int
    warnings: tuple[str, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)
    closure_refusals: dict[str, int] = field(default_factory=dict)
    events: tuple[Event, ...] = ()
    front_end: PlanarTrajectory | None = None
    parts: dict[str, PlanarTrajectory] = field(default_factory=dict)
    match_information: FloatArray | None = None
    calibration: dict[str, Calibrated] = field(default_factory=dict)
    calibration_beside: dict[str, dict[str, Calibrated]] = field(default_factory=dict)
    failed: tuple[FailedStage, ...] = ()
    log: Log | None = None
    landmarks: tuple[Landmark, ...] = ()

    def __post_init__(self) -> None:
        count = len(self.trajectory)
        require_finite("the match quality of scans", self.match_quality, (count,), 1.0)
        require_array("the degeneracy of scans", self.degenerate, (count,), "b")
        if self.match_information is not None:
            shape = (count, 3, 3)
            require_finite("the information of scans", self.match_information, shape, FINITE)
