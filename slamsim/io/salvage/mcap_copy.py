"""Copies the intact records of a damaged MCAP file into a new one, with CRCs and a new index."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

from mcap import records

from slamsim.core.progress import Progress
from slamsim.io.salvage.mcap_filler import McapFiller
from slamsim.io.salvage.mcap_salvage import McapSalvage, Piece, WholeMcapChunk
from slamsim.io.salvage.pieces import Gap, LoneMessage
from slamsim.io.salvage.report import RecoveryReport

_UNUSABLE = "a message that nothing declares any more, or that is damaged"
_UNDECLARED = "messages of channels that nothing declares any more"


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
        begun = 0
        for reached, piece in salvage.pieces():
            _take(piece, begun, filler, report)
            begun = reached
            progress(reached, salvage.size)
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
