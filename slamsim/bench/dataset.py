"""``slamsim bench dataset``: what a sequence costs beside its bare parts, and how many make more.

Processor time counts for one sequence, for the bare parts are measured in the same process; wall
time for many, and beside it what processes without any memory or files come to meanwhile.
"""

from __future__ import annotations

import os
import shutil
import statistics
import tempfile
import time
from collections import defaultdict
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import cast

import numpy as np

from slamsim.bench import Figures
from slamsim.bench.logs import Children
from slamsim.bench.speed import plain_rays, processor_s
from slamsim.console.reporter import Reporter
from slamsim.core.types import Float32Array
from slamsim.dataset.make.engines.dask import DaskEngine, cluster_here
from slamsim.dataset.make.engines.local import LocalEngine, WorkEngine
from slamsim.dataset.make.identity import Identity
from slamsim.dataset.make.make import execute
from slamsim.dataset.make.produce import produce
from slamsim.dataset.make.production import Order
from slamsim.dataset.make.shard import LIMIT_S, Tried, Unwatched
from slamsim.dataset.recipe.draw import sequence_spec
from slamsim.dataset.recipe.loading import load_recipe
from slamsim.dataset.recipe.model import Recipe
from slamsim.dataset.recipe.sequence import SequenceFacts, SequenceSpec
from slamsim.dataset.store.store import open_store
from slamsim.guard.errors import SlamsimError
from slamsim.io import LOG
from slamsim.io.bag2.plain_copy import PlainCopy
from slamsim.process.children import MEMORY
from slamsim.sensors.scene import Scene
from slamsim.sim.drive.route import plan_route
from slamsim.sim.drive.run import DriveRun, bare_step_seconds
from slamsim.sim.robot.model import build_robot
from slamsim.world.build import build_world

START_SHARED_BY = 50
"""A worker makes at least so many sequences: each bears that share of its start."""

BARE_SEQUENCES = 3
PARALLEL = 2
ROUNDS = 2
"""So often each engine is measured, in turns. Its best pace counts: what else a machine does can
only slow it."""


def measure_dataset(recipe_name: str, count: int, figures: Figures, reporter: Reporter) -> None:
    """One core, and several, on the first ``count`` sequences of a recipe.

    figures: where each is put once it is known; Dask's are left out where it is not installed.
    Raises SlamsimError for a recipe that cannot be, and if a sequence fails on one core.
    """
    recipe = load_recipe(recipe_name)
    with_dask = find_spec("distributed") is not None
    if not with_dask:
        reporter.warn("Dask is not measured, it is not installed: pip install 'slamsim[cluster]'")
    with Children() as children, reporter.stage("one core"):
        alone = children.run(measure_alone, recipe, count)
    figures |= {"recipe": recipe.name, "sequences": count, "one_core": alone}
    figures |= _paces(recipe, count, with_dask, reporter)


def _paces(recipe: Recipe, count: int, with_dask: bool, reporter: Reporter) -> Figures:
    rounds = []
    with Children() as children:
        bare = [bare_scaling(children, PARALLEL)]
        for number in range(ROUNDS):
            rounds.append(_round(recipe, count, with_dask, reporter, f", round {number + 1}"))
            bare.append(bare_scaling(children, PARALLEL))
    best = {
        name: max((paces[name] for paces in rounds), key=lambda one: one.sequences_per_s)
        for name in rounds[0]
    }
    per_s = {name: one.sequences_per_s for name, one in best.items()}
    figures: Figures = {
        "sequences_per_s": per_s,
        "cpu_s_per_sequence": {name: one.cpu_s for name, one in best.items()},
        "two_workers_over_one": per_s["two_workers"] / per_s["one_worker"],
        "two_bare_processes_over_one": max(bare),
    }
    if with_dask:
        figures["dask_time_over_local"] = per_s["two_workers"] / per_s["dask_two_workers"]
    return figures


def _round(
    recipe: Recipe, count: int, with_dask: bool, reporter: Reporter, which: str
) -> dict[str, Pace]:
    """Each engine once."""

    def measured(engine: WorkEngine, title: str) -> Pace:
        with reporter.stage(f"{title}{which}", ""):
            return pace(recipe, count, engine)

    paces = {
        "one_worker": measured(LocalEngine(1), "one worker"),
        "two_workers": measured(LocalEngine(PARALLEL), "two workers"),
    }
    if with_dask:
        with cluster_here(PARALLEL) as address:
            engine = DaskEngine(address, recipe.shard_sequences)
            paces["dask_two_workers"] = measured(engine, "two workers of Dask")
    return paces


def measure_alone(recipe: Recipe, count: int) -> Figures:
    """Sequences made one after the other in this process, and their bare parts."""
    specs = [sequence_spec(recipe, index, count) for index in range(count)]
    cpu_s, simulated_s, memory_mb = [], [], []
    imported_s = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        for spec in specs:
            place = Path(folder) / str(spec.index)
            place.mkdir()
            begun_s = time.process_time()
            facts = produce(spec, place)
            cpu_s.append(time.process_time() - begun_s)
            simulated_s.append(cast(float, facts.quality["duration_s"]))
            memory_mb.append(MEMORY.peak_mb())
            if spec.index >= BARE_SEQUENCES:
                shutil.rmtree(place)
        bare = _bare_parts(specs[:BARE_SEQUENCES], Path(folder))
    usual_s = float(np.median(cpu_s[1:] or cpu_s))
    start_s = imported_s + cpu_s[0] - usual_s
    each_s = usual_s + start_s / START_SHARED_BY
    length_s = float(np.median(simulated_s))
    return {
        "cpu_s_per_sequence": usual_s,
        "cpu_s_to_start": start_s,
        "simulated_s_per_cpu_s": length_s / each_s,
        "bare_cpu_s": bare,
        "time_over_bare_parts": usual_s / sum(bare.values()),
        "peak_memory_mb": memory_mb[-1],
        "peak_memory_grown_mb": memory_mb[-1] - memory_mb[len(memory_mb) // 10],
    }


def _bare_parts(specs: list[SequenceSpec], folder: Path) -> dict[str, float]:
    """Mean processor time of stepping, casting and writing what these sequences hold."""
    parts = {"stepping": 0.0, "casting": 0.0, "writing": 0.0}
    for spec in specs:
        config, place = spec.config, folder / str(spec.index)
        world, robot = build_world(config.world, config.seed), build_robot(config.robot)
        windows = list(DriveRun(world, robot, plan_route(world, robot, config.drive), config.drive))
        simulated_s = sum(map(len, windows)) / config.drive.physics.rate_hz
        rays = plain_rays(windows, world.mesh, robot, config)
        scene = Scene(world.mesh, config.sensors.lidar.range_max_m)
        copy = PlainCopy.of(place / LOG)
        step = partial(bare_step_seconds, world, robot, config.drive.physics)
        parts["stepping"] += processor_s(partial(step, simulated_s)) - processor_s(
            partial(step, 0.0)
        )
        parts["casting"] += processor_s(partial(_cast_all, scene, rays))
        parts["writing"] += processor_s(partial(copy.write, place / "plain"))
    return {name: total / len(specs) for name, total in parts.items()}


def _cast_all(scene: Scene, rays: list[Float32Array]) -> None:
    for batch in rays:
        scene.cast(batch)


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
