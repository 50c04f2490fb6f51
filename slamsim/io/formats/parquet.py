"""Folders of Parquet tables, as data sets have them."""

from __future__ import annotations

from pathlib import Path

from slamsim.io.formats import Contents, Format, Truth, register
from slamsim.io.input_errors import as_input_errors


def _read(folder: Path, _: Truth) -> Contents:
    from slamsim.io.parquet.reader import read_parquet

    return Contents(read_parquet(folder))


def _in_folder(folder: Path) -> Path | None:
    return folder if (folder / "scans.parquet").is_file() else None


def _checksums(folder: Path) -> str:
    from slamsim.io.parquet.file import read_table

    for table in sorted(folder.glob("*.parquet")):
        with as_input_errors(table, "pages"):
            read_table(table)
    return "every page of the tables has a checksum, and they hold; what describes them has none"


PARQUET = Format(
    name="parquet",
    rank=2,
    read=_read,
    about_folders="Parquet with scans.parquet",
    in_folder=_in_folder,
    checksums=_checksums,
)
register(PARQUET)
