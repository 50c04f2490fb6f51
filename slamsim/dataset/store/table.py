"""Tables of plain values as Parquet, the same bytes for the same rows."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping, Sequence

import pyarrow as pa
import pyarrow.parquet as pq

from slamsim.dataset.recipe.sequence import Cell

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
