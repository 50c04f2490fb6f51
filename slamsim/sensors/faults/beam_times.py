"""Faults of beam times within a scan: firing order, sweep time, and which beam the stamp means."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import Field

from slamsim.config.sensors import SensorsConfig
from slamsim.recording import RawScans, Recording, ScanLayout
from slamsim.recording.edits.base import SCANS, CannotEdit, Edit
from slamsim.recording.edits.beams import ChangeLayouts, ScaleBeamTimes, SetSweep
from slamsim.recording.edits.messages import ChangeMessages
from slamsim.recording.edits.ranges import ChangeRanges
from slamsim.recording.edits.stamps import ShiftWithinScan
from slamsim.sensors.faults.base import Fault, SensedFault
from slamsim.sensors.faults.resensing import refired, require_timed
from slamsim.sensors.motion import PoseSamples

_FULL_TURN = 2.0 * np.pi


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
