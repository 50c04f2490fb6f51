"""Faults put into a recording, alone or together."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from slamsim.config.sensors import SensorsConfig
from slamsim.core.randomness import random_stream
from slamsim.recording import Recording
from slamsim.sensors.faults.base import Fault, SensedFault
from slamsim.sensors.motion import Course, Knots, as_mounted


def injected(recording: Recording, faults: Sequence[Fault], seed: int) -> Recording:
    """The recording with all faults, one after the other; the one given is left as it was.

    Raises CannotInject where one of them finds nothing to spoil.
    """
    for fault in faults:
        recording = fault.inject(recording, random_stream(seed, "fault", fault.name))
    return recording


def faulty_sensors(faults: Sequence[Fault], config: SensorsConfig) -> tuple[SensorsConfig, Course]:
    """What to sense a drive with, and how the laser then looks."""
    sensors, course = config, as_mounted
    for fault in faults:
        if isinstance(fault, SensedFault):
            sensors = fault.sensors(sensors)
            course = partial(_one_more, course, fault, config)
    return sensors, course


def _one_more(before: Course, fault: SensedFault, config: SensorsConfig, knots: Knots) -> Knots:
    return fault.course(before(knots), config)


def declared(
    recording: Recording, faults: Sequence[Fault], config: SensorsConfig, seed: int
) -> Recording:
    """Of a drive sensed with ``faulty_sensors``: the recording with all faults.

    config: of the healthy sensors. Raises as ``injected`` does.
    """
    for fault in faults:
        if isinstance(fault, SensedFault):
            recording = fault.declare(recording, config)
        else:
            recording = injected(recording, (fault,), seed)
    return recording
