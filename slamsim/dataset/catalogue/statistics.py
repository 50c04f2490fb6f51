"""Statistics of a data set, from its manifest alone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from slamsim.core.types import FloatArray
from slamsim.dataset.make.shard import MADE
from slamsim.dataset.recipe.sequence import SPLITS
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
    """The values of a column that are numbers; none of a column of others, or that is not there.

    Raises BadNumbers."""
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
