"""Names of faults that are explained together, by ``FaultKind.explains``."""

from __future__ import annotations

LIDAR_TIMES = ("time_offset_lidar", "scan_stamp_end", "scan_stamp_middle", "clocks_apart")
SWEEPS = ("beam_time_scale", "beam_time_reversed", "flash_scan_timed", "rolling_scan_untimed")
MOUNTING = ("laser_yaw", "laser_position")
CHANGES = ("laser_moved", "wheels_changed")
SIZES = (
    *("wheel_radius", "wheel_track", "wheel_slip", "gyro_scale", "range_scale"),
    *(*MOUNTING, *CHANGES),
)
STAMPS = ("stamps_quantised", "stamps_repeated", "stamps_jitter", "stamps_backward", "stream_gaps")
WHEELS = (
    *("wheel_slip", "wheel_track", "wheel_radius", "wheel_reversed", "wheels_swapped"),
    *("odometry_contradicts_wheels", "time_offset_wheels"),
)
BY_SCANS = (
    *(*SIZES, *SWEEPS, *LIDAR_TIMES),
    *("laser_angle_step", "laser_world_fixed", "laser_mirrored", "range_offset"),
    *("scan_interference", "stamps_invented", "odometry_frozen", "clock_drift"),
)
"""All that scans are matched for: wrong where their stamps are no instants."""
