"""Trials of each drive: healthy, with one fault or two, and over fault sizes."""

from __future__ import annotations

import difflib
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

from slamsim.check.registry import registry
from slamsim.core.randomness import random_stream
from slamsim.guard.errors import SlamsimError, shown
from slamsim.sensors.faults.base import Fault

CLEAN = "clean"


@dataclass(frozen=True, slots=True)
class CheckTrial:
    """Faults to put into a drive, and what sort of trial it is: clean, fault, pair or curve."""

    sort: str
    faults: tuple[Fault, ...]

    @property
    def name(self) -> str:
        """Unique among the trials of a drive."""
        if self.sort == "curve":
            return ",".join(f"{fault.name}:{fault.size:g}" for fault in self.faults)
        return "+".join(fault.name for fault in self.faults) or CLEAN


def clean_trial() -> CheckTrial:
    return CheckTrial("clean", ())


def fault_trials(faults: Sequence[Fault]) -> list[CheckTrial]:
    return [CheckTrial("fault", (fault,)) for fault in faults]


def require_known_names(faults: Sequence[Fault]) -> None:
    """Raises SlamsimError for a fault that names another which no question can report."""
    known = registry().faults
    for fault in faults:
        for name in (fault.expects, *fault.also, *fault.hides):
            if name not in known:
                near = difflib.get_close_matches(name, known, n=1)
                hint = f"; did you mean {near[0]!r}?" if near else ""
                raise SlamsimError(
                    f"the fault {fault.name} expects {shown(name)}, "
                    f"which the checker cannot report{hint}"
                )


def curve_trials(faults: Sequence[Fault]) -> list[CheckTrial]:
    """Each fault with each of its sizes."""
    return [CheckTrial("curve", (f.with_size(size),)) for f in faults for size in f.sizes]


def pair_trials(faults: Sequence[Fault], count: int, seed: int) -> list[CheckTrial]:
    """So many random pairs whose faults can both be told, as far as there are any."""
    pairs = [pair for pair in itertools.combinations(faults, 2) if Fault.told_apart(*pair)]
    rng = random_stream(seed, "bench check", "pairs")
    chosen = rng.choice(len(pairs), size=min(count, len(pairs)), replace=False) if pairs else ()
    return [CheckTrial("pair", pairs[int(one)]) for one in chosen]
