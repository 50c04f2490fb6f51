"""Scans held in memory, for formats that have to be sorted before they can be read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from slamsim.core.types import Scan


class StoredScans:
    """A ScanSource over scans that are in memory already, in the order of their stamps."""

    def __init__(self, scans: Sequence[Scan]) -> None:
        self._scans = tuple(scans)

    def __len__(self) -> int:
        return len(self._scans)

    def __iter__(self) -> Iterator[Scan]:
        return iter(self._scans)
