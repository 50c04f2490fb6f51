"""True values of the checker's estimates, from the simulation and the injected faults."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slamsim.config.run import RunConfig
from slamsim.config.sensors import EncoderConfig
from slamsim.sensors.faults.base import Fault
from slamsim.sensors.faults.imu import GyroScale
from slamsim.sensors.faults.laser import (
    BeamTimeReversed,
    BeamTimeScale,
    FlashScanTimed,
    LaserAngleStep,
    LaserMount,
    LaserPosition,
)
from slamsim.sensors.faults.ranges import RangeOffset
from slamsim.sensors.faults.stamps import TimeOffset
from slamsim.sensors.faults.wheels import WheelRadius, WheelTrack

Truth = dict[str, float]
"""The true value of an estimate under the name of its check, in the estimate's unit."""


def truths(config: RunConfig, faults: Sequence[Fault]) -> Truth:
    """Of the healthy recording; with one fault, of what that fault changes.

    Nothing where a fault has no number, or where there are several.
    """
    if not faults:
        return _healthy(config)
    return _changed(_healthy(config), faults[0]) if len(faults) == 1 else {}


def _healthy(config: RunConfig) -> Truth:
    wheels = config.sensors.encoders
    gyro = config.sensors.imu.gyro
    return {
        "time.offset.lidar_imu": 0.0,
        "time.offset.lidar_wheels": 0.0,
        "time.offset.imu_wheels": 0.0,
        "time.drift": 0.0,
        "wheels.radius": 100.0 * (_believed_radius(wheels) - 1.0),
        "wheels.unequal": 100.0 * (wheels.wheel_scale_error[0] - wheels.wheel_scale_error[1]),
        "wheels.track": 100.0 * wheels.track_error,
        "gyro.scale": 100.0 * gyro.scale_error[2],
        "laser.yaw": 0.0,
        "laser.x": 0.0,
        "laser.y": 0.0,
        "laser.angle_step": 0.0,
        "laser.sweep": 1.0,
        "ranges.offset": 0.0,
    }


def _believed_radius(wheels: EncoderConfig) -> float:
    """How far the driver thinks that it went, over how far it went."""
    return (1.0 + wheels.wheel_radius_error) * (1.0 + float(np.mean(wheels.wheel_scale_error)))


def _changed(healthy: Truth, fault: Fault) -> Truth:
    """What a fault with a number makes of the estimates that it changes; nothing of others.

    A drift of clocks is not among them: which of two clocks a small one is told of is open, and
    with it the sign.
    """
    match fault:
        case TimeOffset():
            return _offsets(fault)
        case WheelRadius():
            return {"wheels.radius": _times(healthy["wheels.radius"], fault.relative_error)}
        case WheelTrack():
            return {"wheels.track": _times(healthy["wheels.track"], fault.relative_error)}
        case GyroScale():
            return {"gyro.scale": _times(healthy["gyro.scale"], fault.factor - 1.0)}
        case LaserMount(axis="yaw"):
            return {"laser.yaw": fault.angle_deg}
        case LaserPosition():
            return {f"laser.{fault.axis}": 1e3 * fault.by_m}
        case LaserAngleStep():
            return {"laser.angle_step": 100.0 * fault.relative_error}
        case RangeOffset():
            return {"ranges.offset": 1e3 * fault.offset_m}
        case BeamTimeScale():  # the true time between beams over the declared one
            return {"laser.sweep": 1.0 / fault.factor}
        case FlashScanTimed():
            return {"laser.sweep": 0.0}
        case BeamTimeReversed():
            return {"laser.sweep": -1.0}
    return {}


def _offsets(fault: TimeOffset) -> Truth:
    late_ms = 1e3 * fault.offset_s
    pairs = {
        "lidar": {"lidar_imu": -late_ms, "lidar_wheels": -late_ms},
        "imu": {"lidar_imu": late_ms, "imu_wheels": -late_ms},
        "wheels": {"lidar_wheels": late_ms, "imu_wheels": late_ms},
    }[fault.stream]
    return {
        f"time.offset.{fault.stream}": late_ms,
        **{f"time.offset.{pair}": offset for pair, offset in pairs.items()},
    }


def _times(percent: float, relative_error: float) -> float:
    """One error on top of another, in per cent."""
    return 100.0 * ((1.0 + 0.01 * percent) * (1.0 + relative_error) - 1.0)
