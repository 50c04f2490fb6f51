"""Executes an order: locks the destination, makes missing sequences, reports progress."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from slamsim.dataset.make.engines.base import WorkEngine
from slamsim.dataset.make.identity import Identity, claim, require_place_for
from slamsim.dataset.make.production import DatasetSummary, Order, Production
from slamsim.dataset.make.progress import ProductionWatch
from slamsim.dataset.store.store import Store


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
