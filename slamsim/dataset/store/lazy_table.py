"""Parquet tables: read lazily, by row groups, and of plain values, the same bytes for the same
rows."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from slamsim.dataset.recipe.sequence import Cell
from slamsim.dataset.store.place import Location
from slamsim.guard.errors import InputRefused, NotFound
from slamsim.io.parquet.file import cells_of, facts_of

Cells = dict[str, NDArray[Any]]
"""Columns by name, (n,) or (n, width) each."""

_GROUPS_KEPT, _FOOTERS_KEPT = 16, 256
"""By each process: neighbouring reads are mostly of one row group."""


@dataclass(frozen=True, slots=True)
class LazyTable:
    """A file of a data set; it can be pickled.

    All raise NotFound if it is not there, DataDamaged if it is not as it was written, and
    InputRefused if it cannot be read.
    """

    place: Location
    path: str

    @property
    def facts(self) -> dict[str, Any]:
        """What the file says of the whole table."""
        return facts_of(self._footer().schema.to_arrow_schema())

    def __len__(self) -> int:
        return int(self._footer().num_rows)

    def column(self, name: str) -> NDArray[Any]:
        """A whole column: (n,), of lists (n, k)."""
        return self.rows(0, len(self), (name,))[name]

    def rows(self, first: int, last: int, columns: tuple[str, ...] | None = None) -> Cells:
        """All rows from first to before last; columns: all without it."""
        footer, begin = self._footer(), 0
        parts = [cells_of(_schema(self.place, self.path, columns).empty_table())]
        for group in range(footer.num_row_groups):
            end = begin + footer.row_group(group).num_rows
            if first < end and begin < last:
                kept = slice(max(first - begin, 0), last - begin)
                cells = _group(self.place, self.path, group, columns)
                parts.append({name: values[kept] for name, values in cells.items()})
            begin = end
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def _footer(self) -> Any:
        return _footer(self.place, self.path)


@lru_cache(maxsize=_FOOTERS_KEPT)
def _footer(place: Location, path: str) -> Any:
    with _parquet(place, path) as file:
        return file.metadata


@lru_cache(maxsize=_GROUPS_KEPT)
def _group(place: Location, path: str, group: int, columns: tuple[str, ...] | None) -> Cells:
    with _parquet(place, path) as file:
        return cells_of(file.read_row_group(group, None if columns is None else list(columns)))


def _schema(place: Location, path: str, columns: tuple[str, ...] | None) -> pa.Schema:
    schema = _footer(place, path).schema.to_arrow_schema()
    return schema if columns is None else pa.schema([schema.field(name) for name in columns])


@contextmanager
def _parquet(place: Location, path: str) -> Iterator[pq.ParquetFile]:
    place.require_as_written(path)
    try:
        with place.open(path) as file:
            yield pq.ParquetFile(file, page_checksum_verification=True)
    except FileNotFoundError:
        raise NotFound(f"{place.address} has no {path}") from None
    except (pa.ArrowException, OSError) as error:
        raise InputRefused(f"{place.address}/{path}", f"cannot be read: {error}") from None


Row = Mapping[str, Cell]


def rows_to_parquet(rows: Sequence[Row]) -> bytes:
    """One column for every key of any row, in the order of first appearance; null where absent.

    Whole numbers and fractions of one column become fractions; other mixtures become texts.
    """
    names = list(dict.fromkeys(name for row in rows for name in row))
    columns = {name: _column([row.get(name) for row in rows]) for name in names}
    return table_to_parquet(pa.table(columns))


def table_to_parquet(table: pa.Table) -> bytes:
    """A file whose every page carries a checksum."""
    out = io.BytesIO()
    pq.write_table(table, out, compression="zstd", write_page_checksum=True)
    return out.getvalue()


def rows_from_parquet(data: bytes, columns: Iterable[str] | None = None) -> list[dict[str, Cell]]:
    """The rows again. Raises ValueError if the data are cut or damaged."""
    rows: list[dict[str, Cell]] = table_from_parquet(data, columns).to_pylist()
    return rows


def table_from_parquet(data: bytes, columns: Iterable[str] | None = None) -> pa.Table:
    """The table again. Raises ValueError if the data are cut or damaged."""
    try:
        table = pq.read_table(
            io.BytesIO(data),
            columns=list(columns) if columns else None,
            page_checksum_verification=True,
        )
        _ = table.column_names  # which need not be text
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise ValueError(f"no whole Parquet file: {error}") from None
    return table


def _column(values: list[Cell]) -> pa.Array:
    kinds = {type(value) for value in values if value is not None}
    if kinds == {int, float}:
        values = [None if value is None else float(value) for value in values]
    elif len(kinds) > 1:
        values = [None if value is None else str(value) for value in values]
    return pa.array(values)
