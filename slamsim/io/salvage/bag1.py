"""Rebuilds a ROS 1 bag from its intact records."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path

from slamsim.core.progress import Progress
from slamsim.io.salvage.bag1_connection import Connection
from slamsim.io.salvage.bag1_filler import Bag1Filler
from slamsim.io.salvage.bag1_salvage import (
    Bag1Salvage,
    Piece,
    WholeBag1Chunk,
)
from slamsim.io.salvage.pieces import Gap, LoneMessage
from slamsim.io.salvage.report import Recovered, RecoveryReport, recovered
from slamsim.io.salvage.source import Damaged

_UNKNOWN = "messages that nothing describes any more, or that are damaged"


def recover_bag1(source: Damaged, folder: Path, progress: Progress) -> Recovered:
    """Into a new file in a folder; compressed chunks are copied as they are packed."""
    (path,) = source.files
    report, target = RecoveryReport(path), folder / f"{path.name.split('.')[0] or 'recording'}.bag"
    salvage = Bag1Salvage(path)
    with closing(salvage.file), target.open("xb") as stream:
        filler = Bag1Filler(stream, report)
        for known in salvage.index.connections:
            filler.know(known)
        begun = 0
        for reached, piece in salvage.pieces():
            _take(piece, begun, filler, report)
            begun = reached
            progress(reached, salvage.size)
        filler.finish()
    report.note("A ROS 1 bag has no checksums: damage inside a message cannot be seen")
    if salvage.index.messages is None:
        report.note(f"{path.name} has no end: what should have followed is not counted as lost")
    else:
        report.announced = _by_topic(salvage.index.messages, filler)
    return recovered(target, [report])


def _take(piece: Piece | Gap, begun: int, filler: Bag1Filler, report: RecoveryReport) -> None:
    """begun: the byte from which on it was looked for."""
    match piece:
        case Gap():
            messages = None if piece.messages is None else _by_topic(piece.messages, filler)
            report.lose(piece.first_byte, piece.bytes, piece.reason, messages)
        case WholeBag1Chunk():
            undeclared = filler.chunk(piece)
            if undeclared:
                report.lose(begun, len(piece.packed), f"{undeclared} {_UNKNOWN}", {})
        case LoneMessage():
            if not filler.message(piece.record):
                report.lose(begun, len(piece.record), f"1 {_UNKNOWN}", {})
        case Connection():
            filler.know(piece)


def _by_topic(counts: Mapping[int, int], filler: Bag1Filler) -> dict[str, int]:
    by_topic = Counter[str]()
    for number, count in counts.items():
        if number in filler.known:
            by_topic[filler.known[number].topic] += count
    return dict(by_topic)
