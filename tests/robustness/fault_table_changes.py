"""Changes to Parquet tables and archives of arrays by way of their libraries: sound files, odd
contents."""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from fault_seeds import Unfit
from numpy.typing import NDArray

_FACTS: tuple[Any, ...] = (
    *(None, 0, -1, 1e308, float("nan"), float("inf"), 2**70, "", "x", "\x1b[2J", [], {}, [[]]),
    *(["a"], [1], {"a": 1}, True, [{}]),
)
_FLOATS = (np.nan, np.inf, -np.inf, 1e300, -1.0, 0.0, 1e-300)
_WHOLE = (0, 1, -1, 2**31 - 1, -(2**31), 2**62, 2**63 - 1, -(2**63))


def change_table(data: bytes, rng: np.random.Generator) -> bytes:
    """Columns lost, of another type, empty or with odd values; facts; rows."""
    try:
        table = _other_table(pq.read_table(pa.BufferReader(data)), rng)
        sink = io.BytesIO()
        pq.write_table(table, sink, write_page_checksum=True, compression="zstd")
    except (pa.ArrowException, ValueError, TypeError) as error:
        raise Unfit from error
    return sink.getvalue()


def _other_table(table: pa.Table, rng: np.random.Generator) -> pa.Table:
    kind, place = int(rng.integers(8)), int(rng.integers(table.num_columns))
    name, column = table.column_names[place], table.column(place)
    if kind == 0:
        return table.drop_columns([name])
    if kind == 1:
        types = (pa.string(), pa.float32(), pa.int8(), pa.float64(), pa.binary(), pa.bool_())
        cast = column.cast(types[int(rng.integers(len(types)))], safe=False)
        return table.set_column(place, name, cast)
    if kind == 2:
        some = pa.array(rng.random(table.num_rows) < 0.3)
        missing = pa.nulls(table.num_rows, column.type)
        return table.set_column(place, name, pa.compute.if_else(some, missing, column))
    if kind == 3:
        rows = rng.permutation(table.num_rows)[: int(rng.integers(0, table.num_rows + 1))]
        return table.take(pa.array(rows))
    if kind == 4:
        return pa.concat_tables([table] * int(rng.integers(2, 4)))
    if kind == 5:
        return _other_facts(table, rng)
    if kind == 6:
        other = int(rng.integers(table.num_columns))
        return table.set_column(place, name, table.column(other))
    return table.set_column(place, table.field(place), _other_values(column, rng))


def _other_facts(table: pa.Table, rng: np.random.Generator) -> pa.Table:
    facts = json.loads(table.schema.metadata[b"slamsim"])
    key = sorted(facts)[int(rng.integers(len(facts)))]
    held = facts[key]
    value = _FACTS[int(rng.integers(len(_FACTS)))]
    if isinstance(held, list) and held and isinstance(held[0], dict) and rng.random() < 0.8:
        held[0][sorted(held[0])[int(rng.integers(len(held[0])))]] = value
    elif rng.random() < 0.2:
        del facts[key]
    else:
        facts[key] = value
    return table.replace_schema_metadata({b"slamsim": json.dumps(facts).encode()})


def _other_values(column: Any, rng: np.random.Generator) -> Any:
    whole = column.combine_chunks()
    flat = whole.flatten() if pa.types.is_fixed_size_list(whole.type) else whole
    if not (pa.types.is_floating(flat.type) or pa.types.is_integer(flat.type)):
        raise Unfit
    values = _odd_values(flat.to_numpy(zero_copy_only=False).copy(), rng)
    array = pa.array(values, type=flat.type, from_pandas=False)
    if flat is whole:
        return array
    return pa.FixedSizeListArray.from_arrays(array, type=whole.type)


def _odd_values(values: NDArray[Any], rng: np.random.Generator) -> NDArray[Any]:
    """One value, some or all of them replaced."""
    if values.dtype.kind == "f":
        odd: float = _FLOATS[int(rng.integers(len(_FLOATS)))]
    elif values.dtype.kind in "iu":
        bounds = np.iinfo(values.dtype)
        odd = int(np.clip(_WHOLE[int(rng.integers(len(_WHOLE)))], int(bounds.min), int(bounds.max)))
    else:
        raise Unfit
    share = float(rng.choice([1.0, 0.1, 0.0]))
    chosen = rng.random(values.shape) < share
    if values.size:
        chosen.flat[int(rng.integers(values.size))] = True
    with np.errstate(over="ignore"):
        values[chosen] = odd
    return values


def change_arrays(data: bytes, rng: np.random.Generator) -> bytes:
    """One array of an .npz lost, of another type, length or shape, or with odd values."""
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            arrays = dict(file)
    except Exception as error:
        raise Unfit from error
    name = sorted(arrays)[int(rng.integers(len(arrays)))]
    array, kind = arrays[name], int(rng.integers(6))
    if kind == 0:
        del arrays[name]
    elif kind == 1:
        types = ("f4", "f8", "i8", "u1", "U4", "?", "c16")
        with np.errstate(all="ignore"):
            arrays[name] = array.astype(types[int(rng.integers(len(types)))])
    elif kind == 2:
        arrays[name] = np.resize(array, array.size + int(rng.integers(1, 5)))
    elif kind == 3:
        arrays[name] = array[: int(rng.integers(0, len(array) + 1))] if array.ndim else array[None]
    else:
        arrays[name] = _odd_values(array.copy(), rng)
    sink = io.BytesIO()
    with np.errstate(all="ignore"):
        np.savez(sink, allow_pickle=False, **arrays)
    return sink.getvalue()
