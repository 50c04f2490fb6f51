"""Runs all sensors of a robot: from windows of true motion to readings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from slamsim.config.sensors import SensorsConfig
from slamsim.core.types import Drive, FloatArray, TriangleMesh
from slamsim.sensors.base import Batch, Sensor, Site
from slamsim.sensors.encoders import Encoders
from slamsim.sensors.imu import Imu
from slamsim.sensors.lidar import Lidar
from slamsim.sensors.motion import Motion, PoseOverride, as_mounted, joined, kept_since
from slamsim.sensors.readings import EncoderBatch, ImuBatch, Readings, ScanBatch


class Carrier(Protocol):
    """What sensing must know of a robot: where its sensors sit and how its wheels are."""

    @property
    def T_base_laser(self) -> FloatArray: ...  # noqa: N802

    @property
    def T_base_imu(self) -> FloatArray: ...  # noqa: N802

    @property
    def wheel_radius_m(self) -> float: ...

    @property
    def track_m(self) -> float: ...


class SensorRig:
    """The sensors of one robot during one drive.

    Call ``sense`` with one window of the drive after the other. Readings depend on the mesh, the
    robot, the configuration, the seed and the whole motion, and are the same bytes however the
    drive is cut into windows and on however many ``threads``. What is carried from window to
    window is the tail of the motion that open samples still need, the number of the next sample
    of each stream, the biases, and one generator for each random effect. override, with_truth: as
    for Lidar.
    """

    def __init__(
        self,
        mesh: TriangleMesh,
        robot: Carrier,
        config: SensorsConfig,
        seed: int,
        threads: int = 1,
        override: PoseOverride = as_mounted,
        with_truth: bool = False,
    ) -> None:
        self._mesh, self._robot, self._config = mesh, robot, config
        self._seed, self._threads, self._override = seed, threads, override
        self._with_truth = with_truth
        self._motion: Motion | None = None
        self._sensors: _Sensors | None = None

    def sense(self, window: Drive) -> Readings:
        """Every sample whose whole acquisition is now covered and that was not given before.

        window: the next part of the drive, at least two steps in the first; its first stamp is
        the start of the streams. Raises BadNumbers if it does not follow on.
        """
        motion = joined(self._motion, window)
        if self._sensors is None:
            self._sensors = self._switched_on(int(window.stamps_ns[0]))
        scans, imu, encoders, additional = self._sensors.sense(motion)
        self._motion = kept_since(motion, self._sensors.needed_ns)
        return Readings(scans, imu, encoders, additional)

    def _switched_on(self, start_ns: int) -> _Sensors:
        robot, config, seed = self._robot, self._config, self._seed
        site = Site(self._mesh, seed, start_ns, self._threads)
        return _Sensors(
            Lidar(config.lidar, robot.T_base_laser, site, self._override, self._with_truth),
            Imu(config.imu, robot.T_base_imu, seed, start_ns),
            Encoders(config.encoders, robot.wheel_radius_m, robot.track_m, seed, start_ns),
            tuple(entry.build(site) for entry in config.additional if entry.enabled),
        )


@dataclass(frozen=True, slots=True)
class _Sensors:
    lidar: Lidar
    imu: Imu
    encoders: Encoders
    additional: tuple[Sensor, ...]

    @property
    def needed_ns(self) -> int:
        own = self.lidar.needed_ns, self.imu.needed_ns, self.encoders.needed_ns
        return min(*own, *(sensor.needed_ns for sensor in self.additional))

    def sense(self, motion: Motion) -> tuple[ScanBatch, ImuBatch, EncoderBatch, tuple[Batch, ...]]:
        scans, imu = self.lidar.sense(motion), self.imu.sense(motion)
        further = tuple(sensor.sense(motion) for sensor in self.additional)
        return scans, imu, self.encoders.sense(motion), further
