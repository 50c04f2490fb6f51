"""Readings of an inertial unit that are no measurement: not finite, an axis that never changes,
shocks that no robot takes, an orientation that is not estimated."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from slamsim.check.findings import SURE_SIGMAS, Finding, Measurement
from slamsim.check.question import FaultKind, Question, judge, same_subject, unanswered
from slamsim.core.components import runs_of
from slamsim.core.geometry import wrap_angle, yaw_from_xyzw
from slamsim.core.quantiles import SIGMAS_PER_MEDIAN
from slamsim.core.types import BoolArray, FloatArray, IntArray
from slamsim.guard.numbers import MOST, is_sound
from slamsim.recording import RawImu, Recording
from slamsim.recording.cleaning.streams import has_unit_length
from slamsim.recording.repairs.base import Repair

SPIKE_M_S2 = (3.0, 30.0)
"""Of single samples, as Cartographer's validator has it."""
MAX_SPIKE_SHARE, MIN_SPIKES = 1e-3, 3
FALL_S = (0.022, 0.3)
"""A robot that falls, or trots on legs, feels little: never for so short, nor for so long as a fall
of 0.44 m. A dog of MuJoCo that trots has at most 0.03 % of readings that no fall explains at 50 Hz
and above, and 0.7 % below, where a flight is a single reading: between the usual periods of 20 and
25 ms, for clocks are a little off."""
LEAP_RAD_S, LEAP_RAD_S2, LEAP_SIGMAS, BESIDE = 0.3, 30.0, 6.0, 2
"""By so much in a period no robot on wheels turns faster for one reading and back, nor by so many
scatters of readings about the median of those on either side."""
CALM = 0.3
"""Of a leap: the readings beside it leap by less. Feet and sills shake several in a row."""
MAX_LEAP_SHARE = 5e-3
"""Twenty healthy recordings of five simulators have none, of a dog that trots neither; readings
that are 0 one time in ten while the robot often stands are 2 %."""
GRAVITY_M_S2 = (8.0, 12.0)
"""Of the median: else gravity itself is what is wrong."""
CHANGING_SHARE = 0.5
"""Of the samples in which an axis changes, if it has noise as real ones do."""
TURNED_RAD, TURNED_SECONDS = 0.1, 3
"""Turning by so much in so many seconds, an axis or an orientation must show it."""
MIN_SAMPLES = 20
TURN_LIMIT = 0.2
"""Of what the gyroscope turns: scales of cheap ones are off by a tenth of it."""


VALUES = Question(
    "imu.values",
    "every reading is a number",
    (FaultKind("imu_invalid", "the inertial unit's readings are not finite"),),
    limit=0.0,
    unit="%",
    consequence="one NaN stays in a filter for ever",
    repairs=("drop_broken_readings",),
)
IMU_SPIKES = FaultKind("imu_spikes", "accelerations or turn rates that no robot feels")
SPIKES = Question(
    "imu.spikes",
    "no acceleration is larger than a robot feels",
    (IMU_SPIKES,),
    limit=100.0 * MAX_SPIKE_SHARE,
    unit="%",
    consequence="a filter takes the spikes for motion",
    excitation_wanted="accelerations with gravity in them",
)
LEAPS = Question(
    "imu.leaps",
    "no turn rate leaps away from those beside it",
    (IMU_SPIKES,),
    limit=100.0 * MAX_LEAP_SHARE,
    unit="%",
    consequence="the heading by the gyroscope turns too little or too far",
    excitation_wanted="turning",
)
AXES = Question(
    "imu.axes",
    "every axis that should change does",
    (
        FaultKind(
            "imu_axis_dead",
            "an axis of the inertial unit never changes",
            (
                same_subject(
                    *("time_offset_imu", "gyro_scale", "gyro_bias", "clock_drift", "imu_axis")
                ),
            ),
        ),
    ),
    consequence="turns or accelerations about the axis are missed",
    excitation_wanted="turning",
)
ORIENTATION = Question(
    "imu.orientation",
    "a published orientation is one, and turns with the unit",
    (
        FaultKind(
            "imu_orientation",
            "the inertial unit's orientation is none, though it is published",
        ),
    ),
    consequence="filters take the numbers for a heading",
    excitation_wanted="turning",
    repairs=("drop_orientation",),
)


def check_readings(recording: Recording, imu: RawImu) -> Iterator[Finding]:
    """What needs nothing but the readings of one inertial unit themselves."""
    rates, accelerations = imu.angular_velocity_rad_s, imu.linear_acceleration_m_s2
    finite = np.asarray(is_sound(rates) & is_sound(accelerations))
    yield _finite(imu, finite)
    if int(finite.sum()) < MIN_SAMPLES:
        return
    yield _spikes(imu, accelerations[finite], imu.stamps_ns[finite])
    yield _leaps(imu, finite)
    yield _axes(imu, finite, _base_turns(recording))
    if imu.orientation_xyzw is not None:
        yield _orientation(imu, imu.orientation_xyzw)


def _finite(imu: RawImu, finite: BoolArray) -> Finding:
    broken = int((~finite).sum())
    columns = (*imu.angular_velocity_rad_s.T, *imu.linear_acceleration_m_s2.T)
    names = [f"{kind} {axis}" for kind in ("gyroscope", "acceleration") for axis in "xyz"]
    whole = [name for name, column in zip(names, columns, strict=True)
             if not is_sound(column).any()]  # fmt: skip
    words = f"{broken} of {len(imu)} readings are not finite (or beyond {MOST:g})"
    words += f", of {', '.join(whole)} all" if whole else ""
    return judge(
        VALUES,
        imu.topic,
        {"ok": "every reading is a number", "fault": words},
        Measurement(100.0 * broken / max(len(imu), 1), 0.0, "%"),
        advice="Publish nothing until the unit answers, and -1 as first covariance for what it "
        "does not measure: one NaN stays in a filter for ever.",
        repairs=() if whole else (Repair("drop_broken_readings", imu.topic),),
    )


def _spikes(imu: RawImu, accelerations: FloatArray, stamps_ns: IntArray) -> Finding:
    length = np.linalg.norm(accelerations, axis=1)
    usual = float(np.median(length))
    if not GRAVITY_M_S2[0] < usual < GRAVITY_M_S2[1]:
        return unanswered(SPIKES, imu.topic, "without gravity single readings cannot be judged")
    low, high = SPIKE_M_S2
    spikes = (length > high) | _no_fall(length, float(np.median(np.diff(stamps_ns))) * 1e-9)
    words = f"{int(spikes.sum())} accelerations lie outside {low:g} to {high:g} m/s^2"
    farthest = length[np.argmax(np.abs(length - usual) * spikes)]
    return judge(
        SPIKES,
        imu.topic,
        {"ok": words, "fault": f"{words}, the farthest is {farthest:.3g}"},
        Measurement(100.0 * float(spikes.mean()), 0.0, "%"),
        limit=100.0 * max(MAX_SPIKE_SHARE, (MIN_SPIKES - 0.5) / len(length)),
        advice="Look for a bad bus or a unit that sits loose; a robot that takes such knocks falls "
        "over.",
    )


def _leaps(imu: RawImu, finite: BoolArray) -> Finding:
    """Single readings about the upward axis, in the order of the file and of their stamps: what
    leaps in one alone is in the wrong order."""
    rates, stamps_ns = imu.angular_velocity_rad_s[finite, _upward(imu)], imu.stamps_ns[finite]
    by_stamp = np.argsort(stamps_ns, kind="stable")
    period_s = float(np.median(np.diff(stamps_ns[by_stamp]))) * 1e-9
    share = min(float(_leaping(one, period_s).mean()) for one in (rates, rates[by_stamp]))
    return judge(
        LEAPS,
        imu.topic,
        f"{100.0 * share:.2g} % of the turn rates leap away from those beside them",
        Measurement(100.0 * share, 0.0, "%"),
        advice="Look for a bus that drops readings, or a driver that publishes before it has one.",
    )


def _leaping(rates: FloatArray, period_s: float) -> BoolArray:
    """(n - 2 BESIDE,) which readings leap, though those on either side do not."""
    around = np.lib.stride_tricks.sliding_window_view(rates, 2 * BESIDE + 1)
    off = np.abs(around - np.median(around, axis=1)[:, None])
    leap, beside = off[:, BESIDE], np.maximum(off[:, BESIDE - 1], off[:, BESIDE + 1])
    scatter = SIGMAS_PER_MEDIAN * float(np.median(leap))
    least = max(LEAP_RAD_S, LEAP_RAD_S2 * period_s, LEAP_SIGMAS * scatter)
    return np.asarray((leap > least) & (beside < CALM * leap))


def _no_fall(length: FloatArray, period_s: float) -> BoolArray:
    """(n,) which accelerations are too small, and not because the robot falls: a reading alone
    between two of gravity, longer than it falls, or exactly 0, as no unit with noise measures."""
    small = length < SPIKE_M_S2[0]
    calm = np.pad((length > GRAVITY_M_S2[0]) & (length < GRAVITY_M_S2[1]), 1)
    no_fall = length == 0.0
    for first, last in runs_of(small):
        alone = first == last and calm[first] and calm[last + 2] and period_s <= FALL_S[0]
        if alone or (last + 1 - first) * period_s > FALL_S[1]:
            no_fall[first : last + 1] = True
    return np.asarray(no_fall)


def _axes(imu: RawImu, finite: BoolArray, turns: bool) -> Finding:
    """An axis that never changes while the others do, or while the robot turns about it."""
    dead = []
    for kind, values in (
        ("gyroscope", imu.angular_velocity_rad_s[finite]),
        ("acceleration", imu.linear_acceleration_m_s2[finite]),
    ):
        changing = (np.diff(values, axis=0) != 0.0).mean(axis=0) > CHANGING_SHARE
        constant = np.ptp(values, axis=0) == 0.0
        for axis in np.flatnonzero(constant).tolist():
            upright = kind == "acceleration" and abs(values[0, axis]) > GRAVITY_M_S2[0]
            others = bool(changing[np.arange(3) != axis].all()) and not upright
            if others or (turns and kind == "gyroscope" and axis == _upward(imu)):
                dead.append(f"{kind} {'xyz'[axis]}")
    return judge(
        AXES,
        imu.topic,
        {
            "ok": "every axis that should change does",
            "fault": f"{', '.join(dead)} never changes while the robot moves",
        },
        verdict="fault" if dead else "ok",
        advice="Look for an axis that the driver does not fill in, or a unit that is broken.",
    )


def _upward(imu: RawImu) -> int:
    """The axis of the unit that gravity is felt along, z where it is not."""
    finite = imu.linear_acceleration_m_s2[is_sound(imu.linear_acceleration_m_s2)]
    mean = finite.mean(axis=0) if len(finite) else np.zeros(3)
    felt = float(np.linalg.norm(mean)) > 0.5
    return int(np.argmax(np.abs(mean))) if felt else 2


def _base_turns(recording: Recording) -> bool:
    """Whether any odometry says that the robot turns."""
    return any(
        _turning_seconds(odometry.stamps_ns, yaw_from_xyzw(odometry.quats_xyzw)) >= TURNED_SECONDS
        for odometry in recording.odometries
    )


def _turning_seconds(stamps_ns: IntArray, yaw_rad: FloatArray) -> int:
    """Seconds in which a heading changes much, as far as it is finite."""
    good = np.isfinite(yaw_rad)
    if int(good.sum()) < 2:
        return 0
    second = ((stamps_ns[good] - stamps_ns[good].min()) // 1_000_000_000)[1:]
    _, which = np.unique(second, return_inverse=True)
    turned = np.bincount(which, weights=wrap_angle(np.diff(yaw_rad[good])))
    return int((np.abs(turned) > TURNED_RAD).sum())


def _orientation(imu: RawImu, quats_xyzw: FloatArray) -> Finding:
    unit = has_unit_length(quats_xyzw)
    if not unit.all():
        words = f"{int((~unit).sum())} of {len(imu)} orientations are no rotations"
        return _no_orientation(imu, f"{words}: their quaternions are not of unit length")
    rate = imu.angular_velocity_rad_s[:, _upward(imu)]
    heading = np.concatenate([[0.0], np.cumsum(np.nan_to_num(rate[1:]) * np.diff(imu.stamps_ns))])
    seconds = _turning_seconds(imu.stamps_ns, wrap_angle(1e-9 * heading))
    changes = float(np.ptp(quats_xyzw, axis=0).max())
    if seconds < TURNED_SECONDS:
        words = "the unit hardly turns, so its orientation cannot be judged"
        return unanswered(ORIENTATION, imu.topic, words)
    if changes == 0.0:
        return _no_orientation(imu, f"the orientation never changes, in {seconds} s of turning")
    turns = _turns_of_gyroscope(imu, quats_xyzw)
    if turns is not None and abs(turns.value - 1.0) - SURE_SIGMAS * turns.sigma > TURN_LIMIT:
        words = f"the orientation turns by {turns.value:.2g} of what its own gyroscope turns"
        return _no_orientation(imu, words)
    words = "the orientation is a rotation and changes as the unit turns"
    return judge(ORIENTATION, imu.topic, words, verdict="ok")


def _turns_of_gyroscope(imu: RawImu, quats_xyzw: FloatArray) -> Measurement | None:
    """What the orientation turns, of what the gyroscope does, second by second; None without
    enough turns.

    Both about the unit's own upward axis: in which frame the orientation is does not matter.
    """
    seconds = np.diff(imu.stamps_ns) * 1e-9
    near = (seconds >= 0.0) & (seconds < 1.0)
    at = Rotation.from_quat(quats_xyzw)
    axis = _upward(imu)
    by_orientation = (at[:-1].inv() * at[1:]).as_rotvec()[near, axis]
    rate = np.nan_to_num(imu.angular_velocity_rad_s[:, axis])
    by_gyroscope = (0.5 * (rate[1:] + rate[:-1]) * seconds)[near]
    second = (imu.stamps_ns[1:][near] - imu.stamps_ns[0]) // 1_000_000_000
    _, which = np.unique(second, return_inverse=True)
    turned, felt = (np.bincount(which, weights=one) for one in (by_orientation, by_gyroscope))
    large = np.abs(felt) > TURNED_RAD
    if int(large.sum()) < TURNED_SECONDS:
        return None
    turned, felt = turned[large], felt[large]
    gain = float(turned @ felt / (felt @ felt))
    scatter = float(np.mean(np.square(turned - gain * felt)))
    return Measurement(gain, float(np.sqrt(scatter / (felt @ felt))), "of the gyroscope's turns")


def _no_orientation(imu: RawImu, words: str) -> Finding:
    return judge(
        ORIENTATION,
        imu.topic,
        words,
        verdict="fault",
        advice="Set the first orientation covariance to -1 where the unit estimates none (REP "
        "145); filters take the numbers for a heading.",
        repairs=(Repair("drop_orientation", imu.topic),),
    )
