"""Writes one Parquet table in parts: equal rows give equal bytes, however they are divided.

Every page carries a checksum. Floating-point numbers are split into their bytes, which is what
lets measurements compress at all; whole numbers of nanoseconds are stored as differences; where
few values repeat, a dictionary holds them. The schema says of each column its unit, and under
the key ``slamsim`` what holds for the whole table.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from slamsim.core.types import FloatArray
from slamsim.guard.errors import Excessive
from slamsim.guard.limits import LIMITS
from slamsim.guard.seal import require_as_written
from slamsim.io.staged_writer import StagedWriter

METADATA_KEY = b"slamsim"
TypeName = Literal[
    "int64",
    "int32",
    "uint32",
    "uint16",
    "uint8",
    "float64",
    "float32",
    "bool",
    "string",
    "binary",
]
Cells = NDArray[Any] | Sequence[str] | Sequence[bytes]
"""The values of one column: (n,), or (n, width) where a row holds a list."""

_ZSTD_LEVEL = 1
_SPLIT = frozenset(("float64", "float32", "uint16"))


@dataclass(frozen=True, slots=True)
class Column:
    """A column that has a value in every row.

    name: with its unit. about: what it is, if the name does not say it all. width: how many
    numbers a row holds as a list of fixed size, 0 for a plain number. repeats: whether the same
    few thousand values come again and again.
    """

    name: str
    type_name: TypeName
    about: str = ""
    width: int = 0
    repeats: bool = False

    def field(self) -> Any:
        """The same as pyarrow has it."""
        kind = pa.string() if self.type_name == "string" else pa.type_for_alias(self.type_name)
        if self.width:
            kind = pa.list_(pa.field("element", kind, nullable=False), self.width)
        about = {"about": self.about} if self.about else None
        return pa.field(self.name, kind, nullable=False, metadata=about)

    @property
    def leaf(self) -> str:
        """What Parquet calls the column that holds the numbers."""
        return f"{self.name}.list.element" if self.width else self.name

    @property
    def encoding(self) -> str | None:
        """None for a dictionary."""
        if self.type_name == "binary":
            return "PLAIN"
        if self.repeats or self.type_name in ("string", "bool", "uint8", "int32", "uint32"):
            return None
        return "BYTE_STREAM_SPLIT" if self.type_name in _SPLIT else "DELTA_BINARY_PACKED"


SEQUENCE = Column("sequence", "int64", "`index` of the manifest of its data set", repeats=True)


class ParquetFile(StagedWriter):
    """A table being written; a context manager. After an exception there is no readable file.

    sequence: of a table of a data set, the number that stands in every row, so that tables of many
    sequences can be read as one.
    """

    def __init__(
        self,
        path: Path,
        columns: Sequence[Column],
        about: Mapping[str, object],
        rows_per_group: int = 1 << 16,
        *,
        sequence: int | None = None,
    ) -> None:
        super().__init__()
        text = json.dumps(about, sort_keys=True)
        columns = columns if sequence is None else (SEQUENCE, *columns)
        fields = [column.field() for column in columns]
        self._schema = pa.schema(fields, metadata={METADATA_KEY: text.encode()})
        self._columns, self._rows_per_group = columns, rows_per_group
        self._sequence = sequence
        self._held: list[Any] = []
        self._held_rows = 0
        encodings = {c.leaf: c.encoding for c in columns if c.encoding is not None}
        # Arrow's own files lose the error number of a disk that fails when they are closed
        sink = self._open.enter_context(path.open("wb"))
        self._writer = pq.ParquetWriter(
            sink,
            self._schema,
            compression="zstd",
            compression_level=_ZSTD_LEVEL,
            use_dictionary=[c.leaf for c in columns if c.encoding is None],
            column_encoding=encodings,
            write_statistics=[c.name for c in columns if not c.width and c.type_name != "binary"],
            write_page_checksum=True,
        )
        # else its destructor would make a whole file of what was not finished
        self._open.callback(setattr, self._writer, "is_open", False)

    def append(self, cells: Mapping[str, Cells]) -> None:
        """The next rows: every column by its name."""
        if self._sequence is not None:
            count = len(next(iter(cells.values())))
            cells = {**cells, SEQUENCE.name: np.full(count, self._sequence)}
        arrays = [
            _array(cells[column.name], field)
            for column, field in zip(self._columns, self._schema, strict=True)
        ]
        part = pa.table(arrays, schema=self._schema)
        self._held.append(part)
        self._held_rows += part.num_rows
        self._write(self._held_rows - self._held_rows % self._rows_per_group)

    def _finish(self) -> None:
        self._write(self._held_rows)
        self._writer.close()

    def _write(self, rows: int) -> None:
        """The first rows of those held, in groups that do not depend on how they came."""
        if rows == 0:
            return
        held = pa.concat_tables(self._held)
        for first in range(0, rows, self._rows_per_group):
            group = held.slice(first, min(self._rows_per_group, rows - first)).combine_chunks()
            self._writer.write_table(group, row_group_size=self._rows_per_group)
        self._held, self._held_rows = [held.slice(rows)], self._held_rows - rows


def _array(cells: Cells, field: Any) -> Any:
    if not isinstance(cells, np.ndarray):
        return pa.array(cells, type=field.type)
    if pa.types.is_fixed_size_list(field.type):
        flat = np.ascontiguousarray(cells).reshape(-1)
        values = pa.array(flat, type=field.type.value_type, from_pandas=False)
        return pa.FixedSizeListArray.from_arrays(values, type=field.type)
    return pa.array(np.ascontiguousarray(cells), type=field.type, from_pandas=False)


def read_table(path: Path) -> dict[str, NDArray[Any]]:
    """The columns of a file, (n,) or (n, width) each; checksums are verified.

    Raises DataDamaged if it is sealed and not as it was written; so does ``table_facts``. Raises
    Excessive for one that unpacks out of all proportion.
    """
    require_as_written(path)
    _require_proportion(path)
    return cells_of(pq.read_table(path, page_checksum_verification=True))


def _require_proportion(path: Path) -> None:
    """Rows that are all equal take no room in a file, but do in memory."""
    metadata = pq.read_metadata(path)
    types = [field.type for field in metadata.schema.to_arrow_schema()]
    widths = (t.list_size if pa.types.is_fixed_size_list(t) else 1 for t in types)
    size_bytes = metadata.num_rows * 8 * sum(widths)
    if size_bytes > max(LIMITS.table_ratio_floor_bytes, LIMITS.table_ratio * path.stat().st_size):
        reason = (
            f"{metadata.num_rows:,} rows unpack to more than {LIMITS.table_ratio} times the file"
        )
        raise Excessive(reason, "table_ratio")


def cells_of(table: pa.Table) -> dict[str, NDArray[Any]]:
    """The columns of a table, (n,) or (n, width) each."""
    return {name: _cells(table.column(name)) for name in table.column_names}


def _cells(column: Any) -> NDArray[Any]:
    whole = column.combine_chunks()
    if pa.types.is_fixed_size_list(whole.type):
        if whole.null_count:
            raise ValueError(f"{whole.null_count} rows have no list")
        width = whole.type.list_size
        return np.asarray(whole.flatten().to_numpy(zero_copy_only=False)).reshape(-1, width)
    return np.asarray(whole.to_numpy(zero_copy_only=False))


def table_facts(path: Path) -> dict[str, Any]:
    """What the file says of the whole table."""
    require_as_written(path)
    return facts_of(pq.read_schema(path))


def facts_of(schema: pa.Schema) -> dict[str, Any]:
    """What a schema says of the whole table."""
    facts: dict[str, Any] = json.loads((schema.metadata or {}).get(METADATA_KEY, b"{}"))
    return facts


def split_axes(vectors: Mapping[str, FloatArray]) -> dict[str, Cells]:
    """One column for each axis of (n, 3) or (n, 4) vectors; ``{}`` in a name becomes x, y, z, w."""
    return {
        name.format(axis): vector[:, index]
        for name, vector in vectors.items()
        for index, axis in enumerate("xyzw"[: vector.shape[1]])
    }


def joined_axes(cells: Mapping[str, Any], name: str, axes: str = "xyz") -> FloatArray:
    """The (n, 3) or (n, 4) vectors that ``split_axes`` made columns of."""
    return np.column_stack([cells[name.format(axis)] for axis in axes])
