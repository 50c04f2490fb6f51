"""Faults of how the laser looks: directions, mounting, order and times of the beams."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import Field

from slamsim.config.sensors import SensorsConfig
from slamsim.core.geometry import matrix_from_rpy, se3_from_parts
from slamsim.core.types import Float32Array
from slamsim.recording import RawScans, Recording, ScanLayout
from slamsim.recording.edits.base import SCANS, CannotEdit, Edit, Edits
from slamsim.recording.edits.beams import (
    ChangeLayouts,
    ConvertAngles,
    ScaleAngles,
    ScaleBeamTimes,
    SetSweep,
)
from slamsim.recording.edits.frames import MoveMount
from slamsim.recording.edits.messages import ChangeMessages
from slamsim.recording.edits.ranges import ChangeRanges
from slamsim.recording.edits.stamps import ShiftWithinScan
from slamsim.sensors.faults.base import Fault, SensedFault
from slamsim.sensors.faults.resensing import (
    beam_angles,
    is_timed,
    looked_at,
    plane_motion,
    refired,
    require_timed,
)
from slamsim.sensors.motion import PoseSamples

AXES = np.eye(3)


def _turned_by_heading(recording: Recording, turns: float) -> Edit:
    """Rays that look so many times the robot's heading further to the left."""
    motion = plane_motion(recording)
    return ChangeRanges(
        SCANS,
        lambda ranges, scans: looked_at(
            ranges, scans.layout(0), turns * motion.heading_at(scans.stamps_ns)[:, None]
        ),
    )


class LaserWorldFixed(SensedFault):
    """The rays start where the laser is, but keep their directions in the world."""

    kind: Literal["laser_world_fixed"]

    def override(self, samples: PoseSamples, config: SensorsConfig) -> PoseSamples:
        count = samples.stamps_ns.size
        return replace(
            samples, x_axis=np.tile(AXES[0], (count, 1)), y_axis=np.tile(AXES[1], (count, 1))
        )

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return _turned_by_heading(recording, -1.0)


class LaserTurnedTwice(Fault):
    """The robot's heading is in the rays already, and the driver adds it again."""

    kind: Literal["laser_turned_twice"]

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return _turned_by_heading(recording, 1.0)


class LaserKnocked(Fault):
    """The laser is turned on its mount half way through the recording."""

    kind: Literal["laser_knocked"]
    angle_deg: float = Field(ge=-180.0, le=180.0)
    """To the left; rounded to whole beams."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def knocked(ranges_m: Float32Array, scans: RawScans) -> Float32Array:
            begin_ns, end_ns = scans.stamps_ns.min(), scans.stamps_ns.max()
            late = scans.stamps_ns - begin_ns > (end_ns - begin_ns) // 2
            turned_rad = np.where(late, np.deg2rad(self.angle_deg), 0.0)
            return looked_at(ranges_m, scans.layout(0), turned_rad[:, None])

        return ChangeRanges(SCANS, knocked)


class LaserMirrored(SensedFault):
    """What lies to the left is reported to the right: left-handed, or hung upside down."""

    kind: Literal["laser_mirrored"]

    def override(self, samples: PoseSamples, config: SensorsConfig) -> PoseSamples:
        return replace(samples, y_axis=-samples.y_axis)

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        mirrored = ChangeRanges(
            SCANS,
            lambda ranges, scans: looked_at(
                ranges, scans.layout(0), -2.0 * beam_angles(scans.layout(0), ranges.shape[1])
            ),
        )
        if not is_timed(recording):
            return mirrored
        # The beam that comes first in the message still fires first.
        return Edits((refired(recording, lambda beam: beam[::-1] - beam), mirrored))


class LaserMount(Fault):
    """The laser is mounted otherwise than its frame says, by a turn about one axis."""

    kind: Literal["laser_mount_angle"]
    axis: Literal["roll", "pitch", "yaw"]
    """About which axis of the laser."""
    angle_deg: float = Field(ge=-180.0, le=180.0)
    """How far the laser is turned against what its frame says."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        angles = [np.radians(self.angle_deg) * (self.axis == a) for a in ("roll", "pitch", "yaw")]
        turned = se3_from_parts(matrix_from_rpy(*angles), np.zeros(3))
        return MoveMount(_laser_frames(recording), turned, "sensor").inverse()


class LaserPosition(Fault):
    """The laser sits elsewhere than its frame says."""

    kind: Literal["laser_mount_position"]
    axis: Literal["x", "y"]
    """Along which axis of the frame that carries it."""
    by_m: float = Field(ge=-1.0, le=1.0)
    """How much further the laser sits than its frame says."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        shift = self.by_m * AXES["xy".index(self.axis)]
        moved = se3_from_parts(np.eye(3), -shift)
        return MoveMount(_laser_frames(recording), moved, "parent")


class LaserAngleStep(Fault):
    """The declared angle between beams is wrong, about the middle of the scan."""

    kind: Literal["laser_angle_step"]
    relative_error: float = Field(gt=-0.9, le=10.0)
    """Declared over true, less one."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return ScaleAngles(SCANS, 1.0 + self.relative_error)


class LaserDegrees(Fault):
    """Angles are declared in degrees where radians are asked for."""

    kind: Literal["laser_degrees"]
    only_step: bool = False
    """Only the step between beams is in degrees, the two ends are right."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return ConvertAngles(SCANS, "degrees", ends=not self.only_step)


def _laser_frames(recording: Recording) -> frozenset[str]:
    return frozenset(frame for scans in recording.scans for frame in scans.frame_ids)


_FULL_TURN = 2.0 * np.pi
"""Radians."""


class BeamTimeReversed(SensedFault):
    """The lidar turns clockwise, its driver turns the order round and leaves the times."""

    kind: Literal["beam_time_reversed"]

    def override(self, samples: PoseSamples, config: SensorsConfig) -> PoseSamples:
        """Beam i looks where the last beam but i would: the axes mirrored about the middle."""
        lidar = config.lidar
        both_ends = 2.0 * lidar.angle_min_deg + (lidar.beam_count - 1) * lidar.angle_step_deg
        cos, sin = np.cos(np.radians(both_ends)), np.sin(np.radians(both_ends))
        return replace(
            samples,
            x_axis=cos * samples.x_axis + sin * samples.y_axis,
            y_axis=sin * samples.x_axis - cos * samples.y_axis,
        )

    def declare(self, config: SensorsConfig) -> Edit:
        return ChangeRanges(
            SCANS, lambda ranges, _: np.ascontiguousarray(ranges[:, ::-1], dtype=np.float32)
        )

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return refired(recording, lambda beam: beam[::-1] - beam)


class FlashScanTimed(SensedFault):
    """All beams see one instant, and are declared as fired one after the other."""

    kind: Literal["flash_scan_timed"]

    def sensors(self, config: SensorsConfig) -> SensorsConfig:
        return config.model_copy(
            update={"lidar": config.lidar.model_copy(update={"rolling": False})}
        )

    def declare(self, config: SensorsConfig) -> Edit:
        beam_dt_s = float(np.float32(config.lidar.beam_dt_ns * 1e-9))
        return ChangeLayouts(SCANS, lambda layout: replace(layout, beam_dt_s=beam_dt_s))

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        if all(layout.beam_dt_s == 0.0 for scans in recording.scans for layout in scans.layouts):
            return ChangeMessages(SCANS, _timed)
        return refired(recording, lambda beam: -beam)


class RollingScanUntimed(Fault):
    """Beams fire one after the other, and are declared as of one instant."""

    kind: Literal["rolling_scan_untimed"]

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        require_timed(recording)
        return SetSweep(SCANS, 0.0)


class BeamTimeScale(Fault):
    """The declared time between beams is wrong."""

    kind: Literal["beam_time_scale"]
    factor: float = Field(gt=0.0, le=100.0)
    """Declared over true."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        require_timed(recording)
        return ScaleBeamTimes(SCANS, self.factor)


class ScanStamp(Fault):
    """The stamp is not that of the first beam but of a later instant of the scan."""

    kind: Literal["scan_stamp"]
    share: float = Field(ge=-1.0, le=2.0)
    """Of the scan's duration that has passed at the stamp: 1 is the last beam."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        require_timed(recording)
        return ShiftWithinScan(SCANS, self.share)


def _timed(scans: RawScans) -> RawScans:
    """Scans of one instant with the times of a mirror that turns once from scan to scan."""
    period_s = float(np.median(np.diff(scans.stamps_ns))) * 1e-9 if len(scans) > 1 else 0.0
    if not period_s > 0.0:
        raise CannotEdit(f"{scans.topic}: its stamps show no period")

    def timed(layout: ScanLayout) -> ScanLayout:
        turn_s = layout.scan_time_s if layout.scan_time_s > 0.0 else period_s
        return replace(layout, beam_dt_s=turn_s * abs(layout.angle_step_rad) / _FULL_TURN)

    return replace(scans, layouts=tuple(map(timed, scans.layouts)))
