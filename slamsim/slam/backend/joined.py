"""Which poses of a graph hang together, known at once after each edge."""

from __future__ import annotations


class Joined:
    """Sets of poses that edges join (union-find by size; Tarjan 1975)."""

    def __init__(self) -> None:
        self._parent, self._size = [0], [1]

    def __len__(self) -> int:
        """One more than the highest number of a pose that an edge leads to, or the first pose."""
        return len(self._parent)

    def join(self, source: int, target: int) -> None:
        """One more edge; its ends are not negative."""
        for number in range(len(self._parent), max(source, target) + 1):
            self._parent.append(number)
            self._size.append(1)
        large, small = self._root(source), self._root(target)
        if large == small:
            return
        if self._size[large] < self._size[small]:
            large, small = small, large
        self._parent[small] = large
        self._size[large] += self._size[small]

    def with_first(self) -> int:
        """How many poses hang together with the first, that one included."""
        return self._size[self._root(0)]

    def _root(self, number: int) -> int:
        while self._parent[number] != number:
            self._parent[number] = self._parent[self._parent[number]]
            number = self._parent[number]
        return number
