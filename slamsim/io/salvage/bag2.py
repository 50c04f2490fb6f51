"""Rebuilds a rosbag2 folder from its readable files, with new metadata.yaml."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any

from slamsim.core.progress import Progress
from slamsim.guard.errors import SlamsimError
from slamsim.guard.yaml import load_yaml
from slamsim.io.bag2.folder import METADATA_RECORD
from slamsim.io.bag2.metadata import METADATA, BagFile, Topic, bag_metadata, topic_as_declared
from slamsim.io.salvage.mcap_copy import copy_mcap
from slamsim.io.salvage.mcap_filler import McapFiller
from slamsim.io.salvage.report import Recovered, RecoveryReport, recovered
from slamsim.io.salvage.source import Damaged, is_sqlite
from slamsim.io.salvage.sqlite_copy import copy_sqlite


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
