"""Makes sequences of a data set again and compares the bytes."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from slamsim.dataset.make.identity import read_identity
from slamsim.dataset.make.sequence_check import SequenceFinding
from slamsim.dataset.make.shard import LIMIT_S
from slamsim.dataset.make.versions import difference, versions
from slamsim.dataset.recipe.model import Recipe
from slamsim.dataset.store.place import Location
from slamsim.guard.errors import SlamsimError
from slamsim.guard.sums import SEQUENCE, read_sequence
from slamsim.process.worker import WorkerDied, Workers, time_limit


def require_same_software(place: Location) -> None:
    """Raise SlamsimError where other software would make other bytes."""
    identity = read_identity(place) or {}
    if differs := difference(identity.get("versions", {}), versions()):
        raise SlamsimError(
            f"{place.address} was made with other software, which may make other bytes: "
            f"here is {differs}"
        )


def make_again(
    place: Location, indices: Sequence[int], workers: int | None
) -> Iterator[tuple[SequenceFinding, ...]]:
    """What differs, sequence by sequence."""
    if not indices:
        return
    identity = read_identity(place)
    assert identity is not None
    with Workers(workers) as makers:
        made = [
            makers.submit(partial(_compared, place, identity, index), LIMIT_S) for index in indices
        ]
        for index, one in zip(indices, made, strict=True):
            try:
                yield one.result()
            except WorkerDied as died:
                raise SlamsimError(
                    f"sequence {index} cannot be made again: {died.reason}"
                ) from None


def _compared(
    place: Location, identity: Mapping[str, Any], index: int
) -> tuple[SequenceFinding, ...]:
    from slamsim.dataset.make.produce import produce
    from slamsim.dataset.make.shard import sequence_mark
    from slamsim.dataset.recipe.draw import sequence_spec

    recipe = Recipe.model_validate(identity["recipe"])
    spec = sequence_spec(recipe, index, identity["sequences"])
    there = place.read(f"{spec.name}/{SEQUENCE}") or b""
    with time_limit(LIMIT_S), tempfile.TemporaryDirectory(prefix="slamsim-again-") as folder:
        try:
            facts = produce(spec, Path(folder))
        except SlamsimError as error:
            return (SequenceFinding(spec.name, f"cannot be made again: {error}", index),)
    if sequence_mark(spec, facts) == there:
        return ()
    old = {file["path"]: file["sha256"] for file in read_sequence(there)["files"]}
    new = {file.path: file.sha256 for file in facts.files}
    reason = "made again, its bytes are others"
    paths = [path for path in {**old, **new} if old.get(path) != new.get(path)] or [SEQUENCE]
    return tuple(SequenceFinding(f"{spec.name}/{path}", reason, index) for path in paths)
