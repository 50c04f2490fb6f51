"""Makes a few short sequences in a separate process, to measure their cost."""

from __future__ import annotations

import resource
import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from slamsim.dataset.make.shard import LIMIT_S
from slamsim.dataset.recipe.sequence import SequenceSpec
from slamsim.guard.errors import SlamsimError
from slamsim.process.worker import Worker, WorkerDied, fair_share_bytes, time_limit

FOLDERS = {"log": "mcap"}
"""Folders of a sequence whose format is called otherwise."""


@dataclass(frozen=True, slots=True)
class Rehearsal:
    """One sequence: how much it simulates, what it took of one core, and its bytes by format."""

    simulated_s: float
    core_s: float
    sizes: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class Pilots:
    """made: of each that was asked for, None where it could not be made, as reasons tell.

    memory_bytes: the most that the process had. start_s: until the first could begin.
    """

    made: tuple[Rehearsal | None, ...]
    reasons: tuple[str, ...]
    memory_bytes: int
    start_s: float


def make_pilots(specs: Sequence[SequenceSpec]) -> Pilots:
    """Make them one after the other in one new process, and throw them away."""
    begin_s = time.perf_counter()
    worker = Worker(fair_share_bytes(1))
    try:
        worker.run(partial(_make, specs[0]), LIMIT_S)  # imports, compiled kernels
        start_s = time.perf_counter() - begin_s
        made = [worker.run(partial(_make, spec), LIMIT_S) for spec in specs]
        memory_bytes = worker.run(_peak_bytes, LIMIT_S)
    except WorkerDied as died:
        raise SlamsimError(f"the recipe cannot be tried out: {died.reason}") from None
    finally:
        worker.close()
    return Pilots(
        tuple(one if isinstance(one, Rehearsal) else None for one in made),
        tuple(one for one in made if isinstance(one, str)),
        memory_bytes,
        start_s,
    )


def _make(spec: SequenceSpec) -> Rehearsal | str:
    """The pilot, or why it cannot be."""
    from slamsim.dataset.make.produce import produce

    with time_limit(LIMIT_S), tempfile.TemporaryDirectory(prefix="slamsim-pilot-") as folder:
        begin_s = time.process_time()
        try:
            facts = produce(spec, Path(folder))
        except SlamsimError as error:
            return str(error)
        core_s = time.process_time() - begin_s
    sizes = Counter[str]()
    for file in facts.files:
        first, slash, _ = file.path.partition("/")
        sizes[FOLDERS.get(first, first) if slash else "settings"] += file.size_bytes
    duration_s = facts.quality["duration_s"]
    assert isinstance(duration_s, float)
    return Rehearsal(duration_s, core_s, dict(sizes))


def _peak_bytes() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
