"""An inertial unit that repeats one reading for a while: its driver hangs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Curve, Finding, Measurement, Plot
from slamsim.check.motion.planar_track import planar_track, track_at
from slamsim.check.question import FaultKind, Question, QuestionGroup, judge, same_subject
from slamsim.core.components import runs_of
from slamsim.core.types import BoolArray, FloatArray
from slamsim.guard.numbers import is_sound
from slamsim.recording import RawImu, Recording

MAX_FROZEN_S = 0.5
"""Half a turn at 6 rad/s; units that are read too often repeat a reading for some milliseconds."""
MIN_REPEATS = 10
_NOISY_AXES, _NOISY_SHARE = 5, 0.5
"""A unit of which so many axes change from most samples to the next has noise, at rest as well."""
_AXES = [f"the {kind} {axis}" for kind in ("gyroscope", "acceleration") for axis in "xyz"]
_TURNED_RAD = 0.05
"""By which the odometry's heading leaves the turn at the one rate that the unit repeats."""

IMU_STUCK = FaultKind(
    "imu_stuck",
    "the inertial unit repeats its readings",
    (
        same_subject(
            *("time_offset_imu", "gyro_scale", "gyro_bias", "clock_drift", "imu_axis"),
            *("imu_axis_dead", "imu_orientation"),
        ),
    ),
)
FROZEN = Question(
    "imu.frozen",
    "readings never stand still for a while",
    (IMU_STUCK,),
    limit=MAX_FROZEN_S,
    unit="s",
    consequence="the heading of a filter stops, or turns on, while the unit hangs",
    limit_of_ok=False,
)


def check_frozen(evidence: RecordingEvidence) -> Iterator[Finding]:
    """The longest time for which each inertial unit repeats one reading, or one axis of it."""
    for imu in evidence.recording.imus:
        if len(imu) > MIN_REPEATS:
            yield _longest(imu, evidence.recording)


GROUP = QuestionGroup("inertial unit", 51, (FROZEN,), check_frozen)


def _longest(imu: RawImu, recording: Recording) -> Finding:
    changed = changed_axes(imu)
    times_s = (imu.stamps_ns - imu.stamps_ns[0]) * 1e-9
    runs, what = _held(np.asarray(~changed.any(axis=1)), times_s), "one reading"
    if not has_noise(changed):
        runs = [run for run in runs if _turns_otherwise(imu, recording, *run)]
    else:
        for axis in np.flatnonzero(changed.mean(axis=0) > _NOISY_SHARE):
            alone = _held(np.asarray(~changed[:, axis]), times_s)
            if len(alone) > len(runs):
                runs, what = alone, f"one value of {_AXES[axis]}"
    spells = [(float(times_s[first]), float(times_s[last])) for first, last in runs]
    longest_s = max((end - begin for begin, end in spells), default=0.0)
    begins = ", ".join(f"{begin:.1f}" for begin, _ in spells[:5])
    rates = imu.angular_velocity_rad_s.T
    curves = tuple(
        Curve(axis, times_s, rate, "line") for axis, rate in zip("xyz", rates, strict=True)
    )
    return judge(
        FROZEN,
        imu.topic,
        {
            "ok": "readings never stand still for a while",
            "fault": f"{what} is repeated for up to {longest_s:.2f} s, {len(spells)} times in "
            f"all, from {begins} s after the first message on",
        },
        Measurement(longest_s, 0.0, "s"),
        advice="Look for a driver or a bus that hangs and a node that publishes its last reading.",
        fault_plots=(
            Plot(f"Rates of {imu.topic}", "stamp (s)", "rad/s", curves, spans=tuple(spells)),
        ),
    )


def _held(same: BoolArray, times_s: FloatArray) -> list[tuple[int, int]]:
    """First and last sample of each long run of samples that are the same; same: (n - 1,) as the
    one before."""
    return [
        (first, last + 1)
        for first, last in runs_of(same)
        if last + 1 - first >= MIN_REPEATS and times_s[last + 1] - times_s[first] > MAX_FROZEN_S
    ]


def changed_axes(imu: RawImu) -> BoolArray:
    """(n - 1, 6) which readings of the unit differ from those before."""
    readings = imu.angular_velocity_rad_s, imu.linear_acceleration_m_s2
    return np.column_stack([np.diff(each, axis=0) != 0.0 for each in readings])


def has_noise(changed: BoolArray) -> bool:
    """Whether most axes change from each sample to the next that is not the same; changed: (n, 6)
    as of ``changed_axes``."""
    changed = changed[changed.any(axis=1)]
    if len(changed) < MIN_REPEATS:
        return False
    return bool((changed.sum(axis=1) >= _NOISY_AXES).mean() > _NOISY_SHARE)


def _turns_otherwise(imu: RawImu, recording: Recording, first: int, last: int) -> bool:
    """Whether any odometry turns at other rates while the unit repeats one."""
    for odometry in recording.odometries:
        known_ns, track = planar_track(
            odometry.stamps_ns, odometry.positions_m, odometry.quats_xyzw
        )
        at_ns = imu.stamps_ns[first : last + 1]
        at_ns = at_ns[
            (at_ns >= known_ns.min(initial=at_ns[-1])) & (at_ns <= known_ns.max(initial=0))
        ]
        if known_ns.size < 2 or at_ns.size < MIN_REPEATS or not is_sound(track).all():
            continue
        heading = track_at(known_ns, track, at_ns)[:, 2]
        even = np.polyval(np.polyfit(np.arange(at_ns.size), heading, 1), np.arange(at_ns.size))
        if np.abs(heading - even).max() > _TURNED_RAD:
            return True
    return False
