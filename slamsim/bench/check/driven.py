"""One drive, sensed as often as there are faults that only sensing can show."""

from __future__ import annotations

from collections.abc import Sequence

from slamsim.config.run import RunConfig
from slamsim.logs.raw_memory import recording_from_readings
from slamsim.recording import Recording
from slamsim.sensors.faults.apply import declared, faulty_sensors
from slamsim.sensors.faults.base import Fault, SensedFault
from slamsim.sensors.rig import SensorRig
from slamsim.sim.drive_process import DriveProcess
from slamsim.sim.robot import build_robot
from slamsim.sim.route import plan_route
from slamsim.simulate import log_header
from slamsim.world.build import build_world


class Driven:
    """A drive in memory. What it was sensed to be without a fault is kept, and no more."""

    def __init__(self, config: RunConfig) -> None:
        """Raises SlamsimError for a world, robot or route that cannot be."""
        self._config = config
        with DriveProcess() as process:
            self._world = build_world(config.world, config.seed)
            self._robot = build_robot(config.robot)
            route = plan_route(self._world, self._robot, config.drive)
            self._windows = list(process.drive(self._world, self._robot, route, config.drive))
        self._clean = self._sensed(())

    def recording(self, faults: Sequence[Fault] = ()) -> Recording:
        """The recording with these faults; everything else is the same in all of them.

        Raises CannotInject where there is nothing to spoil.
        """
        sensed = [fault for fault in faults if isinstance(fault, SensedFault)]
        recording = self._sensed(sensed) if sensed else self._clean
        return declared(recording, faults, self._config.sensors, self._config.seed)

    def _sensed(self, faults: Sequence[Fault]) -> Recording:
        config = self._config
        sensors, course = faulty_sensors(faults, config.sensors)
        rig = SensorRig(self._world.mesh, self._robot, sensors, config.seed, course=course)
        readings = [rig.sense(window) for window in self._windows]
        header = log_header(self._robot, config)
        return recording_from_readings(config.world.name, readings, self._windows, header)
