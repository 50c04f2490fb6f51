"""Faults of how the laser looks: directions, mounting, order of the beams in space."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from slamsim.config.sensors import SensorsConfig
from slamsim.core.geometry import matrix_from_rpy, se3_from_parts
from slamsim.recording import Recording, ScanLayout
from slamsim.sensors.faults.base import Fault, SensedFault
from slamsim.sensors.faults.edit import with_layouts, with_ranges
from slamsim.sensors.faults.motion import beam_angles, is_timed, looked_at, plane_motion, refired
from slamsim.sensors.faults.mounting import with_mount
from slamsim.sensors.motion import Knots

AXES = np.eye(3)


class LaserWorldFixed(SensedFault):
    """The rays start where the laser is, but keep their directions in the world."""

    kind: Literal["laser_world_fixed"]

    def course(self, knots: Knots, config: SensorsConfig) -> Knots:
        count = knots.stamps_ns.size
        return replace(
            knots, x_axis=np.tile(AXES[0], (count, 1)), y_axis=np.tile(AXES[1], (count, 1))
        )

    def declare(self, recording: Recording, config: SensorsConfig) -> Recording:
        return recording

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        motion = plane_motion(recording)
        return with_ranges(
            recording,
            lambda ranges, scans: looked_at(
                ranges, scans.layout(0), -motion.heading_at(scans.stamps_ns)[:, None]
            ),
        )


class LaserMirrored(SensedFault):
    """What lies to the left is reported to the right: left-handed, or hung upside down."""

    kind: Literal["laser_mirrored"]

    def course(self, knots: Knots, config: SensorsConfig) -> Knots:
        return replace(knots, y_axis=-knots.y_axis)

    def declare(self, recording: Recording, config: SensorsConfig) -> Recording:
        return recording

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        if is_timed(recording):  # the beam that comes first in the message still fires first
            recording = refired(recording, lambda beam: beam[::-1] - beam)
        return with_ranges(
            recording,
            lambda ranges, scans: looked_at(
                ranges, scans.layout(0), -2.0 * beam_angles(scans.layout(0), ranges.shape[1])
            ),
        )


class LaserMount(Fault):
    """The laser is mounted otherwise than its frame says, by a turn about one axis."""

    SIZE: ClassVar[str | None] = "angle_deg"
    kind: Literal["laser_mount_angle"]
    axis: Literal["roll", "pitch", "yaw"]
    """About which axis of the laser."""
    angle_deg: float = Field(ge=-180.0, le=180.0)
    """How far the laser is turned against what its frame says."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        angles = [np.radians(self.angle_deg) * (self.axis == a) for a in ("roll", "pitch", "yaw")]
        turned = se3_from_parts(matrix_from_rpy(*angles), np.zeros(3))
        return with_mount(recording, recording.scans, lambda T: T @ np.linalg.inv(turned))


class LaserPosition(Fault):
    """The laser sits elsewhere than its frame says."""

    SIZE: ClassVar[str | None] = "by_m"
    kind: Literal["laser_mount_position"]
    axis: Literal["x", "y"]
    """Along which axis of the frame that carries it."""
    by_m: float = Field(ge=-1.0, le=1.0)
    """How much further the laser sits than its frame says."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        shift = self.by_m * AXES["xy".index(self.axis)]
        moved = se3_from_parts(np.eye(3), -shift)
        return with_mount(recording, recording.scans, lambda T: moved @ T)


class LaserAngleStep(Fault):
    """The declared angle between beams is wrong, about the middle of the scan."""

    SIZE: ClassVar[str | None] = "relative_error"
    kind: Literal["laser_angle_step"]
    relative_error: float = Field(gt=-0.9, le=10.0)
    """Declared over true, less one."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        def widened(layout: ScanLayout) -> ScanLayout:
            middle = 0.5 * (layout.angle_min_rad + layout.angle_max_rad)
            half = 0.5 * (layout.angle_max_rad - layout.angle_min_rad)
            half *= 1.0 + self.relative_error
            step = layout.angle_step_rad * (1.0 + self.relative_error)
            return replace(
                layout,
                angle_min_rad=middle - half,
                angle_max_rad=middle + half,
                angle_step_rad=step,
            )

        return with_layouts(recording, widened)


class LaserDegrees(Fault):
    """Angles are declared in degrees where radians are asked for."""

    kind: Literal["laser_degrees"]
    only_step: bool = False
    """Only the step between beams is in degrees, the two ends are right."""

    def inject(self, recording: Recording, rng: np.random.Generator) -> Recording:
        def in_degrees(layout: ScanLayout) -> ScanLayout:
            step = float(np.degrees(layout.angle_step_rad))
            if self.only_step:
                return replace(layout, angle_step_rad=step)
            ends = np.degrees([layout.angle_min_rad, layout.angle_max_rad])
            return replace(
                layout,
                angle_min_rad=float(ends[0]),
                angle_max_rad=float(ends[1]),
                angle_step_rad=step,
            )

        return with_layouts(recording, in_degrees)
