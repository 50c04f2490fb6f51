"""Estimates what a recipe makes and what it costs, from a small pilot."""

from __future__ import annotations

import resource
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from slamsim.dataset.make.shard import LIMIT_S
from slamsim.dataset.recipe.draw import Draft, draw, drawn_cells, sequence_spec, split_counts
from slamsim.dataset.recipe.model import Recipe
from slamsim.dataset.recipe.sequence import SequenceSpec, Split
from slamsim.guard.errors import SlamsimError
from slamsim.process.worker import Worker, WorkerDied, cores, fair_share_bytes, time_limit

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
    """Make them one after the other in one new process, and throw them away.

    Raises SlamsimError if the process dies.
    """
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


MOST_DRAWN = 5_000
"""Of a larger data set, only so many sequences are drawn for the counts, and the counts scaled."""
MOST_KINDS = 4
"""Pilots are made of the most frequent kinds of sequence alone."""
PILOT_S = (5.0, 10.0)
"""Two lengths, so that what every sequence costs is told from what every second costs."""
COUNTED = ("world", "drive", "robot", "sensors.lidar")
"""What is counted where the recipe draws it."""

Kind = tuple[str, bool]
"""Lidar, and whether there are faults: what time and size depend on most."""
Maker = Callable[[Sequence[SequenceSpec]], Pilots]


@dataclass(frozen=True, slots=True)
class Plan:
    """What is to be expected.

    counts: sequences by what was drawn, those with several faults counted for each of them; exact
    if ``drawn`` is all, else scaled. simulated_s: as far as routes do not end early. core_s: of one
    core; seconds: with all workers. disk_bytes: by format; ``truth`` and ``settings`` beside them.
    memory_bytes: of one worker.
    """

    name: str
    sequences: int
    worlds: int
    splits: Mapping[Split, int]
    counts: Mapping[str, Mapping[str, int]]
    drawn: int
    simulated_s: float
    core_s: float
    workers: int
    seconds: float
    disk_bytes: Mapping[str, int]
    memory_bytes: int

    @property
    def total_bytes(self) -> int:
        return sum(self.disk_bytes.values())

    @property
    def realtime_factor(self) -> float:
        """Simulated seconds per second of one core."""
        return self.simulated_s / max(self.core_s, 1e-9)


def plan(recipe: Recipe, count: int, workers: int | None = None, make: Maker = make_pilots) -> Plan:
    """The plan of the first ``count`` sequences of a recipe.

    workers: processes at a time, by default one for each core. Raises SlamsimError where not even
    one short sequence can be made.
    """
    workers = workers or cores()
    drafts = [draw(recipe, index) for index in range(min(count, MOST_DRAWN))]
    kinds = [_kind(draft) for draft in drafts]
    chosen = [kind for kind, _ in Counter(kinds).most_common(MOST_KINDS)]
    specs = [_short(recipe, kinds.index(kind), count, s) for kind in chosen for s in PILOT_S]
    pilots = make(specs)
    costs = _costs(chosen, specs, pilots)
    expected = [
        costs[kind if kind in costs else None].at(_asked_s(draft.duration_s))
        for kind, draft in zip(kinds, drafts, strict=True)
    ]
    scale = count / len(drafts)
    core_s = scale * sum(one.core_s for one in expected)
    sizes = Counter[str]()
    for one in expected:
        sizes.update(one.sizes)
    return Plan(
        name=recipe.name,
        sequences=count,
        worlds=-(-count // recipe.sequences_per_world),
        splits=split_counts(recipe, count),
        counts=_counts(recipe, drafts, scale),
        drawn=len(drafts),
        simulated_s=scale * sum(one.simulated_s for one in expected),
        core_s=core_s,
        workers=workers,
        seconds=pilots.start_s + core_s / min(workers, count),
        disk_bytes={name: round(scale * size) for name, size in sorted(sizes.items())},
        memory_bytes=pilots.memory_bytes,
    )


@dataclass(frozen=True, slots=True)
class _Cost:
    """What sequences of one kind come to, as pairs: for each of them, for each second asked."""

    simulated: tuple[float, float]
    core: tuple[float, float]
    sizes: Mapping[str, tuple[float, float]]

    def at(self, asked_s: float) -> Rehearsal:
        """What is to be expected of one that long."""
        return Rehearsal(
            _on(self.simulated, asked_s),
            _on(self.core, asked_s),
            {name: round(_on(line, asked_s)) for name, line in self.sizes.items()},
        )


def _on(line: tuple[float, float], asked_s: float) -> float:
    return max(line[0] + line[1] * asked_s, 0.0)


def _costs(
    chosen: Sequence[Kind], specs: Sequence[SequenceSpec], pilots: Pilots
) -> dict[Kind | None, _Cost]:
    """By kind, and under None what holds for the others. Raises SlamsimError without any pilot."""
    made = dict[Kind | None, list[tuple[float, Rehearsal]]]()
    for place, (spec, pilot) in enumerate(zip(specs, pilots.made, strict=True)):
        if pilot is not None:
            asked_s = _asked_s(spec.config.drive.route.max_duration_s)
            made.setdefault(chosen[place // len(PILOT_S)], []).append((asked_s, pilot))
    every = [pair for group in made.values() for pair in group]
    if not every:
        raise SlamsimError(f"nothing can be made of this recipe: {pilots.reasons[0]}")
    return {kind: _cost(group) for kind, group in {None: every, **made}.items()}


def _cost(pilots: Sequence[tuple[float, Rehearsal]]) -> _Cost:
    asked_s = [asked for asked, _ in pilots]
    names = {name for _, pilot in pilots for name in pilot.sizes}
    return _Cost(
        _line(asked_s, [pilot.simulated_s for _, pilot in pilots]),
        _line(asked_s, [pilot.core_s for _, pilot in pilots]),
        {name: _line(asked_s, [p.sizes.get(name, 0) for _, p in pilots]) for name in names},
    )


def _line(x: Sequence[float], y: Sequence[float]) -> tuple[float, float]:
    """Offset and slope of the best line; of one that begins at nothing, where x hardly differs."""
    if np.ptp(x) < 1.0:
        return 0.0, float(np.sum(y) / np.sum(x))
    slope, offset = np.polyfit(x, y, 1)
    return (float(offset), float(slope)) if slope > 0.0 else (float(np.mean(y)), 0.0)


def _kind(draft: Draft) -> Kind:
    return str(draft.values.get("sensors.lidar", "")), bool(draft.faults)


def _asked_s(duration: object) -> float:
    assert isinstance(duration, int | float)  # every sequence has one, held by the loading
    return float(duration)


def _short(recipe: Recipe, index: int, count: int, most_s: float) -> SequenceSpec:
    """A sequence of the data set, cut after so many seconds."""
    spec = sequence_spec(recipe, index, count)
    route = spec.config.drive.route
    cut = route.model_copy(update={"max_duration_s": min(most_s, route.max_duration_s or most_s)})
    drive = spec.config.drive.model_copy(update={"route": cut})
    return replace(spec, config=spec.config.model_copy(update={"drive": drive}))


def _counts(recipe: Recipe, drafts: Sequence[Draft], scale: float) -> dict[str, dict[str, int]]:
    found = {name: Counter[str]() for name in (*COUNTED, "faults")}
    for draft in drafts:
        cells = drawn_cells(recipe, draft)
        for name in COUNTED:
            if name in cells:
                found[name][str(cells[name])] += 1
        found["faults"].update([choice.name for choice in draft.faults] or ["none"])
    return {
        name: {what: round(scale * number) for what, number in counter.most_common()}
        for name, counter in found.items()
        if counter
    }
