"""The key frames of a map in the order they came, cut into submaps that overlap."""

from __future__ import annotations

from bisect import bisect_left

from slamsim.config.back_end import SubmapConfig
from slamsim.slam.closures.submaps import Submap, Surfaces, make_submap, submap_is_full
from slamsim.slam.frontend.keyframes import Keyframe


class SubmapCutter:
    """Keeps key frames, numbered from zero, and the submaps made of them.

    noise_m: of the lidar, as the newest key frame has it.
    """

    def __init__(self, config: SubmapConfig) -> None:
        self._config = config
        self._scratch = Surfaces()
        self._begin = 0
        self.keyframes: list[Keyframe] = []
        self.submaps: list[Submap] = []
        self.noise_m = 0.0

    def add(self, keyframe: Keyframe, known: bool) -> Submap | None:
        """Keep one more key frame. The open submap, if it is full or the chain broke; the next
        overlaps it.

        known: what the key frame sees lies in other submaps already.
        """
        self.keyframes.append(keyframe)
        self.noise_m = keyframe.noise_m
        if keyframe.broken or known:
            begun, self._begin = self._begin, keyframe.index + known
            return self._finished(begun, keyframe.index) if keyframe.index - begun >= 2 else None
        members = self.keyframes[self._begin :]
        if len(members) < 2 or not submap_is_full(members, self._config):
            return None
        begun, self._begin = self._begin, self._begin + len(members) // 2
        return self._finished(begun, keyframe.index + 1)

    def submap_around(self, index: int) -> int | None:
        """Number of the submap of which a key frame is nearest to the middle; None of one that is
        not kept in any, or not yet."""
        after = bisect_left(self.submaps, index, key=lambda one: one.anchor)
        around = range(max(after - 1, 0), min(after + 1, len(self.submaps)))
        holding = [n for n in around if self.submaps[n].first <= index <= self.submaps[n].last]
        return min(holding, key=lambda n: abs(self.submaps[n].anchor - index), default=None)

    def query(self, index: int, travel_m: float, most: int | None = None) -> Submap:
        """A key frame with those just before it, at most so many: as many as a submap has."""
        most = self._config.max_keyframes if most is None else most
        first = self._first(index, travel_m, most)
        members = self.keyframes[first : index + 1]
        return make_submap(members, len(members) - 1, self._scratch, self.noise_m)

    def around(self, index: int, travel_m: float) -> Submap:
        """A key frame with those up to so much travel before it and after it."""
        first, last = self._first(index, travel_m, index), index
        path_m = self.keyframes[index].path_m
        while (
            last + 1 < len(self.keyframes)
            and not self.keyframes[last + 1].broken
            and self.keyframes[last + 1].path_m <= path_m + travel_m
        ):
            last += 1
        members = self.keyframes[first : last + 1]
        return make_submap(members, index - first, self._scratch, self.noise_m)

    def alone(self, keyframe: Keyframe) -> Submap:
        """A key frame, kept or not, with no other."""
        return make_submap([keyframe], 0, self._scratch, keyframe.noise_m)

    def _first(self, index: int, travel_m: float, most: int) -> int:
        """The first key frame of an unbroken row that ends at this one, so much path long, with at
        most so many before it."""
        first, far_m = index, self.keyframes[index].path_m - travel_m
        while (
            first > 0
            and not self.keyframes[first].broken
            and self.keyframes[first - 1].path_m >= far_m
            and index - first < most
        ):
            first -= 1
        return first

    def _finished(self, begin: int, end: int) -> Submap:
        members = self.keyframes[begin:end]
        submap = make_submap(members, len(members) // 2, self._scratch, self.noise_m)
        self.submaps.append(submap)
        return submap
