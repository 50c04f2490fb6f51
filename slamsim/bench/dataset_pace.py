"""Production rate of workers after start-up, for any engine."""

from __future__ import annotations

import os
import statistics
import tempfile
import time
from collections import defaultdict
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import cast

from slamsim.bench.alone import Children
from slamsim.dataset.make.engines.base import WorkEngine
from slamsim.dataset.make.execute import execute
from slamsim.dataset.make.identity import Identity
from slamsim.dataset.make.produce import produce
from slamsim.dataset.make.production import Order
from slamsim.dataset.make.progress import Unwatched
from slamsim.dataset.make.shard import LIMIT_S, Tried
from slamsim.dataset.recipe.draw import sequence_spec
from slamsim.dataset.recipe.model import Recipe
from slamsim.dataset.recipe.sequence import SequenceFacts, SequenceSpec
from slamsim.dataset.store.store import open_store
from slamsim.guard.errors import SlamsimError

BARE_STEPS = 20_000_000


@dataclass(frozen=True, slots=True)
class Made:
    """One sequence: the process that made it, when that ended, and its processor time."""

    worker: int
    ended_s: float
    cpu_s: float


@dataclass(frozen=True, slots=True)
class Pace:
    """sequences_per_s: of all workers together. cpu_s: median of one sequence."""

    sequences_per_s: float
    cpu_s: float


def pace(recipe: Recipe, count: int, engine: WorkEngine) -> Pace:
    """How fast an engine makes the first ``count`` sequences of a recipe.

    Raises SlamsimError if one of them fails.
    """
    watch = _Listener()
    order = Order(
        count=count,
        shard_sequences=recipe.shard_sequences,
        draw=partial(sequence_spec, recipe, count=count),
        produce=timed_produce,
        limit_s=LIMIT_S,
        command=_named,
        recorded=_named,
    )
    with tempfile.TemporaryDirectory() as folder:
        store = open_store(str(Path(folder) / "set"))
        execute(order, Identity(recipe.name, count, {}), store, engine, watch)
    return settled_pace(watch.made_ones)


def _named(index: int) -> str:
    return f"sequence {index}"


def settled_pace(made: Sequence[Made]) -> Pace:
    """The paces of the workers added up, each from the end of its first to that of its last.

    So neither counts how long a worker takes to start, nor that one is done while another still
    makes its last. Raises SlamsimError for a worker that made fewer than two.
    """
    ends_s: dict[int, list[float]] = defaultdict(list)
    for one in made:
        ends_s[one.worker].append(one.ended_s)
    if not ends_s or min(map(len, ends_s.values())) < 2:
        raise SlamsimError("a worker has made fewer than two sequences; ask for more")
    each = [(len(ends) - 1) / (max(ends) - min(ends)) for ends in ends_s.values()]
    return Pace(sum(each), statistics.median(one.cpu_s for one in made))


def timed_produce(spec: SequenceSpec, folder: Path) -> SequenceFacts:
    """As ``produce``; process, time and processor time are told among the quality numbers."""
    begun_s = time.process_time()
    facts = produce(spec, folder)
    told = {
        "worker": os.getpid(),
        "ended_s": time.monotonic(),
        "cpu_s": time.process_time() - begun_s,
    }
    return replace(facts, quality={**facts.quality, **told})


class _Listener(Unwatched):
    def __init__(self) -> None:
        self.made_ones: list[Made] = []

    def made(self, tried: Tried) -> None:
        row = cast(dict[str, float], tried.row)
        self.made_ones.append(
            Made(
                int(row["quality.worker"]),
                float(row["quality.ended_s"]),
                float(row["quality.cpu_s"]),
            )
        )

    def failed(self, index: int, reason: str, command: str) -> None:
        raise SlamsimError(f"{command} failed: {reason}")


def bare_scaling(children: Children, processes: int) -> float:
    """What so many processes of plain arithmetic come to on this machine now, over one.

    Cores that share their execution units, or that others use meanwhile, come to less than their
    number; no engine can come to more.
    """

    with ThreadPoolExecutor(processes) as threads:
        alone_s = children.run(_count)
        together = [threads.submit(children.run, _count) for _ in range(processes)]
        return sum(alone_s / one.result() for one in together)


def _count() -> float:
    """Wall-clock time of some million steps."""
    begun_s = time.perf_counter()
    for _ in range(BARE_STEPS):
        pass
    return time.perf_counter() - begun_s
