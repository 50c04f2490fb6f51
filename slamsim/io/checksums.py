"""What vouches for a recording that nobody sealed: the checksums of its own format."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from slamsim.guard.text import is_packed, open_lines
from slamsim.io.input_errors import refusing
from slamsim.io.open import is_carmen, is_parquet_log, recording_at


def checked_recording(path: Path) -> str:
    """Read a recording to its last byte, and say in words what its checksums vouch for.

    Raises NotFound, or InputRefused where it is damaged or none.
    """
    path = recording_at(path)
    if is_carmen(path):
        return _of_text(path)
    if is_parquet_log(path):
        return _of_tables(path)
    return _of_bag(path)


def _of_text(path: Path) -> str:
    for _ in open_lines(path):
        pass
    if is_packed(path):
        return "the packed text has checksums, and they hold"
    return "nothing: plain text has no checksums"


def _of_tables(folder: Path) -> str:
    from slamsim.io.parquet.file import read_table

    for table in sorted(folder.glob("*.parquet")):
        with refusing(table, "pages"):
            read_table(table)
    return "every page of the tables has a checksum, and they hold; what describes them has none"


def _of_bag(path: Path) -> str:
    from slamsim.io.ros.bag import open_bag
    from slamsim.io.ros.sources import McapSource

    source = open_bag(path).source
    if isinstance(source, McapSource):
        return _of_mcap(source.unvouched)
    if path.suffix.lower() == ".bag":
        return "chunks that are packed with bz2 have checksums, and they hold; others have none"
    return "nothing: SQLite recordings have no checksums, but their pages hang together"


def _of_mcap(unvouched: Counter[str]) -> str:
    lacking = [f"{what} ({count}x)" for what, count in sorted(unvouched.items()) if count]
    if not lacking:
        return "all that is in the MCAP files has checksums, and they hold"
    return f"checksums hold where there are any; without: {', '.join(lacking)}"
