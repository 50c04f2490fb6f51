"""Scans of which every n-th beam alone was kept, with the declaration of the whole fan left."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slamsim.check.calibration.joint import Calibration
from slamsim.check.motion.laser_steps import thinned_by
from slamsim.core.geometry import wrap_angle
from slamsim.recording.edits.beams import Pivot
from slamsim.slam.laser.scan_motion import ScanMotions


@dataclass(frozen=True, slots=True)
class Thinned:
    """every: which beams were kept, 2 for every second. pivot: the beam whose direction is as it is
    declared. turned_rad: by how much all rays look further to the left, seen from above, than if
    that were the middle beam, as they are taken to where the mount is measured."""

    every: int
    pivot: Pivot
    turned_rad: float


def thinned(motions: ScanMotions, calibration: Calibration | None) -> Thinned | None:
    """None of scans that have all their beams.

    That a driver leaves the angle of the first beam as it was, or of the last, puts the middle beam
    tens of degrees beside where it is declared: of these and a laser that looks elsewhere, that is
    taken which leaves least to the mount.
    """
    every = thinned_by(motions)
    if every == 1:
        return None
    about_middle = Thinned(every, "middle", 0.0)
    if calibration is None or not calibration.scans_count or not calibration.follows("wheel"):
        return about_middle
    inputs = calibration.inputs
    if inputs.wheels is None or inputs.T_base_laser is None or calibration.alignment.mirror:
        return about_middle
    half_rad = 0.5 * motions.span_rad * (1.0 - 1.0 / every)
    half_rad = -half_rad if inputs.upside_down else half_rad
    ways = about_middle, Thinned(every, "first", half_rad), Thinned(every, "last", -half_rad)
    off_rad = calibration.value("laser_yaw_rad") - float(inputs.T_base_laser[2])
    return min(ways, key=lambda way: abs(float(wrap_angle(np.asarray(off_rad - way.turned_rad)))))
