"""All kinds of faults, the files that define faults, and their injection, singly or combined."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

from slamsim.config.bundled import bundled_folder, bundled_names, find_input
from slamsim.config.faults import FaultChoice
from slamsim.config.loading import validated
from slamsim.config.merging import mount
from slamsim.config.sensors import SensorsConfig
from slamsim.core.randomness import random_stream
from slamsim.guard.errors import InputRefused, did_you_mean, shown
from slamsim.guard.plugins import kinds_in, left_out
from slamsim.guard.yaml import YamlDocument, load_yaml
from slamsim.recording import Recording
from slamsim.sensors.faults.base import Fault, SensedFault
from slamsim.sensors.motion import PoseOverride, PoseSamples, as_mounted

_PACKAGE = "slamsim.sensors.faults"


@cache
def kinds() -> Mapping[str, type[Fault]]:
    """Every kind of fault under the name that a file gives it: all classes of this folder."""
    parent: type[Any] = Fault
    return kinds_in(_PACKAGE, parent, "kind")


def load_fault(name_or_path: str) -> Fault:
    """The fault of that file, or the bundled one of that name.

    Raises NotFound naming the nearest, InputRefused for a file that describes none.
    """
    path = find_input("configs/faults", name_or_path)
    return _bundled(path) if path.parent == bundled_folder("configs/faults") else _read(path)


@cache
def _bundled(path: Path) -> Fault:
    """Read once: a recipe with faults asks 381 times for one of the 149."""
    return _read(path)


def _read(path: Path) -> Fault:
    document = load_yaml(path)
    return validated(_kind_of(document, path), mount(document))


def chosen_fault(choice: FaultChoice) -> Fault:
    """The fault in the size that was chosen. Raises as ``load_fault`` and ``with_size`` do."""
    fault = load_fault(choice.name)
    return fault if choice.size is None else fault.with_size(choice.size)


def resolved_choice(choice: FaultChoice, folder: Path | None = None) -> FaultChoice:
    """The same choice with its size, to be understood from any folder.

    folder: where a relative name starts; without one, at the working directory.
    """
    path = find_input("configs/faults", choice.name, folder)
    named = choice.name if path.parent == bundled_folder("configs/faults") else str(path.resolve())
    return FaultChoice(
        name=named, size=chosen_fault(FaultChoice(name=named, size=choice.size)).size
    )


def bundled_faults() -> tuple[Fault, ...]:
    """All that come with the package, sorted by name."""
    return tuple(load_fault(name) for name in bundled_names("configs/faults"))


def _kind_of(document: YamlDocument, path: Path) -> type[Fault]:
    data, known = document.data, kinds()
    if not isinstance(data, dict) or "kind" not in data:
        raise InputRefused(path, f"the key 'kind' is missing; it is one of {', '.join(known)}")
    kind = data["kind"]
    if not isinstance(kind, str) or kind not in known:
        hint = did_you_mean(kind, known) or f"; the kinds are {', '.join(known)}"
        missing = left_out(_PACKAGE)
        hint += f"; {missing}" if missing else ""
        line = document.line_of(("kind",))
        raise InputRefused(path, f"there is no kind {shown(kind)}{hint}", f"line {line}, kind")
    return known[kind]


def injected(recording: Recording, faults: Sequence[Fault], seed: int) -> Recording:
    """The recording with all faults, one after the other; the one given is left as it was.

    Raises CannotEdit where the recording has nothing that could have one of them.
    """
    for fault in faults:
        recording = fault.inject(recording, random_stream(seed, "fault", fault.name))
    return recording


def faulty_sensors(
    faults: Sequence[Fault], config: SensorsConfig
) -> tuple[SensorsConfig, PoseOverride]:
    """What to sense a drive with, and how the laser then looks."""
    sensors, override = config, as_mounted
    for fault in faults:
        if isinstance(fault, SensedFault):
            sensors = fault.sensors(sensors)
            override = partial(_one_more, override, fault, config)
    return sensors, override


def _one_more(
    before: PoseOverride, fault: SensedFault, config: SensorsConfig, samples: PoseSamples
) -> PoseSamples:
    return fault.override(before(samples), config)


def declared(
    recording: Recording, faults: Sequence[Fault], config: SensorsConfig, seed: int
) -> Recording:
    """Of a drive sensed with ``faulty_sensors``: the recording with all faults.

    config: of the healthy sensors. Raises as ``injected`` does.
    """
    for fault in faults:
        if isinstance(fault, SensedFault):
            recording = fault.declare(config).apply(recording)
        else:
            recording = injected(recording, (fault,), seed)
    return recording
