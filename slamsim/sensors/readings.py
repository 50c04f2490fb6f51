"""Readings of the sensors, with the true instants."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slamsim.core.arrays import Samples
from slamsim.core.types import (
    EncoderStream,
    Float32Array,
    FloatArray,
    ImuStream,
    IntArray,
    Scan,
    ScanGeometry,
)
from slamsim.recording import Origin, RawScans, ScanLayout
from slamsim.sensors.base import Batch


@dataclass(frozen=True, slots=True, eq=False)
class BeamTruth(Samples):
    """What the middle of each beam truly met, (k, beam_count) each.

    ranges_m: without noise, ``inf`` for nothing, however far. cos_incidence: 1 head-on.
    triangles: number in the world's mesh, behind which come the two of the floor; NO_TRIANGLE
    for nothing.
    """

    ranges_m: Float32Array
    cos_incidence: Float32Array
    triangles: NDArray[np.uint32]


@dataclass(frozen=True, slots=True, eq=False)
class ScanBatch(Samples):
    """Consecutive scans of one lidar.

    stamps_ns: (k,) beam 0 of each on the lidar's clock, what a log would say.
    true_stamps_ns: (k,) the same instants in true time. arrival_ns: (k,) true time at which
    each message was there: never before its last beam, never before an earlier message.
    ranges_m, intensities: (k, beam_count) float32, ``inf`` no return, ``nan`` invalid.
    truth: of every beam, where it was asked for.
    """

    geometry: ScanGeometry
    stamps_ns: IntArray
    true_stamps_ns: IntArray
    arrival_ns: IntArray
    ranges_m: Float32Array
    intensities: Float32Array | None = None
    truth: BeamTruth | None = None

    def __len__(self) -> int:
        return int(self.stamps_ns.size)

    def __getitem__(self, index: int) -> Scan:
        strength = None if self.intensities is None else self.intensities[index]
        return Scan(int(self.stamps_ns[index]), self.ranges_m[index], self.geometry, strength)

    def __iter__(self) -> Iterator[Scan]:
        return (self[index] for index in range(len(self)))


@dataclass(frozen=True, slots=True, eq=False)
class ImuTruth(Samples):
    """(n, 3) each: what an unit without errors would read, and the biases of this one."""

    angular_velocity_rad_s: FloatArray
    linear_acceleration_m_s2: FloatArray
    gyro_bias_rad_s: FloatArray
    accelerometer_bias_m_s2: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ImuBatch(Samples):
    """Consecutive samples of an inertial unit; true_stamps_ns, arrival_ns: (n,) as for scans."""

    stream: ImuStream
    true_stamps_ns: IntArray
    arrival_ns: IntArray
    truth: ImuTruth | None = None

    def __len__(self) -> int:
        return int(self.true_stamps_ns.size)


@dataclass(frozen=True, slots=True, eq=False)
class EncoderBatch(Samples):
    """Consecutive readings of the wheel encoders; true_stamps_ns, arrival_ns: (n,) likewise.

    true_angles_rad: (n, 2) of the wheels (left, right) at the true stamps.
    """

    stream: EncoderStream
    true_stamps_ns: IntArray
    arrival_ns: IntArray
    true_angles_rad: FloatArray | None = None

    def __len__(self) -> int:
        return int(self.true_stamps_ns.size)


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """All that was sensed during one window of a drive; a disabled stream is empty.

    additional: of the sensors in ``sensors.additional``, in their order.
    """

    scans: ScanBatch
    imu: ImuBatch
    encoders: EncoderBatch
    additional: tuple[Batch, ...] = ()


def scan_streams(
    topic: str, batches: Sequence[ScanBatch], scan_rate_hz: float
) -> tuple[RawScans, ...]:
    """The scans of one lidar as a stream of a recording; none without a single scan.

    Numbers that a message holds in single precision are kept in it.
    """
    batches = [batch for batch in batches if len(batch)]
    if not batches:
        return ()
    geometry = batches[0].geometry
    last = geometry.angle_min_rad + (geometry.beam_count - 1) * geometry.angle_step_rad
    declared = (
        geometry.angle_min_rad,
        last,
        geometry.angle_step_rad,
        geometry.beam_dt_ns * 1e-9,
        1.0 / scan_rate_hz,
        geometry.range_min_m,
        geometry.range_max_m,
    )
    stamps_ns = np.concatenate([batch.stamps_ns for batch in batches])
    strengths = [batch.intensities for batch in batches if batch.intensities is not None]
    return (
        RawScans(
            topic=topic,
            frame_ids=(geometry.frame_id,),
            stamps_ns=stamps_ns,
            received_ns=np.concatenate([batch.arrival_ns for batch in batches]),
            layouts=(ScanLayout(*(float(np.float32(value)) for value in declared)),),
            layout_of=np.zeros(stamps_ns.size, dtype=np.int32),
            ranges_m=np.concatenate([batch.ranges_m for batch in batches]),
            intensities=np.concatenate(strengths) if strengths else None,
            origin=Origin.in_order(topic, np.arange(stamps_ns.size)),
        ),
    )
