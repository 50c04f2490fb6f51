"""Faults of publishing: two nodes on one topic, two sensors in one frame, a second odometry."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from slamsim.core.types import Float32Array, FloatArray, IntArray
from slamsim.recording import RawOdometry, RawScans, Recording, TransformEdge
from slamsim.recording.edits.base import ODOMETRIES, SCANS, CannotEdit, Edit
from slamsim.recording.edits.frames import AddTransform
from slamsim.recording.edits.messages import AddStream, ChangeMessages, select
from slamsim.recording.edits.motion import scaled_odometry
from slamsim.recording.edits.ranges import range_matrix
from slamsim.sensors.faults.base import Fault, span_ns

_Turn = Annotated[float, Field(gt=0.0, lt=360.0)]


class TwoLidarsOneTopic(Fault):
    """The driver of a second lidar, mounted otherwise, publishes on the first one's topic."""

    SIZE: ClassVar[str | None] = None
    kind: Literal["two_lidars_one_topic"]
    yaw_deg: _Turn
    """How the second is turned against the first."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def joined(scans: RawScans) -> RawScans:
            return _interleaved(scans, _turned(scans, self.yaw_deg))

        return ChangeMessages(SCANS, joined)


class TwoLidarsOneFrame(Fault):
    """A second lidar, mounted otherwise, names the frame of the first."""

    SIZE: ClassVar[str | None] = None
    kind: Literal["two_lidars_one_frame"]
    yaw_deg: _Turn
    """How the second is turned against the first."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        if not any(len(scans) for scans in recording.scans):
            raise CannotEdit(f"{recording.name} has no scans")
        first = recording.scans[0]
        second = replace(_turned(first, self.yaw_deg), topic=f"{first.topic}_2")
        return AddStream(second)


class TwoOdometriesOneTopic(Fault):
    """Two nodes publish odometry on one topic, each from where it was started."""

    SIZE: ClassVar[str | None] = None
    kind: Literal["two_odometries_one_topic"]
    apart_m: float = Field(gt=0.0, le=1000.0)
    """How far the origins of the two lie apart."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def joined(odometry: RawOdometry) -> RawOdometry:
            positions = odometry.positions_m.copy()
            positions[1::2, 1] += self.apart_m
            return replace(odometry, positions_m=positions)

        return ChangeMessages(ODOMETRIES, joined)


class SecondOdometry(Fault):
    """Another node publishes an odometry of the same body that turns otherwise."""

    kind: Literal["second_odometry"]
    turn_error: float = Field(gt=-1.0, le=10.0)
    """Of its turns, against those of the first."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        first = _first_odometry(recording)
        second = scaled_odometry(first, 1.0, 1.0 + self.turn_error)
        second = replace(second, topic=f"{first.topic}_2")
        return AddStream(second)


class MapRecorded(Fault):
    """A SLAM ran while this was recorded: its transform from map to odometry is in it."""

    kind: Literal["map_recorded"]
    frame: str = Field(default="map", min_length=1, max_length=256)
    """What the map is called."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        odom = _first_odometry(recording).frame_ids[0]
        begin_ns, end_ns = span_ns(recording)
        stamps_ns: IntArray = np.arange(begin_ns, end_ns, 50_000_000, dtype=np.int64)
        drift: FloatArray = np.linspace(0.0, 0.3, stamps_ns.size)
        positions = np.column_stack([drift, -drift, np.zeros(stamps_ns.size)])
        still = np.tile([0.0, 0.0, 0.0, 1.0], (stamps_ns.size, 1))
        edge = TransformEdge(
            "/tf", self.frame, odom, False, stamps_ns, stamps_ns.copy(), positions, still
        )
        return AddTransform(edge)


def _first_odometry(recording: Recording) -> RawOdometry:
    if not any(len(odometry) for odometry in recording.odometries):
        raise CannotEdit(f"{recording.name} has no odometry")
    return recording.odometries[0]


def _turned(scans: RawScans, yaw_deg: float) -> RawScans:
    """What a lidar at the same position sees with another yaw, as far as these scans reach."""
    ranges = range_matrix(scans)
    beams = ranges.shape[1]
    step_rad = scans.layouts[0].angle_step_rad
    shift = round(float(np.radians(yaw_deg)) / abs(step_rad)) if step_rad else 0
    if not 0 < shift % max(beams, 1) < beams:
        raise CannotEdit(f"{scans.topic} has no beams to turn by {yaw_deg:g} degrees")
    bright = scans.intensities
    if isinstance(bright, np.ndarray):
        bright = np.roll(bright, shift, axis=1)
    return replace(scans, ranges_m=np.roll(ranges, shift, axis=1), intensities=bright)


def _interleaved(one: RawScans, other: RawScans) -> RawScans:
    """Both in turn, the second half a period later; each pair was one sample."""
    if len(one) < 2:
        raise CannotEdit(f"{one.topic} has no two scans")
    later_ns = int(np.median(np.diff(one.stamps_ns))) // 2
    twice = select(one, np.repeat(np.arange(len(one)), 2))
    second = np.arange(len(twice)) % 2
    received, bright = twice.received_ns, None
    if isinstance(one.intensities, np.ndarray) and isinstance(other.intensities, np.ndarray):
        bright = _in_turn(one.intensities, other.intensities)
    return replace(
        twice,
        stamps_ns=twice.stamps_ns + second * later_ns,
        received_ns=None if received is None else received + second * later_ns,
        ranges_m=_in_turn(range_matrix(one), range_matrix(other)),
        intensities=bright,
    )


def _in_turn(one: Float32Array, other: Float32Array) -> Float32Array:
    """(2n, beams) the rows of two (n, beams), one after the other."""
    return np.stack([one, other], axis=1).reshape(2 * len(one), -1)
