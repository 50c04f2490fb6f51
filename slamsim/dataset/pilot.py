"""A few short sequences made for real, in a process of their own, to learn what they cost."""

from __future__ import annotations

import multiprocessing
import resource
import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path

from slamsim.dataset.sequence import SequenceSpec
from slamsim.safe.errors import SlamsimError

FOLDERS = {"log": "mcap"}
"""Folders of a sequence whose format is called otherwise."""


@dataclass(frozen=True, slots=True)
class Pilot:
    """One sequence: how much it simulates, what it took of one core, and its bytes by format."""

    simulated_s: float
    core_s: float
    sizes: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class Pilots:
    """made: of each that was asked for, None where it could not be made, as reasons tell.

    memory_bytes: the most that the process had. start_s: until the first could begin.
    """

    made: tuple[Pilot | None, ...]
    reasons: tuple[str, ...]
    memory_bytes: int
    start_s: float


def make_pilots(specs: Sequence[SequenceSpec]) -> Pilots:
    """Make them one after the other in one new process, and throw them away."""
    begin_s = time.perf_counter()
    context = multiprocessing.get_context("spawn")
    try:
        with ProcessPoolExecutor(1, mp_context=context) as process:
            process.submit(_make, specs[0]).result()  # imports, compiled kernels
            start_s = time.perf_counter() - begin_s
            made = [process.submit(_make, spec).result() for spec in specs]
            memory_bytes = process.submit(_peak_bytes).result()
    except BrokenProcessPool:
        raise SlamsimError("the process that tried the recipe out was killed") from None
    return Pilots(
        tuple(one if isinstance(one, Pilot) else None for one in made),
        tuple(one for one in made if isinstance(one, str)),
        memory_bytes,
        start_s,
    )


def _make(spec: SequenceSpec) -> Pilot | str:
    """The pilot, or why it cannot be."""
    from slamsim.dataset.produce import produce

    with tempfile.TemporaryDirectory(prefix="slamsim-pilot-") as folder:
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
    return Pilot(duration_s, core_s, dict(sizes))


def _peak_bytes() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
