"""Which key frames hold together: a new part of the map begins where the robot may have been
carried, until something says whether it was."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable


class Parts:
    """Runs of key frames, joined with each other by closures (union-find).

    A run that begins where odometry went on is linked to the one before, as long as nothing says
    that odometry was wrong there.
    """

    def __init__(self) -> None:
        self._begins = [0]
        self._parent = [0]
        self._open: list[int] = []
        self._unknown: list[int] = []
        self.withdrawn: set[int] = set()
        """Key frames that began a run to which, as it turned out, the robot was not carried."""
        self._left: set[int] = set()
        self._followed: set[int] = set()

    def begin(self, keyframe: int, linked: bool = False) -> None:
        """This key frame and those after it belong to a part of their own.

        linked: whether odometry tells where it should be as seen from the one before.
        """
        self._begins.append(keyframe)
        self._parent.append(len(self._parent))
        (self._open if linked else self._unknown).append(keyframe)

    @property
    def carried_to(self) -> tuple[int, ...]:
        """The first key frames of the runs of which nothing tells where they began."""
        return tuple(self._unknown)

    def begun(self, keyframe: int) -> int:
        """The first key frame of the run to which one belongs."""
        return self._begins[bisect_right(self._begins, keyframe) - 1]

    def end(self, begin: int, count: int) -> int:
        """Behind the last key frame, of ``count``, of the run that begins with this one."""
        return next((other for other in self._begins if other > begin), count)

    def open_between(self, one: int, other: int) -> list[int]:
        """The first key frames of the runs between two key frames that odometry links to the run
        before, which nothing has confirmed or refuted yet."""
        low, high = sorted((one, other))
        return [begin for begin in self._open if low < begin <= high]

    def doubted_between(self, one: int, other: int) -> list[int]:
        """Those of them of which a closure alone may say that the robot was carried there."""
        return [begin for begin in self.open_between(one, other) if begin not in self._followed]

    def follow(self, begin: int) -> None:
        """What was seen at the beginning of this run follows on what was seen before it."""
        self._followed.add(begin)

    def linked(self, one: int, other: int) -> bool:
        """Whether something tells where two key frames should be as seen from each other."""
        low, high = sorted((one, other))
        unknown = any(low < begin <= high for begin in self._unknown)
        return not unknown or self.of(one) == self.of(other)

    def withdraw(self, begin: int) -> None:
        """The run that begins here follows on the one before: the robot was not carried."""
        self._open.remove(begin)
        self.withdrawn.add(begin)
        self.join(begin - 1, begin)

    def leave(self, begin: int) -> None:
        """Whether the robot was carried to where this run begins stays unknown: it lies where
        odometry has it."""
        self._open.remove(begin)
        self._left.add(begin)
        self.join(begin - 1, begin)

    def confirm(self, begin: int) -> None:
        """The robot was carried to where this run begins."""
        self._open.remove(begin)
        self._unknown.append(begin)

    def of(self, keyframe: int) -> int:
        """A number that is the same for all key frames that hold together."""
        return self._root(bisect_right(self._begins, keyframe) - 1)

    def join(self, one: int, other: int) -> None:
        """Something holds these two key frames together; the earlier part gives its number."""
        low, high = sorted((self.of(one), self.of(other)))
        self._parent[high] = low

    def cut(self, begin: int) -> None:
        """The robot was carried to this key frame, wherever it was thought to come from; nothing
        joins its run to others until ``rebuild``."""
        if begin not in self._begins:
            self._begins = sorted([*self._begins, begin])
        self.withdrawn.discard(begin)
        self._left.discard(begin)
        self._open = [other for other in self._open if other != begin]
        if begin not in self._unknown:
            self._unknown.append(begin)

    def rebuild(self, pairs: Iterable[tuple[int, int]]) -> None:
        """Only these pairs of key frames, and odometry that was not refuted, join runs by now."""
        self._parent = list(range(len(self._begins)))
        for begin in self.withdrawn | self._left:
            self.join(begin - 1, begin)
        for one, other in pairs:
            self.join(one, other)

    def members(self, keyframe: int, count: int) -> list[slice]:
        """The key frames, of ``count``, that hold together with one."""
        ends = [*self._begins[1:], count]
        root = self.of(keyframe)
        return [
            slice(first, end)
            for part, (first, end) in enumerate(zip(self._begins, ends, strict=True))
            if self._root(part) == root
        ]

    @property
    def loose(self) -> int:
        """How many parts nothing joins to the first."""
        return len({self._root(part) for part in range(len(self._parent))}) - 1

    def _root(self, part: int) -> int:
        while self._parent[part] != part:
            part = self._parent[part]
        return part
