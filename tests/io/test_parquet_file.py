"""Parquet tables: equal rows make equal bytes, damage is seen, everybody can open them."""

from __future__ import annotations

import importlib
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from slamsim.io.parquet.file import Cells, Column, ParquetFile, read_table, table_facts

COLUMNS = (
    Column("stamp_ns", "int64"),
    Column("ranges_m", "float32", "of a scan", width=3, repeats=True),
    Column("true_ranges_m", "float32", width=3),
    Column("x_m", "float64"),
    Column("surfaces", "uint16", width=2),
    Column("contact", "bool"),
    Column("frame", "string"),
)


def cells(count: int) -> dict[str, Cells]:
    rng = np.random.default_rng(count)
    ranges = np.round(rng.random((count, 3)) * 30.0, 1).astype(np.float32)
    ranges[::3, 0], ranges[1::3, 1] = np.inf, np.nan
    return {
        "stamp_ns": np.arange(count) * 25_000_000 - 5,
        "ranges_m": ranges,
        "true_ranges_m": rng.random((count, 3)).astype(np.float32),
        "x_m": rng.standard_normal(count),
        "surfaces": rng.integers(0, 65536, (count, 2)).astype(np.uint16),
        "contact": rng.random(count) < 0.5,
        "frame": [f"frame {n % 3}" for n in range(count)],
    }


def write(path: Path, count: int, cuts: list[int]) -> None:
    whole, edges = cells(count), sorted({0, count, *(cut % (count + 1) for cut in cuts)})
    with ParquetFile(path, COLUMNS, {"table": "example", "b": 1, "a": [2.5]}, 16) as file:
        for first, end in pairwise(edges):
            file.append({name: values[first:end] for name, values in whole.items()})


@settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.integers(1, 70), st.lists(st.integers(0, 1000), max_size=6))
def test_cuts_do_not_show_and_every_value_comes_back(
    tmp_path: Path, count: int, cuts: list[int]
) -> None:
    one, other = tmp_path / "one.parquet", tmp_path / "other.parquet"
    write(one, count, [])
    write(other, count, cuts)
    assert one.read_bytes() == other.read_bytes()
    back = read_table(one)
    for name, values in cells(count).items():
        assert np.array_equal(
            back[name], np.asarray(values), equal_nan=back[name].dtype.kind == "f"
        )
        if isinstance(values, np.ndarray):
            assert back[name].dtype == values.dtype


def test_a_table_of_a_data_set_says_in_every_row_whose_it_is(tmp_path: Path) -> None:
    for number, count in ((3, 40), (11, 5)):
        path = tmp_path / f"{number}.parquet"
        with ParquetFile(path, COLUMNS, {"table": "example"}, 16, sequence=number) as file:
            file.append(cells(count))
    whole = pq.read_table(tmp_path)
    rows = whole.group_by("sequence").aggregate([([], "count_all")]).to_pydict()
    assert dict(zip(rows["sequence"], rows["count_all"], strict=True)) == {3: 40, 11: 5}
    assert np.array_equal(read_table(path)["x_m"], cells(5)["x_m"])


def test_what_holds_for_the_table_stands_in_the_file(tmp_path: Path) -> None:
    write(tmp_path / "t.parquet", 5, [])
    assert table_facts(tmp_path / "t.parquet") == {"table": "example", "a": [2.5], "b": 1}


def test_no_flipped_byte_of_the_data_goes_unseen(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    write(path, 40, [])
    sound, expected = path.read_bytes(), read_table(path)
    footer = int.from_bytes(sound[-8:-4], "little") + 8
    rng = np.random.default_rng(1)
    for at in rng.integers(4, len(sound) - footer, 40).tolist():
        damaged = bytearray(sound)
        damaged[at] ^= 0x10
        path.write_bytes(damaged)
        try:
            back = read_table(path)
        except (OSError, ValueError):
            continue
        # Some bytes of a page's header say nothing that a reader uses.
        assert all(np.array_equal(back[n], expected[n], equal_nan=n.endswith("_m")) for n in back)


def test_an_exception_leaves_no_readable_file(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    with pytest.raises(RuntimeError), ParquetFile(path, COLUMNS, {}) as file:
        file.append(cells(3))
        raise RuntimeError
    with pytest.raises((OSError, ValueError)):
        read_table(path)


@pytest.mark.parametrize("library", ["pandas", "polars", "datasets"])
def test_other_libraries_open_it(tmp_path: Path, library: str) -> None:
    module: Any = pytest.importorskip(library)
    path = tmp_path / "t.parquet"
    write(path, 20, [])
    expected = cells(20)
    if library == "datasets":
        table = importlib.import_module("datasets").Dataset.from_parquet(
            str(path), cache_dir=str(tmp_path / "cache")
        )
        ranges, stamps = table["ranges_m"], table["stamp_ns"]
    else:
        table = module.read_parquet(path)
        ranges, stamps = table["ranges_m"], table["stamp_ns"]
        ranges = ranges.to_list()
    rows = np.array([np.asarray(row, dtype=np.float32) for row in ranges])
    assert np.array_equal(rows, np.asarray(expected["ranges_m"]), equal_nan=True)
    assert np.array_equal(np.asarray(stamps), np.asarray(expected["stamp_ns"]))
