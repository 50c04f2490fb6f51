"""Which key frames hold together: a new part of the map begins where the robot was carried."""

from __future__ import annotations

from bisect import bisect_right


class Parts:
    """Runs of key frames, joined with each other by closures (union-find)."""

    def __init__(self) -> None:
        self._begins = [0]
        self._parent = [0]

    def begin(self, keyframe: int) -> None:
        """This key frame and those after it belong to a part of their own."""
        self._begins.append(keyframe)
        self._parent.append(len(self._parent))

    def of(self, keyframe: int) -> int:
        """A number that is the same for all key frames that hold together."""
        return self._root(bisect_right(self._begins, keyframe) - 1)

    def join(self, one: int, other: int) -> None:
        """Something holds these two key frames together; the earlier part gives its number."""
        low, high = sorted((self.of(one), self.of(other)))
        self._parent[high] = low

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
