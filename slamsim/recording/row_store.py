"""Storage of the ranges of a recording: in memory, or in a file if they are large."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, overload

import numpy as np

from slamsim.core.types import Float32Array, IntArray
from slamsim.guard.output import require_free_space

IN_MEMORY_BYTES = 64 << 20
"""An hour of 360 beams at 10 Hz stays in memory; a log keeps it as long as it is mapped."""
_LARGE_FILES = Path("/var/tmp")


class Ragged(Sequence[Float32Array]):
    """Rows of different lengths in one flat array: row i is values[starts[i]:starts[i + 1]]."""

    def __init__(self, values: Float32Array, starts: IntArray) -> None:
        self._values, self._starts = values, starts

    def __len__(self) -> int:
        return int(self._starts.size - 1)

    @overload
    def __getitem__(self, index: int) -> Float32Array: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[Float32Array]: ...

    def __getitem__(self, index: int | slice) -> Float32Array | Sequence[Float32Array]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        if not -len(self) <= index < len(self):
            raise IndexError(f"row {index} of {len(self)}")
        start, end = self._starts[index % len(self)], self._starts[index % len(self) + 1]
        return self._values[start:end]

    def __iter__(self) -> Iterator[Float32Array]:
        return (self[i] for i in range(len(self)))


class RowStore:
    """Rows of numbers as they come in; what grows beyond the limit goes to an unnamed file.

    The file is in TMPDIR, else in /var/tmp, for /tmp may itself be memory; it vanishes with the
    process. Its pages are read when rows are asked for.
    """

    def __init__(self, limit_bytes: int = IN_MEMORY_BYTES) -> None:
        self._limit_bytes = limit_bytes
        self._blocks: list[Float32Array] = []
        self._lengths: list[IntArray] = []
        self._held_bytes = 0
        self._file: IO[bytes] | None = None

    def add(self, block: Float32Array) -> None:
        """(k, beams) further rows. Raises DiskFull."""
        self._lengths.append(np.full(block.shape[0], block.shape[1]))
        self._blocks.append(block)
        self._held_bytes += block.nbytes
        if self._file is None and self._held_bytes > self._limit_bytes:
            self._file = tempfile.TemporaryFile(dir=large_files_folder())  # noqa: SIM115, as long as the rows
        if self._file is not None:
            require_free_space(large_files_folder(), sum(held.nbytes for held in self._blocks))
            for held in self._blocks:
                self._file.write(np.ascontiguousarray(held, dtype="<f4").tobytes())
            self._blocks = []

    def rows(self) -> Float32Array | Sequence[Float32Array]:
        """Everything that was added, once; an (n, beams) array when all rows are of one length."""
        lengths = np.concatenate([np.zeros(0, dtype=np.int64), *self._lengths])
        values = self._values(int(lengths.sum()))
        if lengths.size and (lengths == lengths[0]).all():
            return values.reshape(lengths.size, int(lengths[0]))
        return Ragged(values, np.concatenate([[0], np.cumsum(lengths)]))

    def _values(self, count: int) -> Float32Array:
        if self._file is None:
            blocks, self._blocks = [block.ravel() for block in self._blocks], []
            return np.concatenate([np.zeros(0, dtype=np.float32), *blocks])
        self._file.flush()
        return np.memmap(self._file, dtype=np.float32, mode="r", shape=(count,))


def large_files_folder() -> Path:
    chosen = os.environ.get("TMPDIR")
    if chosen or not _LARGE_FILES.is_dir():
        return Path(chosen or tempfile.gettempdir())
    return _LARGE_FILES
