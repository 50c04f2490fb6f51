"""Injects faults into a recording, singly or combined."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from slamsim.config.sensors import SensorsConfig
from slamsim.core.randomness import random_stream
from slamsim.recording import Recording
from slamsim.sensors.faults.base import Fault, SensedFault
from slamsim.sensors.motion import PoseOverride, PoseSamples, as_mounted


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
