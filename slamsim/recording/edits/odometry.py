"""Edits of odometry: its path scaled, cleared of jumps, or computed from the wheel counters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from slamsim.core.types import FloatArray, IntArray
from slamsim.models.differential_drive import wheel_odometry
from slamsim.recording import RawJoints, RawOdometry, RawTicks, Recording, TransformEdge
from slamsim.recording.edits.base import DRIVEN, CannotEdit, Edit, MessagesEdit, reciprocal
from slamsim.recording.edits.frames import with_odometry_edge
from slamsim.recording.edits.motion import (
    along_path,
    counted,
    encoder_stream,
    follows,
    per_message,
    scaled_edge,
    scaled_odometry,
    stepped,
    with_twists,
)


@dataclass(frozen=True, slots=True)
class ScaleMotion(MessagesEdit):
    """Distances and turns of odometry and of its transform times a factor each.

    Each step is taken in the heading midway, so that the inverse gives the path back.
    """

    path: float
    turn: float

    def changed(self, one: RawOdometry | TransformEdge) -> RawOdometry | TransformEdge:
        if isinstance(one, TransformEdge):
            return scaled_edge(one, self.path, self.turn)
        return scaled_odometry(one, self.path, self.turn)

    def inverse(self) -> ScaleMotion:
        return replace(self, path=reciprocal(self.path), turn=reciprocal(self.turn))


@dataclass(frozen=True, slots=True)
class ScaleSteps(MessagesEdit):
    """Counters, joints and odometry with each of their steps multiplied: slip, or standing still.

    gain: from (n,) stamps of one topic to the (n - 1,) factors of its steps.
    """

    gain: Callable[[IntArray], FloatArray]

    def changed(
        self, one: RawTicks | RawJoints | RawOdometry | TransformEdge
    ) -> RawTicks | RawJoints | RawOdometry | TransformEdge:
        gain = self.gain(one.stamps_ns)
        if isinstance(one, RawTicks):
            return replace(one, ticks=stepped(one.ticks, gain).astype(np.int64))
        if isinstance(one, RawJoints):
            return replace(
                one,
                positions_rad=stepped(one.positions_rad, gain),
                velocities_rad_s=one.velocities_rad_s * per_message(gain, len(one)),
            )
        if isinstance(one, RawOdometry):
            return scaled_odometry(one, gain, gain)
        return scaled_edge(one, gain, gain)


@dataclass(frozen=True, slots=True)
class FollowTicks(Edit):
    """All odometry, and its transform, as a driver computes it from the first counters."""

    def apply(self, recording: Recording) -> Recording:
        if not any(len(ticks) for ticks in recording.ticks):
            raise CannotEdit(f"{recording.name} has no wheel counters")
        path = wheel_odometry(encoder_stream(recording.ticks[0]))

        def following(one: RawOdometry | TransformEdge) -> RawOdometry | TransformEdge:
            positions, quats = along_path(one, path)
            if isinstance(one, TransformEdge):
                return replace(one, positions_m=positions, quats_xyzw=quats)
            return with_twists(replace(one, positions_m=positions, quats_xyzw=quats))

        return DRIVEN.changed(recording, following)


@dataclass(frozen=True, slots=True)
class ChangeOdometry(Edit):
    """One odometry changed, and the transform of its frames to what it says then, if published."""

    topic: str
    change: Callable[[RawOdometry], RawOdometry]

    def apply(self, recording: Recording) -> Recording:
        for odometry in recording.odometries:
            if odometry.topic == self.topic:
                changed = self.change(odometry)
                streams = (changed if each is odometry else each for each in recording.streams)
                found = replace(recording, streams=tuple(streams))
                names = odometry.frame_ids[:1] + odometry.child_frame_ids[:1]
                published = any((e.parent, e.child) == names for e in recording.transforms)
                return with_odometry_edge(found, changed) if published else found
        raise CannotEdit(f"there is no odometry on {self.topic!r}")


@dataclass(frozen=True, slots=True)
class NormaliseRotations(MessagesEdit):
    """Quaternions of odometry brought to unit length."""

    def changed(self, odometry: RawOdometry) -> RawOdometry:
        length = np.linalg.norm(odometry.quats_xyzw, axis=1, keepdims=True)
        with np.errstate(invalid="ignore"):
            return replace(odometry, quats_xyzw=odometry.quats_xyzw / length)


@dataclass(frozen=True, slots=True)
class OdometryFromTicks(Edit):
    """One odometry computed anew from the first counters."""

    topic: str

    def apply(self, recording: Recording) -> Recording:
        if not recording.ticks:
            raise CannotEdit("there are no wheel counters to compute an odometry from")
        ticks = recording.ticks[0]
        return ChangeOdometry(self.topic, lambda o: counted(o, ticks)).apply(recording)


@dataclass(frozen=True, slots=True)
class WithOdometry(Edit):
    """An edit of the counters on ``topic``, and every odometry that follows them made anew."""

    topic: str
    edit: Edit

    def apply(self, recording: Recording) -> Recording:
        found = self.edit.apply(recording)
        before, after = ({t.topic: t for t in r.ticks}[self.topic] for r in (recording, found))
        for odometry in recording.odometries:
            if follows(odometry, before):
                found = ChangeOdometry(odometry.topic, lambda o: counted(o, after)).apply(found)
        return found

    def inverse(self) -> WithOdometry:
        return replace(self, edit=self.edit.inverse())
