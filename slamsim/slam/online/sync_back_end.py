"""Who keeps the map: the back end in line, as a session uses it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from slamsim.config.slam import SlamConfig
from slamsim.core.progress import Progress
from slamsim.core.result import Event, FailedStage, MapGraph
from slamsim.core.types import FloatArray, IntArray, PlanarPoses
from slamsim.slam.backend.back_end import BackEnd
from slamsim.slam.backend.correction import Correction
from slamsim.slam.backend.surface_information import SurfaceInformation
from slamsim.slam.calibration.solve import Solved
from slamsim.slam.closures.images import ImageCandidates
from slamsim.slam.frontend.keyframes import Keyframe
from slamsim.slam.mapping.saved_map import SavedMap

MOVED_M, MOVED_RAD = 0.005, 0.001
"""A tenth of a usual cell, at the key frame itself and at the end of a beam of 5 m."""


@dataclass(frozen=True, slots=True, eq=False)
class BackEndOutcome:
    """What the back end made of all key frames in the end.

    unrefined: where the graph alone had put them, before the final refinement. information: what
    holds them since then, None without it. failed: stages whose work is missing. withdrawn_ns: ends
    of the events that said the robot had been carried, and that later evidence refuted.
    """

    graph: MapGraph
    unrefined: PlanarPoses
    accepted: int
    rejected: int
    events: tuple[Event, ...]
    seconds: Mapping[str, float]
    refusals: Mapping[str, int]
    calibration: Solved | None = None
    information: SurfaceInformation | None = None
    failed: tuple[FailedStage, ...] = ()
    withdrawn_ns: frozenset[int] = frozenset()


class MapKeeper(Protocol):
    """Takes key frames, and tells where they really are."""

    def take(self, keyframe: Keyframe) -> None:
        """One more key frame, numbered in order from zero."""
        ...

    def correction(self) -> Correction | None:
        """The newest correction, None before the first."""
        ...

    def changed(self) -> tuple[IntArray, FloatArray] | None:
        """(n,) indices, as they came, and (n, 3) T_map_base of all key frames that were kept; None
        where none of them moved by what a map shows since this was last asked."""
        ...

    def events(self) -> tuple[Event, ...]:
        """What happened since this was last asked."""
        ...

    def finish(self, progress: Progress) -> BackEndOutcome:
        """The final solution."""
        ...

    def keyframes(self) -> Sequence[Keyframe]:
        """Those that the graph of the outcome is made of, numbered as in it."""
        ...

    def close(self) -> None:
        """Leave nothing behind; may be called twice."""
        ...


class Changes:
    """Whether the poses of the key frames changed by what a map shows."""

    def __init__(self) -> None:
        self._known: FloatArray = np.zeros((0, 3))

    def of(self, poses: FloatArray) -> FloatArray | None:
        """poses: (n, 3) of all key frames; given back if one of them moved since they last were."""
        count = min(len(poses), len(self._known))
        moved = np.abs(poses[:count] - self._known[:count])
        if (moved[:, :2] > MOVED_M).any() or (moved[:, 2] > MOVED_RAD).any():
            self._known = poses
            return poses
        self._known = np.concatenate([self._known[:count], poses[count:]])
        return None


class SyncBackEnd:
    """The back end within the session: each key frame is dealt with before ``take`` returns.

    earlier: a map to go on with. fixed: it stays as it is. images: as ``BackEnd`` has them.
    """

    def __init__(
        self,
        config: SlamConfig,
        earlier: SavedMap | None = None,
        fixed: bool = False,
        images: ImageCandidates | None = None,
    ) -> None:
        self._back_end, self._changes = BackEnd(config, images), Changes()
        if earlier is not None and fixed:
            self._back_end.hold(earlier.keyframes, earlier.poses)
        elif earlier is not None:
            self._back_end.restore(earlier.keyframes, earlier.closures, poses=earlier.poses)

    def take(self, keyframe: Keyframe) -> None:
        """See ``MapKeeper``."""
        self._back_end.take(keyframe)

    def correction(self) -> Correction | None:
        """See ``MapKeeper``."""
        return self._back_end.correction()

    def changed(self) -> tuple[IntArray, FloatArray] | None:
        """See ``MapKeeper``."""
        poses = self._changes.of(self._back_end.poses)
        return None if poses is None else (np.array(self._back_end.kept, dtype=np.int64), poses)

    def events(self) -> tuple[Event, ...]:
        """See ``MapKeeper``."""
        return ()

    def finish(self, progress: Progress) -> BackEndOutcome:
        """See ``MapKeeper``."""
        return outcome_of(self._back_end, progress)

    def keyframes(self) -> Sequence[Keyframe]:
        """See ``MapKeeper``."""
        return self._back_end.keyframes

    def close(self) -> None:
        """See ``MapKeeper``."""


def outcome_of(back_end: BackEnd, progress: Progress) -> BackEndOutcome:
    """Finish, and gather all that there is to tell."""
    graph = back_end.finish(progress)
    events = back_end.events(graph)
    return BackEndOutcome(
        graph,
        PlanarPoses(graph.keyframes.stamps_ns, back_end.unrefined),
        back_end.accepted,
        back_end.rejected,
        events,
        dict(back_end.seconds),
        dict(back_end.refusals),
        back_end.calibration,
        back_end.information,
        tuple(back_end.failures),
        back_end.withdrawn_ns,
    )
