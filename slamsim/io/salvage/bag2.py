"""Rebuilds a rosbag2 folder from its readable files, with new metadata.yaml."""

from __future__ import annotations

import shutil
import sqlite3
import struct
from collections.abc import Iterable
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import zstandard
from mcap import records
from mcap.opcode import Opcode

from slamsim.core.progress import Progress
from slamsim.guard.errors import SlamsimError
from slamsim.guard.yaml import load_yaml
from slamsim.io.bag2.metadata import BagFile, Topic, bag_metadata, topic_as_declared
from slamsim.io.bag2.writer import METADATA_RECORD
from slamsim.io.mcap.reader import MESSAGE_HEAD, RECORD_HEAD
from slamsim.io.ros.message_types import plain_message, ros2_types
from slamsim.io.ros.parts import METADATA
from slamsim.io.salvage.mcap_filler import McapFiller
from slamsim.io.salvage.mcap_salvage import McapSalvage, Piece, WholeMcapChunk
from slamsim.io.salvage.report import Recovered, RecoveryReport, recovered
from slamsim.io.salvage.source import Damaged, Gap, LoneMessage, is_sqlite
from slamsim.io.salvage.sqlite_salvage import LARGEST_ID, Row, SqliteSalvage


def recover_bag2(source: Damaged, folder: Path, progress: Progress) -> Recovered:
    """Into a new folder; an SQLite file becomes an MCAP file. Raises as ``recover`` does."""
    done = 0
    reports: list[RecoveryReport] = []
    written: list[tuple[BagFile, McapFiller]] = []
    for path in source.files:
        target = folder / f"{path.stem}.mcap"
        copy = copy_sqlite if is_sqlite(path) else copy_mcap
        report, filler = copy(path, target, partial(_report, progress, done, source.bytes))
        reports.append(report)
        if any(filler.file.counts.values()):
            file = BagFile(target.name, filler.file.counts, filler.file.time_range_ns)
            written.append((file, filler))
        else:
            target.unlink()
        done += path.stat().st_size
    if written:
        files, fillers = [file for file, _ in written], [filler for _, filler in written]
        custom = {
            name: text
            for filler in fillers
            for name, text in filler.metadata.get(METADATA_RECORD, {}).items()
        }
        text = bag_metadata(files, _topics(fillers), custom)
        (folder / METADATA).write_text(text, encoding="utf-8")
    return recovered(folder, reports, _announced(source.path))


def _report(progress: Progress, before: int, total: int, done: float, _: float) -> None:
    progress(before + done, total)


def _topics(fillers: Iterable[McapFiller]) -> list[Topic]:
    """Each once, as the first file that has it declares it."""
    topics: dict[str, Topic] = {}
    for filler in fillers:
        for channel in filler.channels.values():
            schema = filler.schemas.get(channel.schema_id)
            kind = "" if schema is None else schema.name
            topic = topic_as_declared(channel.topic, kind, channel.metadata)
            topics.setdefault(channel.topic, topic)
    return list(topics.values())


def _announced(path: Path) -> dict[str, int] | None:
    """Messages by topic as metadata.yaml has them, if there is one that can be read."""
    try:
        document: Any = load_yaml(path / METADATA).data
        information = document["rosbag2_bagfile_information"]
        return {
            str(topic["topic_metadata"]["name"]): int(topic["message_count"])
            for topic in information["topics_with_message_count"]
        }
    except (SlamsimError, OSError, LookupError, TypeError, ValueError):
        return None


_UNUSABLE = "a message that nothing declares any more, or that is damaged"
_UNDECLARED = "messages of channels that nothing declares any more, or that cannot be unpacked"


def copy_mcap(path: Path, target: Path, progress: Progress) -> tuple[RecoveryReport, McapFiller]:
    """(what came back, the finished file). progress counts bytes.

    Whole chunks are copied as they are packed. Messages that stood outside of chunks, and those of
    a chunk that holds some which nothing declares, are packed anew.
    """
    report = RecoveryReport(path)
    salvage = McapSalvage(path)
    with closing(salvage.file), target.open("xb") as stream:
        filler = McapFiller(stream, salvage.profile, report)
        for known in salvage.summary.declarations:
            filler.know(known)
        for begun, piece in salvage.pieces(progress):
            _take(piece, begun, filler, report)
        filler.finish()
    if not salvage.ended:
        report.note(f"{path.name} has no end: what should have followed is not counted as lost")
    if salvage.summary.messages is not None:
        report.announced = filler.by_topic(salvage.summary.messages)
    return report, filler


def _take(piece: Piece | Gap, begun: int, filler: McapFiller, report: RecoveryReport) -> None:
    """begun: the byte from which on it was looked for."""
    match piece:
        case Gap():
            messages = None if piece.messages is None else filler.by_topic(piece.messages)
            report.lose(piece.first_byte, piece.bytes, piece.reason, messages)
        case WholeMcapChunk():
            undeclared = filler.chunk(piece.chunk, piece.content)
            if undeclared:
                report.lose(begun, len(piece.chunk.data), f"{undeclared} {_UNDECLARED}", {})
            if not piece.chunk.uncompressed_crc:
                report.note(f"{report.path.name}: chunks without a checksum were taken as they are")
        case LoneMessage():
            if not filler.unchecked_message(piece.record):
                report.lose(begun, len(piece.record), _UNUSABLE, {})
            report.note(f"{report.path.name}: messages without a checksum were taken as they are")
        case records.Metadata():
            filler.file.put_metadata(piece.name, piece.metadata)
            filler.metadata[piece.name] = piece.metadata
        case _:
            filler.declare(piece)


_MOST_CHANNELS = 65_535
_QOS, _HASH = "offered_qos_profiles", "type_description_hash"


def copy_sqlite(path: Path, target: Path, progress: Progress) -> tuple[RecoveryReport, McapFiller]:
    """As ``copy_mcap``: (what came back, the finished file)."""
    report, size = RecoveryReport(path), path.stat().st_size
    work = target.with_suffix(".copy")
    with target.open("xb") as stream:
        filler = McapFiller(stream, "ros2", report)
        try:
            salvage = SqliteSalvage(path, work)
            with closing(salvage.db):
                _copy(salvage, filler, report, size, progress)
        except (sqlite3.Error, ValueError) as error:
            report.lose(0, size, f"damaged, or no recording ({error})")
        filler.finish()
    shutil.rmtree(work, ignore_errors=True)
    report.note("An SQLite recording has no checksums: damage inside a message cannot be seen")
    return report, filler


def _copy(
    salvage: SqliteSalvage,
    filler: McapFiller,
    report: RecoveryReport,
    size: int,
    progress: Progress,
) -> None:
    channels = _declare(salvage, filler)
    salvage.lost.clear()
    kept, kept_bytes, unusable = 0, 0, 0
    for row in salvage.rows("messages", "topic_id, timestamp, data"):
        record = _record(row, channels, kept)
        if record is None or not filler.unchecked_message(record):
            unusable += 1
            continue
        kept, kept_bytes = kept + 1, kept_bytes + len(record)
        progress(min(kept_bytes, size), size)
    each = kept_bytes / max(kept, 1)
    report.packed_bytes = kept_bytes
    for first, last in salvage.lost:
        lost_bytes = round(min((last - first + 1) * each, max(size - kept_bytes, 0)))
        which = "on" if last == LARGEST_ID else f"to {last}"
        report.lose(0, lost_bytes, f"messages from {first} {which} are on damaged pages")
    if unusable:
        reason = f"{unusable} messages of no known topic, damaged, or that cannot be unpacked"
        report.lose(0, round(unusable * each), reason)


def _declare(salvage: SqliteSalvage, filler: McapFiller) -> dict[int, int]:
    """Number of the channel of each topic, by the topic's id in the file."""
    store, definitions = ros2_types(), _definitions(salvage)
    there = salvage.columns_of("topics")
    columns = [name if name in there else "''" for name in (_QOS, _HASH)]
    channels: dict[int, int] = {}
    schemas: dict[str, int] = {}
    topics = salvage.rows("topics", f"name, type, serialization_format, {', '.join(columns)}")
    for number, name, kind, encoding, qos, type_hash in topics:
        if len(channels) == _MOST_CHANNELS or not all(
            isinstance(each, str) for each in (name, kind, encoding)
        ):
            continue
        if kind not in schemas:
            is_standard = kind in store.fielddefs and type_hash in ("", store.hash_rihs01(kind))
            written_as, text = definitions.get(kind, ("ros2msg", ""))
            if is_standard:
                written_as, text = "ros2msg", store.generate_msgdef(kind, ros_version=2)[0]
            schemas[kind] = len(schemas) + 1
            filler.declare(records.Schema(schemas[kind], text.encode(), written_as, kind))
        channels[number] = len(channels) + 1
        metadata = {_QOS: str(qos), "topic_type_hash": str(type_hash)}
        channel = records.Channel(channels[number], name, encoding, metadata, schemas[kind])
        filler.declare(channel)
    return channels


def _definitions(salvage: SqliteSalvage) -> dict[str, tuple[str, str]]:
    """(as what it is written, text) of each type; none in files older than ROS 2 Iron."""
    if not salvage.columns_of("message_definitions"):
        return {}
    rows = salvage.rows("message_definitions", "topic_type, encoding, encoded_message_definition")
    return {str(kind): (str(written_as), str(text)) for _, kind, written_as, text in rows}


def _record(row: Row, channels: dict[int, int], sequence: int) -> bytes | None:
    """An MCAP record of the message, None if it is none."""
    _, topic, log_ns, data = row
    try:
        data = plain_message(data, "cdr")
        head = MESSAGE_HEAD.pack(channels[topic], sequence & 0xFFFFFFFF, log_ns, log_ns)
        return RECORD_HEAD.pack(Opcode.MESSAGE, len(head) + len(data)) + head + bytes(data)
    except (LookupError, TypeError, ValueError, struct.error, zstandard.ZstdError):
        return None
