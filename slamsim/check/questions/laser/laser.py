"""The laser: how it looks, whether it turns with the robot, and when its beams fire."""

from __future__ import annotations

from slamsim.check.findings import Finding
from slamsim.check.motion.inputs import Inputs
from slamsim.check.motion.scan_activity import activity
from slamsim.check.questions.laser.rotation import check_rotation
from slamsim.check.questions.laser.shape import check_angles, check_range_offset, check_sweep
from slamsim.recording import Recording, RecordingFormat
from slamsim.slam.laser.scan_motion import ScanMotions, scan_motions


def laser_motions(recording: Recording) -> ScanMotions | None:
    """Of the lidar with most scans, by its scans alone; None without any lidar."""
    if not recording.scans:
        return None
    scans = max(recording.scans, key=len)
    return scan_motions(scans, activity(recording, scans))


def check_laser(
    motions: ScanMotions, inputs: Inputs, recorded_as: RecordingFormat
) -> list[Finding]:
    """Rotation, angles, sweep and offset of the ranges. inputs: as the joint fit gathers them."""
    if not motions.windows:
        words = f"the scans tell nothing of their motion: {motions.weak}"
        return [Finding("laser.rotation", motions.topic, "cannot tell", words)]
    rotation = check_rotation(inputs)
    shape = [*check_angles(motions), check_sweep(motions, recorded_as)]
    if rotation.fault == "laser_world_fixed":
        # A beam that does not turn with the laser has no fixed place among the others.
        reason = "rays fixed to the world hide it"
        shape = [one.untold(reason) if one.verdict == "bad" else one for one in shape]
    return [rotation, *shape, check_range_offset(motions)]
