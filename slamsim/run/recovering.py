"""``slamsim recover``: rebuilds a damaged recording from its intact messages."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from slamsim.console.reporter import Reporter
from slamsim.guard.numbers import as_json
from slamsim.guard.output import partial_folder
from slamsim.guard.quantities import as_count, as_size, as_time
from slamsim.io.salvage.recover import recover
from slamsim.io.salvage.report import Loss, Recovered, TopicReport
from slamsim.io.salvage.source import Damaged
from slamsim.run.stages import Stages

RECOVERY = "recovery.json"
_SHOWN_LOSSES = 10


def recover_log(
    source: Damaged, folder: Path, reporter: Reporter, *, overwrite: bool = False
) -> Recovered:
    """Look through the recording and write what is whole into a new folder; what came back.

    Raises InputRefused when nothing of it is whole.
    """
    with partial_folder(folder, overwrite) as partial:
        with Stages(reporter).stage("recover", "MB/s") as progress:
            found = recover(source, partial, lambda n, total: progress(n * 1e-6, total * 1e-6))
        recording = folder / found.recording.relative_to(partial)
        facts = _as_json(source, found)
        (partial / RECOVERY).write_bytes(as_json(RECOVERY, facts))
    _show(reporter, found)
    reporter.say(f"Written to {recording}")
    reporter.result({**facts, "folder": str(folder), "recording": str(recording)})
    return found


def _as_json(source: Damaged, found: Recovered) -> dict[str, object]:
    return {
        "source": str(source.path),
        "format": source.kind,
        "messages": found.messages,
        "topics": [{**asdict(topic), "seconds": round(topic.seconds, 9)} for topic in found.topics],
        "losses": [{**asdict(loss), "path": loss.path.name} for loss in found.losses],
        "notes": list(found.notes),
    }


def _show(reporter: Reporter, found: Recovered) -> None:
    rows = {topic.topic: _topic_in_words(topic) for topic in found.topics}
    reporter.table(f"Recovered: {as_count(found.messages, 'message')}", rows)
    for loss in found.losses[:_SHOWN_LOSSES]:
        reporter.say(_loss_in_words(loss))
    if (more := len(found.losses) - _SHOWN_LOSSES) > 0:
        reporter.say(f"... and {more:,} more, which {RECOVERY} lists")
    for note in found.notes:
        reporter.warn(note)
    if not found.losses:
        reporter.say("No message was lost")


def _topic_in_words(topic: TopicReport) -> str:
    lost = f"{'' if topic.lost_is_known else 'about '}{topic.lost:,} lost"
    kept = (
        f"{as_count(topic.messages, 'message')}, {as_time(topic.seconds)}, {as_size(topic.bytes)}"
    )
    return f"{kept}; {lost if topic.lost else 'none lost'}"


def _loss_in_words(loss: Loss) -> str:
    gap = "" if loss.gap_s is None else f", {as_time(loss.gap_s)}"
    messages = "" if not loss.messages else f", {as_count(sum(loss.messages.values()), 'message')}"
    size = f"{as_size(loss.bytes)}{gap}{messages}"
    return f"Lost at byte {loss.first_byte:,} of {loss.path.name}: {size}: {loss.reason}"
