"""The hostile corpus: ``python tests/fault_corpus.py FOLDER`` writes it out.

Each input has a folder of its own. Every one is refused with one sentence, or read right.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

from fault_corpus_base import Hostile
from fault_corpus_images import hostile_images
from fault_corpus_meshes import hostile_meshes
from fault_corpus_robots import hostile_robots
from fault_corpus_yaml import hostile_yaml
from fault_judge import Outcome, Try, Verdict, judged

CORPUS: tuple[Hostile, ...] = (
    *hostile_yaml(),
    *hostile_images(),
    *hostile_meshes(),
    *hostile_robots(),
)

MOST_S = 2.0
MOST_BYTES = 300 << 20


def folder_of(hostile: Hostile, corpus: Path) -> Path:
    """Where it lies in the corpus."""
    return corpus / re.sub(r"\W+", "_", hostile.name)


def written(hostile: Hostile, corpus: Path) -> Path:
    """Writes it out; gives what is to be read."""
    folder = folder_of(hostile, corpus)
    folder.mkdir(parents=True)
    hostile.fill(folder)
    return folder / hostile.file


def verdicts(some: Sequence[Hostile], corpus: Path) -> list[tuple[Hostile, Verdict]]:
    """Each is written and read in a child."""
    tries = [_try(hostile, written(hostile, corpus)) for hostile in some]
    return list(zip(some, judged(tries), strict=True))


def _try(hostile: Hostile, path: Path) -> Try:
    def judge(_: object) -> Outcome:
        return "silent" if hostile.words else "right"

    return Try(hostile.name, lambda: hostile.read(path), judge)


def fault_of(hostile: Hostile, verdict: Verdict) -> str:
    """What is wrong with a verdict, in words; nothing if it is as it should be."""
    expected = "refused" if hostile.words else "right"
    if verdict.outcome != expected:
        return f"{verdict.outcome} instead of {expected}: {verdict.detail}"
    if hostile.words not in verdict.detail:
        return f"{hostile.words!r} is not in: {verdict.detail}"
    if verdict.seconds > MOST_S:
        return f"took {verdict.seconds:.1f} s"
    if verdict.peak_bytes > MOST_BYTES:
        return f"took {verdict.peak_bytes >> 20} MiB"
    return ""


def main(folder: str, some: Iterable[Hostile] = CORPUS) -> None:
    for hostile in some:
        sys.stdout.write(f"{written(hostile, Path(folder))}\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
