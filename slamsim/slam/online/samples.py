"""What a robot says about its motion while it drives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from slamsim.core.types import EncoderStream, ImuStream, PlanarTrajectory
from slamsim.guard.numbers import require_stamps
from slamsim.slam.frontend.motion import Odometry


@dataclass(frozen=True, slots=True, eq=False)
class MotionSamples:
    """What arrived since the last step, each stream in time order; None for a silent one.

    odometry: ``T_odom_base`` as some driver publishes it. encoders: cumulative ticks, preferred
    to odometry where both come. imu: in the frame of its mount.
    """

    odometry: PlanarTrajectory | None = None
    encoders: EncoderStream | None = None
    imu: ImuStream | None = None

    def __post_init__(self) -> None:
        for what, stream in (("an IMU", self.imu), ("wheel encoders", self.encoders)):
            if stream is not None:
                require_stamps(f"new samples of {what}", stream.stamps_ns)


NOTHING = MotionSamples()


class MotionSource(Protocol):
    """Knows how the robot moved, as far as messages tell by now."""

    def add(self, samples: MotionSamples) -> None:
        """Take what arrived."""
        ...

    def until(self, stamp_ns: int) -> Odometry | None:
        """From the last scan to the given instant or beyond, None if unknown."""
        ...


class WholeMotion:
    """The motion of a log, all of it known before the first scan."""

    def __init__(self, odometry: Odometry | None) -> None:
        self._odometry = odometry

    def add(self, samples: MotionSamples) -> None:
        """Nothing can be added to it."""

    def until(self, stamp_ns: int) -> Odometry | None:
        """See ``MotionSource``."""
        return self._odometry
