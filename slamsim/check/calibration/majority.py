"""Scans, gyroscope and wheels each measure every turn: which of them contradicts the majority."""

from __future__ import annotations

from dataclasses import dataclass

from slamsim.check.calibration.joint import Calibration

SAME_TURNS = 0.004
"""Turns that differ by less than this share are no contradiction."""

MUCH_CLOSER = 0.5


@dataclass(frozen=True, slots=True)
class Majority:
    """What two of the three say of the third.

    gyro_gain, turn_gain: true turn over that by gyroscope and by wheels, 1 if all is well.
    laser_gain: by how much scans turn too far, where gyroscope and wheels both say so, else 1.
    """

    gyro_gain: float
    turn_gain: float
    laser_gain: float


def majority(calibration: Calibration) -> Majority:
    """Scans are believed unless gyroscope and wheels agree with each other and not with them."""
    gyro, turn = calibration.value("gyro_gain"), calibration.value("turn_gain")
    path = calibration.value("path_gain")
    both = calibration.follows("gyro") and calibration.follows("wheel")
    off = abs(gyro - 1.0)
    # Wheels of another size go another path as well; a laser that turns too far does not.
    wheels_alone = (
        abs(turn / path - 1.0) < MUCH_CLOSER * off and abs(path - 1.0) > MUCH_CLOSER * off
    )
    laser = both and off > SAME_TURNS and abs(turn - gyro) < MUCH_CLOSER * off and not wheels_alone
    return Majority(gyro / gyro, turn / gyro, gyro) if laser else Majority(gyro, turn, 1.0)
