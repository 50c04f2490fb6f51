"""Faults of wheels and odometry: wrong sizes, wrong signs, slip, jumps, invalid poses."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, TypeVar

import numpy as np
from pydantic import Field

from slamsim.core.geometry import xyzw_from_yaw, yaw_from_xyzw
from slamsim.core.types import FloatArray, IntArray
from slamsim.recording import RawOdometry, RawTicks, Recording, TransformEdge
from slamsim.recording.edits.base import COUNTS, DRIVEN, ODOMETRIES, TICKS, WHEELS, Edit, Edits
from slamsim.recording.edits.messages import ChangeMessages
from slamsim.recording.edits.motion import rotated
from slamsim.recording.edits.odometry import FollowTicks, ScaleMotion, ScaleSteps
from slamsim.recording.edits.wheels import Pair, RewireWheels, ScaleWheelNumbers, WrapTicks
from slamsim.sensors.faults.base import Fault, some_of, spells

Moving = TypeVar("Moving", RawOdometry, TransformEdge)


class WheelRadius(Fault):
    """The driver believes in another wheel radius."""

    kind: Literal["wheel_radius"]
    relative_error: float = Field(gt=-0.9, le=10.0)
    """Believed over true, less one."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        gain = 1.0 + self.relative_error
        return _believed(recording, ScaleMotion(DRIVEN, gain, gain), radius_factor=gain)


class WheelUnit(Fault):
    """Lengths by the wheels are not in metres."""

    kind: Literal["wheel_unit"]
    factor: float = Field(gt=0.0, le=1e6)
    """How many of the unit are a metre."""
    of: Literal["lengths", "radius", "odometry"] = "lengths"
    """All of them; the radius alone, so that turns are off too; or the published odometry alone."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        alone = self.of == "radius"
        moved = ScaleMotion(DRIVEN, self.factor, self.factor if alone else 1.0)
        if self.of == "odometry":
            return moved
        return _believed(recording, moved, self.factor, 1.0 if alone else self.factor)


class WheelTrack(Fault):
    """The driver believes in another distance between the wheels."""

    kind: Literal["wheel_track"]
    relative_error: float = Field(gt=-0.9, le=10.0)
    """Believed over true, less one."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        gain = 1.0 + self.relative_error
        return _believed(recording, ScaleMotion(DRIVEN, 1.0, 1.0 / gain), track_factor=gain)


class WheelReversed(Fault):
    """One wheel counts backward."""

    kind: Literal["wheel_reversed"]
    wheel: Literal["left", "right"]
    """Which one."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return _rewired(signs=(-1, 1) if self.wheel == "left" else (1, -1))


class WheelDead(Fault):
    """One wheel's counter never counts."""

    kind: Literal["wheel_dead"]
    wheel: Literal["left", "right"]
    """Which one."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return _rewired(signs=(0, 1) if self.wheel == "left" else (1, 0))


class WheelsSwapped(Fault):
    """The left counter is wired to the right wheel, and the right one to the left."""

    kind: Literal["wheels_swapped"]

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return _rewired(order=(1, 0))


class TicksWrap(Fault):
    """The counters overflow."""

    kind: Literal["ticks_wrap"]
    bits: int = Field(ge=4, le=62)
    """Width of the counters; they are signed."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return WrapTicks(TICKS, 1 << self.bits)


class WheelSlip(Fault):
    """The wheels turn further than the robot moves, for a while at a time."""

    kind: Literal["wheel_slip"]
    share: float = Field(gt=0.0, le=10.0)
    """Of the path, that the wheels turn in addition."""
    slip_s: float = Field(default=4.0, gt=0.0, le=1e4)
    """Length of each slip."""
    slips: int = Field(default=3, ge=1, le=1000)
    """How many, evenly spread over the recording."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return ScaleSteps(WHEELS, self._gain)

    def _gain(self, stamps_ns: IntArray) -> FloatArray:
        """(n - 1,) of each step between stamps."""
        slipping = spells(stamps_ns[1:], self.slips, self.slip_s)
        return np.where(slipping, 1.0 + self.share, 1.0)


class WheelsChanged(Fault):
    """The wheels become smaller half way, as tyres do that lose air or take a load."""

    kind: Literal["wheels_changed"]
    relative_error: float = Field(gt=-1.0, le=10.0)
    """Of distances and turns by the wheels from then on."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return ScaleSteps(WHEELS, self._gain)

    def _gain(self, stamps_ns: IntArray) -> FloatArray:
        """(n - 1,) of each step between stamps."""
        middle_ns = stamps_ns[0] + (stamps_ns[-1] - stamps_ns[0]) // 2
        return np.where(stamps_ns[1:] > middle_ns, 1.0 + self.relative_error, 1.0)


class OdometryContradicts(Fault):
    """The published odometry shows other distances than the counters."""

    kind: Literal["odometry_contradicts"]
    relative_error: float = Field(gt=-1.0, le=10.0)
    """Of distances and turns, against those that the counters give."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        TICKS.require(recording)
        gain = 1.0 + self.relative_error
        return ScaleMotion(DRIVEN, gain, gain)


class OdometryJump(Fault):
    """The odometry makes a step, as when a filter is reset."""

    kind: Literal["odometry_jump"]
    jump_m: float = Field(ge=-1000.0, le=1000.0)
    """Length of the step, along x, halfway through the recording."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def jumped(one: Moving) -> Moving:
            positions = one.positions_m.copy()
            positions[len(positions) // 2 :, 0] += self.jump_m
            return replace(one, positions_m=positions)

        return ChangeMessages(DRIVEN, jumped)


class OdometryFrozen(Fault):
    """Counters and odometry stand still while the robot moves on, and do not catch up."""

    kind: Literal["odometry_frozen"]
    frozen_s: float = Field(gt=0.0, le=1e4)
    """How long each time."""
    times: int = Field(default=2, ge=1, le=1000)
    """How often, evenly spread over the recording."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return ScaleSteps(WHEELS, self._gain)

    def _gain(self, stamps_ns: IntArray) -> FloatArray:
        frozen = spells(stamps_ns[1:], self.times, self.frozen_s)
        return np.where(frozen, 0.0, 1.0)


class TicksFrozen(Fault):
    """Only the counters stand still for a while, and do not catch up; the odometry goes on."""

    kind: Literal["ticks_frozen"]
    frozen_s: float = Field(gt=0.0, le=1e4)
    """How long each time."""
    times: int = Field(default=2, ge=1, le=1000)
    """How often, evenly spread over the recording."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return ChangeMessages(TICKS, self._frozen)

    def _frozen(self, ticks: RawTicks) -> RawTicks:
        standing = spells(ticks.stamps_ns[1:], self.times, self.frozen_s)
        steps = np.where(standing[:, None], 0, np.diff(ticks.ticks, axis=0))
        return replace(ticks, ticks=np.vstack([ticks.ticks[:1], steps]).cumsum(axis=0))


class OdometryStill(Fault):
    """The published odometry never moves; the counters do."""

    kind: Literal["odometry_still"]

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return ScaleMotion(DRIVEN, 0.0, 0.0)


class OdometryNoTurn(Fault):
    """Positions of the published odometry are right, its heading never changes."""

    kind: Literal["odometry_no_turn"]

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def straight(one: Moving) -> Moving:
            return replace(one, quats_xyzw=np.tile(one.quats_xyzw[:1], (len(one.quats_xyzw), 1)))

        return ChangeMessages(DRIVEN, straight)


class OdometryHeading(Fault):
    """Positions of the published odometry are right, its heading is multiplied: by 180 over pi
    where degrees were taken for radians."""

    kind: Literal["odometry_heading"]
    factor: float = Field(ge=-100.0, le=100.0)

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def other(one: Moving) -> Moving:
            heading = self.factor * np.unwrap(yaw_from_xyzw(one.quats_xyzw))
            return replace(one, quats_xyzw=xyzw_from_yaw(heading))

        return ChangeMessages(DRIVEN, other)


class TwistWrong(Fault):
    """The odometry's twist is in other units, or in the frame of its poses."""

    kind: Literal["twist_wrong"]
    speed_factor: float = Field(default=1.0, ge=-1e6, le=1e6)
    """Said over true, of the speeds."""
    turn_factor: float = Field(default=1.0, ge=-1e6, le=1e6)
    """Of the turn rate."""
    of_world: bool = False
    """Speeds are those along x and y of the frame of the poses."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def other(odometry: RawOdometry) -> RawOdometry:
            speeds = odometry.linear_m_s * self.speed_factor
            if self.of_world:
                speeds[:, :2] = rotated(speeds[:, :2], yaw_from_xyzw(odometry.quats_xyzw))
            rates = odometry.angular_rad_s * self.turn_factor
            return replace(odometry, linear_m_s=speeds, angular_rad_s=rates)

        return ChangeMessages(ODOMETRIES, other)


class OdometryNotFinite(Fault):
    """Single poses of the odometry are not a number."""

    kind: Literal["odometry_not_finite"]
    share: float = Field(gt=0.0, le=1.0)
    """Of the messages."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def broken(odometry: RawOdometry) -> RawOdometry:
            chosen = some_of(len(odometry), self.share, rng)[:, None]
            return replace(
                odometry,
                positions_m=np.where(chosen, np.nan, odometry.positions_m),
                linear_m_s=np.where(chosen, np.nan, odometry.linear_m_s),
            )

        return ChangeMessages(ODOMETRIES, broken)


class OdometryQuaternion(Fault):
    """The odometry's quaternions are not of unit length; of length 0: never filled in."""

    kind: Literal["odometry_quaternion"]
    length: float = Field(ge=0.0, le=1e6)
    """Of all of them."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def scaled(odometry: RawOdometry) -> RawOdometry:
            return replace(odometry, quats_xyzw=odometry.quats_xyzw * self.length)

        return ChangeMessages(ODOMETRIES, scaled)


def _believed(
    recording: Recording, moved: ScaleMotion, radius_factor: float = 1.0, track_factor: float = 1.0
) -> Edit:
    """Other numbers of the wheels where counters carry them, and what the odometry makes of it."""
    if not recording.ticks:
        return moved
    return Edits((moved, ScaleWheelNumbers(TICKS, radius_factor, track_factor)))


def _rewired(order: Pair = (0, 1), signs: Pair = (1, 1)) -> Edit:
    return Edits((RewireWheels(COUNTS, order, signs), FollowTicks()))
