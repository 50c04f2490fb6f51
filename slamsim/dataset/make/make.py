"""Makes a data set from a recipe: locks the destination, makes missing sequences, reports
progress."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from functools import partial

from slamsim.dataset.catalogue.write import write_catalogue
from slamsim.dataset.make.engines.local import WorkEngine
from slamsim.dataset.make.identity import RECIPE, Identity, claim, require_place_for
from slamsim.dataset.make.produce import produce
from slamsim.dataset.make.production import DatasetSummary, Order, Production
from slamsim.dataset.make.shard import LIMIT_S, ProductionWatch, Unwatched
from slamsim.dataset.recipe.distributions import edges
from slamsim.dataset.recipe.draw import sequence_spec
from slamsim.dataset.recipe.model import Recipe
from slamsim.dataset.recipe.plan import plan
from slamsim.dataset.store.store import Store, open_store
from slamsim.guard.errors import DiskFull, SlamsimError
from slamsim.guard.quantities import as_size

AMPLE_BYTES_PER_S = 10e6
"""No second of a recording takes as much."""


def make_dataset(
    recipe: Recipe,
    count: int,
    out: str,
    engine: WorkEngine,
    watch: ProductionWatch | None = None,
    *,
    only: Sequence[int] | None = None,
    source: str | None = None,
) -> DatasetSummary:
    """Make the first ``count`` sequences of a recipe, or those of them that are missing.

    recipe: as ``load_recipe`` gives it. out: a folder, or a URL that fsspec knows. only: make these
    indices alone and leave the catalogue. source: how the user named
    the recipe, for the commands that are told.

    It may be killed anywhere: called again with the same arguments it goes on, and what it
    leaves is byte for byte what an undisturbed call leaves. With a larger count it makes the new
    ones. Raises SlamsimError if the place holds something else, Locked while another run writes
    there, DiskFull, and what the engine raises when it cannot begin; then nothing is written.
    """
    if beyond := [index for index in only or () if not 0 <= index < count]:
        raise SlamsimError(f"--only {beyond[0]}: the data set ends with sequence {count - 1}")
    order = Order(
        count=count,
        shard_sequences=recipe.shard_sequences,
        draw=partial(sequence_spec, recipe, count=count),
        produce=produce,
        limit_s=LIMIT_S,
        command=_command(source or recipe.name, count, out),
        recorded=_command(f"DIR/{RECIPE}", count, "DIR"),
    )
    identity = Identity(recipe.name, count, recipe.model_dump(mode="json"))
    store = open_store(out)
    require_room = partial(_require_room, recipe, count, store)
    catalogue = partial(write_catalogue, recipe=recipe, count=count)
    return execute(
        order, identity, store, engine, watch or Unwatched(), require_room, only, catalogue
    )


def _require_room(recipe: Recipe, count: int, store: Store, left: int) -> None:
    """Plan, which takes some seconds, only where the disk is not ample anyway."""
    free = store.free_bytes()
    if free is None or left == 0:
        return
    longest_s = max(float(str(value)) for value in edges(recipe.duration_s))
    if free > left * longest_s * AMPLE_BYTES_PER_S:
        return
    needed = plan(recipe, count).total_bytes * left // count
    if free < needed:
        raise DiskFull(
            f"{store.address}: about {as_size(needed)} are needed, {as_size(free)} are free"
        )


def _command(source: str, count: int, out: str) -> Callable[[int], str]:
    words = ["slamsim", "dataset", "make", source, "-n", str(count), "--out", out]
    text = shlex.join(words)
    return lambda index: f"{text} --only {index}"


def execute(
    order: Order,
    identity: Identity,
    store: Store,
    engine: WorkEngine,
    watch: ProductionWatch,
    require_room: Callable[[int], None] | None = None,
    only: Sequence[int] | None = None,
    catalogue: Callable[[Store], None] | None = None,
) -> DatasetSummary:
    """As ``make_dataset``, for sequences of any kind.

    require_room: raises DiskFull. catalogue: writes what stands beside the sequences.
    """
    require_place_for(store, identity)
    with store.owned():
        require_place_for(store, identity)
        with engine:
            production = Production(order, store, engine, watch, only)
            if require_room is not None:
                require_room(production.left())
            claim(store, identity)
            summary = production.run()
            if only is None and catalogue is not None:
                watch.catalogue()
                catalogue(store)
            return summary
