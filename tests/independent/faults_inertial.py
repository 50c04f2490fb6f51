"""Faults of the inertial unit."""

from __future__ import annotations

from functools import partial

import numpy as np

from independent.fault import Fault, Made, fault
from independent.recorded import Imu, after, rpy_matrix, rpy_quaternion
from independent.robots import Robot
from independent.sensors import GRAVITY_M_S2


def _imu(made: Made) -> Imu:
    return made.bag.imu[0]


def _turned(made: Made, roll: float, pitch: float, yaw: float) -> None:
    """Mounted otherwise than declared, by these degrees about the declared axes; an orientation
    that the unit estimates is its own, wherever its axes point."""
    angles = np.deg2rad([roll, pitch, yaw])
    imu, turn = _imu(made), rpy_matrix(*angles)
    imu.gyro, imu.acceleration = imu.gyro @ turn, imu.acceleration @ turn
    if imu.quaternion is not None:
        imu.quaternion = after(imu.quaternion, rpy_quaternion(*angles))


def _gyro_times(made: Made, factor: float) -> None:
    _imu(made).gyro = _imu(made).gyro * factor


def _acceleration_times(made: Made, factor: float) -> None:
    _imu(made).acceleration = _imu(made).acceleration * factor


def _no_gravity(made: Made) -> None:
    _imu(made).acceleration = _imu(made).acceleration - [0.0, 0.0, GRAVITY_M_S2]


def _stuck(made: Made, begin: float, end: float) -> None:
    imu = _imu(made)
    first, last = (int(share * len(imu.gyro)) for share in (begin, end))
    imu.gyro, imu.acceleration = imu.gyro.copy(), imu.acceleration.copy()
    imu.gyro[first:last], imu.acceleration[first:last] = imu.gyro[first], imu.acceleration[first]


def _repeated(made: Made, count: int) -> None:
    """Every reading so many times, each with a stamp of its own."""
    imu = _imu(made)
    index = np.arange(len(imu.gyro)) // count * count
    imu.gyro, imu.acceleration = imu.gyro[index], imu.acceleration[index]


def _not_numbers(made: Made) -> None:
    _imu(made).gyro = _imu(made).gyro.copy()
    _imu(made).gyro[100:110] = np.nan


def _spikes(made: Made) -> None:
    imu = _imu(made)
    hit = made.rng.random(len(imu.gyro)) < 0.005
    imu.acceleration = imu.acceleration + hit[:, None] * made.rng.normal(0.0, 300.0, (len(hit), 3))


def _dead_axis(made: Made) -> None:
    _imu(made).gyro = _imu(made).gyro * [1.0, 1.0, 0.0]


def _saturated(made: Made, at_rad_s: float) -> None:
    _imu(made).gyro = np.clip(_imu(made).gyro, -at_rad_s, at_rad_s)


def _bias_step(made: Made, by_rad_s: float) -> None:
    later = np.arange(len(_imu(made).gyro)) > 0.5 * len(_imu(made).gyro)
    _imu(made).gyro = _imu(made).gyro + later[:, None] * [0.0, 0.0, by_rad_s]


def _orientation(made: Made, kind: str) -> None:
    imu = _imu(made)
    there = imu.quaternion if imu.quaternion is not None else np.zeros((len(imu.gyro), 4))
    if kind == "zero":
        imu.quaternion = np.zeros_like(there)
    elif kind == "identity":
        imu.quaternion = np.tile([0.0, 0.0, 0.0, 1.0], (len(there), 1))
    elif kind == "w first":
        imu.quaternion = np.roll(there, 1, axis=1)
    else:
        imu.quaternion = there * [1.0, 1.0, -1.0, 1.0]


def _oriented(robot: Robot) -> bool:
    return robot.orientation


INERTIAL_FAULTS: list[Fault] = [
    *(
        fault(
            name, "imu_mount", "imu_axis", change=partial(_turned, roll=roll, pitch=pitch, yaw=yaw)
        )
        for name, roll, pitch, yaw in (
            ("imu_yaw_90", 0.0, 0.0, 90.0),
            ("imu_yaw_180", 0.0, 0.0, 180.0),
            ("imu_yaw_30", 0.0, 0.0, 30.0),
            ("imu_tilted_8", 8.0, 0.0, 0.0),
            ("imu_pitched_12", 0.0, 12.0, 0.0),
            ("imu_on_its_side", 90.0, 0.0, 0.0),
        )
    ),
    fault(
        "imu_upside_down",
        "imu_mount",
        "imu_axis gyro_sign",
        change=partial(_turned, roll=180.0, pitch=0.0, yaw=0.0),
    ),
    fault("gyro_sign", "gyro_unit", "gyro_sign", change=partial(_gyro_times, factor=-1.0)),
    fault(
        "gyro_degrees",
        "gyro_unit",
        "gyro_degrees",
        change=partial(_gyro_times, factor=180.0 / np.pi),
    ),
    fault("gyro_x2", "gyro_unit", "gyro_scale", change=partial(_gyro_times, factor=2.0)),
    fault(
        "acceleration_g",
        "gravity",
        "gravity_units",
        change=partial(_acceleration_times, factor=1.0 / GRAVITY_M_S2),
        pairs=True,
    ),
    fault(
        "acceleration_mg",
        "gravity",
        "gravity_units",
        change=partial(_acceleration_times, factor=1e3 / GRAVITY_M_S2),
    ),
    fault(
        "acceleration_cm",
        "gravity",
        "gravity_units",
        change=partial(_acceleration_times, factor=1e2),
    ),
    fault(
        "acceleration_negative", "gravity", None, change=partial(_acceleration_times, factor=-1.0)
    ),
    fault("gravity_removed", "gravity", "gravity_missing", change=_no_gravity, pairs=True),
    fault(
        "imu_stuck_5s",
        "imu_stuck",
        "imu_stuck",
        change=partial(_stuck, begin=0.4, end=0.4 + 5.0 / 60.0),
    ),
    fault("imu_stuck_20s", "imu_stuck", "imu_stuck", change=partial(_stuck, begin=0.5, end=0.83)),
    fault("imu_repeats_x4", "imu_stuck", "imu_stuck", change=partial(_repeated, count=4)),
    fault("imu_nan", "imu_values", "imu_invalid", change=_not_numbers, pairs=True),
    fault("imu_spikes", "imu_values", "imu_spikes", change=_spikes, pairs=True),
    fault("gyro_z_dead", "gyro_dead", "imu_axis_dead", change=_dead_axis),
    fault(
        "gyro_saturates", "gyro_dead", "gyro_saturated", change=partial(_saturated, at_rad_s=0.4)
    ),
    fault(
        "gyro_bias_step",
        "gyro_step",
        "gyro_bias_changed",
        change=partial(_bias_step, by_rad_s=0.05),
    ),
    fault(
        "orientation_zero",
        "orientation",
        "imu_orientation",
        change=partial(_orientation, kind="zero"),
    ),
    fault(
        "orientation_identity",
        "orientation",
        "imu_orientation",
        change=partial(_orientation, kind="identity"),
    ),
    fault(
        "orientation_w_first",
        "orientation",
        "imu_orientation quaternion_order",
        change=partial(_orientation, kind="w first"),
        fits=_oriented,
    ),
    fault(
        "orientation_other_way",
        "orientation",
        "imu_orientation",
        change=partial(_orientation, kind="other way"),
        fits=_oriented,
    ),
]
