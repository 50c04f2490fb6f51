"""The motion of the laser by its scans alone, estimated where other sensors say that much happens.

Of the other streams only the activity is used: they are laid side by side from their first message
to their last, without regard to stamps, units and axes, which may all be wrong.
"""

from __future__ import annotations

import numpy as np

from slamsim.core.geometry import wrap_angle, yaw_from_xyzw
from slamsim.core.types import FloatArray
from slamsim.recording import RawScans, Recording
from slamsim.slam.laser.scan_motion import ScanMotions, scan_motions

ACTIVE = 0.9
"""The quantile of a stream's values that counts as activity 1."""

MOST = 2.0


def laser_motions(recording: Recording) -> ScanMotions | None:
    """Of the lidar with most scans; None without any lidar."""
    if not recording.scans:
        return None
    scans = max(recording.scans, key=len)
    return scan_motions(scans, activity(recording, scans))


def activity(recording: Recording, scans: RawScans) -> FloatArray | None:
    """(n,) how much happens at each scan, from 0; None where no other stream tells."""
    signals = [np.linalg.norm(imu.angular_velocity_rad_s, axis=1) for imu in recording.imus]
    for odometry in recording.odometries:
        yaw = yaw_from_xyzw(odometry.quats_xyzw)
        signals.append(np.abs(wrap_angle(np.diff(yaw))))
        signals.append(np.linalg.norm(np.diff(odometry.positions_m, axis=0), axis=1))
    for ticks in recording.ticks:
        counted = np.diff(ticks.ticks, axis=0).astype(np.float64)
        signals += [np.abs(counted.sum(axis=1)), np.abs(counted[:, 1] - counted[:, 0])]
    found = [
        one for one in (_over_scans(signal, len(scans)) for signal in signals) if one is not None
    ]
    return np.sum(found, axis=0) if found else None


def _over_scans(signal: FloatArray, count: int) -> FloatArray | None:
    """A signal of a stream at as many scans, in units of its ``ACTIVE`` quantile."""
    signal = np.nan_to_num(np.asarray(signal, dtype=np.float64), posinf=0.0)
    unit = float(np.quantile(signal, ACTIVE)) if signal.size else 0.0
    if not unit > 0.0:
        return None
    smooth = max(1, signal.size // max(count, 1))
    mean = np.convolve(signal, np.full(smooth, 1.0 / smooth), mode="same")
    at = np.linspace(0.0, 1.0, count)
    return np.interp(at, np.linspace(0.0, 1.0, signal.size), np.minimum(mean / unit, MOST))
