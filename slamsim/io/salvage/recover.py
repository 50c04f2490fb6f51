"""Recovers the intact messages of a truncated or damaged recording, in any format.

Of a folder of Parquet tables these are the row groups whose pages match their checksums. What leads
to the rows stands at the end of a table: one that was cut off cannot be read at all."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pyarrow.parquet as pq

from slamsim.core.progress import Progress, silent
from slamsim.guard.errors import InputRefused
from slamsim.guard.files import open_as_found
from slamsim.guard.limits import LIMITS
from slamsim.guard.unpacking import unpack_sound
from slamsim.io.salvage.bag1 import recover_bag1
from slamsim.io.salvage.bag2 import recover_bag2
from slamsim.io.salvage.carmen import recover_carmen
from slamsim.io.salvage.report import Recovered, RecoveryReport, recovered
from slamsim.io.salvage.source import Damaged, Kind, has_packed_name
from slamsim.recording.row_store import large_files_folder

_RECEIVED = "received_ns"


def recover_tables(source: Damaged, folder: Path, progress: Progress) -> Recovered:
    """Into a new file for each table of which anything is left. Its rows count as messages."""
    reports, done = list[RecoveryReport](), 0
    for path in source.files:
        report = RecoveryReport(path)
        _copy(path, folder / path.name, report)
        reports.append(report)
        done += path.stat().st_size
        progress(done, source.bytes)
    return recovered(folder, reports)


def _copy(path: Path, target: Path, report: RecoveryReport) -> None:
    with open_as_found(path) as file:
        size = file.seek(0, 2)
        try:
            table = pq.ParquetFile(file, page_checksum_verification=True)
            schema, groups = table.schema_arrow, table.metadata.num_row_groups
        except Exception as error:
            reason = " ".join(str(error).split())[:200]
            report.lose(0, size, f"the end of the table is cut off or damaged ({reason})")
            report.know(path.stem, "")
            return
        report.know(path.stem, "")
        with pq.ParquetWriter(
            target, schema, compression="zstd", compression_level=1, write_page_checksum=True
        ) as out:
            for number in range(groups):
                _copy_group(table, number, out, report)
    if groups and not report.packed_bytes:
        target.unlink()


def _copy_group(
    table: pq.ParquetFile, number: int, out: pq.ParquetWriter, report: RecoveryReport
) -> None:
    group = table.metadata.row_group(number)
    begin = group.column(0).data_page_offset if group.num_columns else 0
    name = report.path.stem
    try:
        if group.total_byte_size > LIMITS.bag_chunk_bytes:
            raise ValueError("it is larger than any in a recording")
        rows = table.read_row_group(number)
        rows.validate(full=True)
    except Exception as error:
        reason = " ".join(str(error).split())[:200]
        report.lose(begin, group.total_byte_size, f"rows: {reason}", {name: group.num_rows})
        return
    out.write_table(rows, row_group_size=max(rows.num_rows, 1))
    report.packed_bytes += max(group.total_byte_size, 1)
    if rows.num_rows:
        report.keep(name, rows.num_rows, rows.nbytes, _span_ns(rows))


def _span_ns(rows: Any) -> tuple[int, int]:
    """When the first and the last row was received; (0, 0) where no column tells."""
    if _RECEIVED not in rows.column_names:
        return 0, 0
    received_ns = np.asarray(rows.column(_RECEIVED).to_numpy())
    return int(received_ns.min()), int(received_ns.max())


_RECOVER: Mapping[Kind, Callable[[Damaged, Path, Progress], Recovered]] = {
    "ROS 2": recover_bag2,
    "ROS 1": recover_bag1,
    "CARMEN": recover_carmen,
    "Parquet": recover_tables,
}


def recover(source: Damaged, folder: Path, progress: Progress = silent) -> Recovered:
    """Write into a new or empty folder what is whole in a recording, which is only read.

    progress counts bytes of it. Call it inside ``partial_folder``. Raises InputRefused if there is
    not one whole message, and for an archive that is a bomb.
    """
    with _unpacked(source) as (plain, notes):
        result = _RECOVER[source.kind](plain, folder, progress)
    if result.messages == 0:
        losses = dict.fromkeys(loss.reason for loss in result.losses[:3])
        reasons = "; ".join(notes or losses)
        why = f" ({reasons})" if reasons else ""
        raise InputRefused(source.path, f"there is not one whole message in it{why}")
    return replace(result, notes=(*notes, *result.notes))


@contextmanager
def _unpacked(source: Damaged) -> Iterator[tuple[Damaged, list[str]]]:
    """With files that are packed as a whole unpacked as far as they are sound, into a temporary
    folder, and what is wrong with them after that. A CARMEN log is unpacked as it is read."""
    if source.kind == "CARMEN" or not any(map(has_packed_name, source.files)):
        yield source, []
        return
    with TemporaryDirectory(prefix="slamsim-", dir=large_files_folder()) as scratch:
        files, notes = list[Path](), list[str]()
        for path in source.files:
            files.append(Path(scratch, path.stem) if has_packed_name(path) else path)
            if files[-1] != path and (damage := unpack_sound(path, files[-1])):
                notes.append(f"{path.name}: {damage.where}: {damage.reason}; no more is unpacked")
        yield replace(source, files=tuple(files)), notes
