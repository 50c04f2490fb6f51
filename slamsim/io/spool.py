"""Messages that are kept until it is their time to be written."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator

import numpy as np

from slamsim.recording.row_store import IN_MEMORY_BYTES, large_files_folder

Message = tuple[int, int, int, int, bytes]
"""(number of the publisher, log time, publish time, sequence, serialised message); times in ns"""


class Spool:
    """What grows beyond the limit goes to an unnamed file; the caller closes."""

    def __init__(self, limit_bytes: int = IN_MEMORY_BYTES) -> None:
        folder = large_files_folder()
        self._file = tempfile.SpooledTemporaryFile(max_size=limit_bytes, dir=str(folder))  # noqa: SIM115
        self._heads: list[tuple[int, int, int, int, int]] = []

    def close(self) -> None:
        """Give the file back."""
        self._file.close()

    def put(self, number: int, log_ns: int, published_ns: int, sequence: int, data: bytes) -> None:
        self._heads.append((number, log_ns, published_ns, sequence, len(data)))
        self._file.write(data)

    def in_order(self) -> Iterator[Message]:
        """By log time; ties as they were put."""
        sizes = np.array([head[-1] for head in self._heads], dtype=np.int64)
        starts = (np.cumsum(sizes) - sizes).tolist()
        order = np.argsort(np.array([head[1] for head in self._heads]), kind="stable")
        for i in order.tolist():
            number, log_ns, published_ns, sequence, size = self._heads[i]
            self._file.seek(starts[i])
            yield number, log_ns, published_ns, sequence, self._file.read(size)
