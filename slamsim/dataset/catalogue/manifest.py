"""``manifest.parquet``: one row for each sequence, put together from the rows of the shards."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import pyarrow as pa

from slamsim.dataset.store.place import Location
from slamsim.dataset.store.table import table_from_parquet
from slamsim.guard.errors import InputRefused, NotFound

MANIFEST = "manifest.parquet"

_HEAD = ("index", "name", "split", "world_index", "seed", "status", "faults")
_GROUPS = ("drawn.", "quality.")
_WHOLE: Mapping[str, pa.DataType] = {
    "index": pa.int64(),
    "world_index": pa.int64(),
    "seed": pa.int64(),
    "files": pa.int64(),
    "size_bytes": pa.int64(),
}
_TEXTS = ("name", "split", "status", "faults", "sha256", "reason", "command")
"""With those above, what every manifest has."""


def manifest(shards: Sequence[pa.Table], versions: Mapping[str, str]) -> pa.Table:
    """The rows of all shards under one schema, with the software that made them.

    shards: in the order of their sequences. A column that only some of them have is null in the
    others; numbers and texts in one column become texts.
    """
    whole = joined(shards)
    columns = {name: _column(name, whole) for name in _in_order(whole.column_names)}
    software = ", ".join(f"{name} {version}" for name, version in versions.items())
    return pa.table({**columns, "versions": pa.repeat(software, whole.num_rows)})


def joined(shards: Sequence[pa.Table]) -> pa.Table:
    """The rows of all shards, one after the other, columns in the order of first appearance."""
    if not shards:
        return pa.table({})
    try:
        return pa.concat_tables(shards, promote_options="default").combine_chunks()
    except pa.ArrowTypeError:  # numbers and texts in one column
        names = dict.fromkeys(name for shard in shards for name in shard.column_names)
        return pa.table({name: _joined(name, shards) for name in names})


def _column(name: str, table: pa.Table) -> pa.ChunkedArray:
    kind = _kind(name, (table,))
    if name not in table.column_names:
        return pa.chunked_array([pa.nulls(table.num_rows, kind)])
    return table.column(name).cast(kind)


def _in_order(names: Iterable[str]) -> list[str]:
    """What identifies a sequence, what was drawn, what came of it, its files."""
    places = {name: place for place, name in enumerate(_HEAD)}

    def group(name: str) -> int:
        prefixes = [i for i, prefix in enumerate(_GROUPS) if name.startswith(prefix)]
        return len(_HEAD) + (prefixes[0] if prefixes else len(_GROUPS))

    every = dict.fromkeys((*_HEAD, *names, *_WHOLE, *_TEXTS))
    return sorted(every, key=lambda name: places.get(name, group(name)))


def _joined(name: str, shards: Sequence[pa.Table]) -> pa.ChunkedArray:
    kind = _kind(name, shards)
    parts = [
        shard.column(name).cast(kind)
        if name in shard.column_names
        else pa.nulls(shard.num_rows, kind)
        for shard in shards
    ]
    chunks = [
        chunk
        for part in parts
        for chunk in (part.chunks if isinstance(part, pa.ChunkedArray) else [part])
    ]
    return pa.chunked_array(chunks, kind).combine_chunks()


def _kind(name: str, shards: Sequence[pa.Table]) -> pa.DataType:
    if name in _WHOLE:
        return _WHOLE[name]
    if name in _TEXTS:
        return pa.string()
    kinds = {shard.schema.field(name).type for shard in shards if name in shard.column_names}
    kinds.discard(pa.null())
    if kinds == {pa.int64(), pa.float64()}:
        return pa.float64()
    return kinds.pop() if len(kinds) == 1 else pa.string()


def read_manifest(place: Location) -> pa.Table:
    """Raises NotFound where there is none, DataDamaged or InputRefused if it is damaged."""
    place.require_as_written(MANIFEST)
    data = place.read(MANIFEST)
    if data is None:
        raise NotFound(f"{place.address} holds no finished data set: there is no {MANIFEST}")
    try:
        table = table_from_parquet(data)
    except ValueError as error:
        raise InputRefused(f"{place.address}/{MANIFEST}", str(error)) from None
    if lacking := [name for name in (*_HEAD, *_WHOLE, *_TEXTS) if name not in table.column_names]:
        raise InputRefused(f"{place.address}/{MANIFEST}", f"it has no column {lacking[0]}")
    return table
