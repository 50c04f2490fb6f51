"""``manifest.parquet``, one row for each sequence, and the statistics of a data set from it
alone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from slamsim.core.types import FloatArray
from slamsim.dataset.make.shard import MADE
from slamsim.dataset.recipe.sequence import SPLITS
from slamsim.dataset.store.lazy_table import table_from_parquet
from slamsim.dataset.store.place import Location
from slamsim.guard.errors import InputRefused, NotFound
from slamsim.guard.numbers import MOST_COUNT, require_finite

Statistics = dict[str, Any]
"""Numbers, texts, and mappings of them, under stable, unit-bearing keys."""

_FEW = 40
"""A whole number that takes no more values than these is counted value by value."""
_SUMS = {
    "simulated_h": ("quality.duration_s", 1.0 / 3600.0),
    "path_km": ("quality.path_length_m", 1e-3),
    "scans": ("quality.scans", 1),
    "loop_closures": ("quality.loop_closures", 1),
    "overlapping_pairs": ("quality.overlapping_pairs", 1),
    "files": ("files", 1),
    "size_bytes": ("size_bytes", 1),
}
_QUANTILES = {"least": 0.0, "p10": 0.1, "median": 0.5, "p90": 0.9, "most": 1.0}
"""What the card tells of a distribution."""


def statistics(manifest: pa.Table) -> Statistics:
    """Sums of all and of each split, how often each value was drawn, how numbers spread."""
    made = manifest.filter(pc.equal(manifest["status"], MADE))
    splits = {split: made.filter(pc.equal(made["split"], split)) for split in SPLITS}
    return {
        "sequences": manifest.num_rows,
        "failed": manifest.num_rows - made.num_rows,
        **_sums(made),
        "splits": {
            split: {"sequences": part.num_rows, **_sums(part)}
            for split, part in splits.items()
            if part.num_rows
        },
        "faults": fault_counts(made),
        "drawn": {name.removeprefix("drawn."): _counts(made[name]) for name in _counted(made)},
        "numbers": {
            name: _spread(values)
            for name in made.column_names
            if name.startswith(("drawn.", "quality.")) and (values := numbers(made, name)).size
        },
    }


def numbers(table: pa.Table, column: str) -> FloatArray:
    """(n,) the values of a column that are numbers; none of a column of others, or that is not
    there.

    Raises BadNumbers.
    """
    if column not in table.column_names:
        return np.zeros(0)
    kind = table.schema.field(column).type
    if not (pa.types.is_integer(kind) or pa.types.is_floating(kind)):
        return np.zeros(0)
    values = np.asarray(table[column].drop_null().to_numpy(), dtype=np.float64)
    require_finite(f"the column {column} of a manifest", values, (None,), MOST_COUNT)
    return values


def fault_counts(table: pa.Table) -> dict[str, int]:
    """How many sequences have each fault, whatever its size; ``none``: how many are healthy."""
    found = Counter[str]()
    for cell in table["faults"].to_pylist():
        found.update({one.partition(":")[0] for one in str(cell or "none").split(",")})
    return _frequent_first(found)


def _sums(table: pa.Table) -> dict[str, float | int]:
    told: dict[str, float | int] = {"worlds": pc.count_distinct(table["world_index"]).as_py()}
    for name, (column, unit) in _SUMS.items():
        total = float(numbers(table, column).sum()) * unit
        told[name] = round(total) if unit == 1 else _plain(total)
    return told


def _counted(table: pa.Table) -> list[str]:
    """What was drawn from a few values."""
    return [
        field.name
        for field in table.schema
        if field.name.startswith("drawn.")
        and not pa.types.is_floating(field.type)
        and pc.count_distinct(table[field.name]).as_py() <= _FEW
    ]


def _counts(column: pa.ChunkedArray) -> dict[str, int]:
    return _frequent_first(Counter(str(value) for value in column.drop_null().to_pylist()))


def _frequent_first(found: Mapping[str, int]) -> dict[str, int]:
    return dict(sorted(found.items(), key=lambda item: (-item[1], item[0])))


def _spread(values: FloatArray) -> dict[str, float]:
    quantiles = np.quantile(values, list(_QUANTILES.values()))
    named = dict(zip(_QUANTILES, quantiles.tolist(), strict=True))
    return {"mean": _plain(float(values.mean())), **{k: _plain(v) for k, v in named.items()}}


def _plain(value: float) -> float:
    """Six digits: no noise of the last bit."""
    return float(f"{value:.6g}")


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
