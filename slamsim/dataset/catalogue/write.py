"""Writes the files beside the sequences: manifest, statistics, data card, figures, checksums.

All of it follows from ``dataset.yaml`` and the rows of the shards, byte for byte.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import pyarrow as pa
import pyarrow.compute as pc

from slamsim.config.dump import dump_commented_yaml
from slamsim.dataset.catalogue.card import data_card, licence_text
from slamsim.dataset.catalogue.statistics import MANIFEST, joined, manifest, statistics
from slamsim.dataset.make.identity import IDENTITY, RECIPE, versions
from slamsim.dataset.make.shard import MADE, shard_path
from slamsim.dataset.recipe.model import Recipe
from slamsim.dataset.recipe.preview import contact_sheet
from slamsim.dataset.store.images import IMAGES_OF
from slamsim.dataset.store.lazy_table import table_from_parquet, table_to_parquet
from slamsim.dataset.store.store import READERS, Store
from slamsim.guard.errors import StoreFailed
from slamsim.guard.seal import SUMS, SumsDamaged, read_sums, sha256_of, sums_text

STATISTICS = "statistics.json"

_WORLDS_SHOWN, _SEEN = 6, 2
_AT_ONCE = 256
"""So many shards, of perhaps fifty thousand, are in memory at a time."""


def write_catalogue(store: Store, recipe: Recipe, count: int) -> None:
    """Write it, unless it is there and right; every shard is.

    count: of the sequences. Raises what the store raises, and StoreFailed for a shard that is
    gone or damaged meanwhile.
    """
    shards = [shard_path(number) for number in range(-(-count // recipe.shard_sequences))]
    hashes = {IDENTITY: sha256_of(_read(store, IDENTITY))}
    parts = list[pa.Table]()
    with ThreadPoolExecutor(READERS) as readers:
        for first in range(0, len(shards), _AT_ONCE):
            some = shards[first : first + _AT_ONCE]
            tables = list[pa.Table]()
            for path, data in zip(some, readers.map(partial(_read, store), some), strict=True):
                hashes[path] = sha256_of(data)
                tables.append(_table(store, path, data))
            parts.append(joined(tables))
    if _is_right(store, hashes):
        return
    store.write(SUMS, sums_text({}).encode())  # until all is written, there are no checksums
    table = manifest(parts, versions())
    for path, data in catalogue_files(recipe, table):
        store.write(path, data)
        hashes[path] = sha256_of(data)
    store.write(SUMS, sums_text(hashes).encode())


def catalogue_files(recipe: Recipe, table: pa.Table) -> Iterator[tuple[str, bytes]]:
    """Paths and contents. table: the manifest."""
    from slamsim.dataset.catalogue.figures import dataset_figures

    told = statistics(table)
    made = table.filter(pc.equal(table["status"], MADE))
    figures = dict(dataset_figures(made, told))
    worlds = min(-(-table.num_rows // recipe.sequences_per_world), _WORLDS_SHOWN)
    yield MANIFEST, table_to_parquet(table)
    yield STATISTICS, (json.dumps(told, indent=1, allow_nan=False) + "\n").encode()
    yield RECIPE, dump_commented_yaml(recipe).encode()
    for name, png in figures.items():
        yield f"figures/{name}.png", png
    yield "preview.png", contact_sheet(recipe, worlds)
    yield "LICENSE.txt", licence_text(recipe).encode()
    yield "README.md", data_card(recipe, told, versions(), figures, _with_images(made)).encode()


def _with_images(made: pa.Table) -> tuple[str, ...]:
    """Names of the first sequences that have images."""
    columns = [name for name in made.column_names if name.startswith(IMAGES_OF)]
    rows = made.select(["name", *columns]).slice(0, _WORLDS_SHOWN).to_pylist()
    return tuple(str(row["name"]) for row in rows if any(row[name] for name in columns))[:_SEEN]


def _read(store: Store, path: str) -> bytes:
    data = store.read(path)
    if data is None:
        raise _disturbed(store, f"{path} is gone")
    return data


def _table(store: Store, path: str, data: bytes) -> pa.Table:
    try:
        return table_from_parquet(data)
    except (OSError, ValueError) as error:
        raise _disturbed(store, f"{path} is damaged ({error!s:.100})") from None


def _disturbed(store: Store, what: str) -> StoreFailed:
    return StoreFailed(
        f"{store.address}: {what}: another program changed the data set while it was made; "
        "the same command makes what is missing"
    )


def _is_right(store: Store, given: Mapping[str, str]) -> bool:
    """Whether all that the sums tell of is so, and they tell of all that is given."""
    try:
        hashes = read_sums(store.read(SUMS) or b"")
    except SumsDamaged:
        return False
    return given.keys() <= hashes.keys() and all(
        (given.get(path) or sha256_of(store.read(path) or b"")) == sha256
        for path, sha256 in hashes.items()
    )
