"""Mends of wheel counters and of the odometry that is made from them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from slamsim.check.findings import Mend
from slamsim.check.mend_subjects import number, with_topic
from slamsim.core.geometry import between, compose, xyzw_from_yaw, yaw_from_xyzw
from slamsim.core.types import EncoderStream, FloatArray
from slamsim.core.wheels import wheel_odometry
from slamsim.guard.errors import SlamsimError
from slamsim.recording import RawOdometry, RawTicks, Recording
from slamsim.recording.edits import with_odometry_edge

_SAME_PATH = 0.1


def scale_wheels(recording: Recording, mend: Mend) -> Recording:
    """Multiply the declared radius by radius_factor, the track by track_factor."""
    radius, track = number(mend, "radius_factor"), number(mend, "track_factor")
    return _with_ticks(
        recording,
        mend,
        lambda t: replace(t, wheel_radius_m=t.wheel_radius_m * radius, track_m=t.track_m * track),
    )


def scale_lengths(recording: Recording, mend: Mend) -> Recording:
    """Of counters as ``scale_wheels``; of an odometry the path by radius_factor."""
    if any(ticks.topic == mend.subject for ticks in recording.ticks):
        return scale_wheels(recording, mend)
    factors: dict[str, float | str] = {
        "path_factor": number(mend, "radius_factor"),
        "turn_factor": 1.0,
    }
    return scale_odometry(recording, replace(mend, parameters=factors))


def swap_wheels(recording: Recording, mend: Mend) -> Recording:
    """Exchange left and right."""
    return _with_ticks(recording, mend, lambda t: replace(t, ticks=t.ticks[:, ::-1].copy()))


def reverse_wheel(recording: Recording, mend: Mend) -> Recording:
    """Count one wheel, left or right, the other way."""
    signs = np.array([-1, 1]) if mend.parameters["wheel"] == "left" else np.array([1, -1])
    return _with_ticks(recording, mend, lambda t: replace(t, ticks=t.ticks * signs))


def unwrap_ticks(recording: Recording, mend: Mend) -> Recording:
    """Go on counting where a counter of so many values (modulus) begins anew."""
    modulus = round(number(mend, "modulus"))

    def unwrapped(ticks: RawTicks) -> RawTicks:
        steps = np.diff(ticks.ticks, axis=0)
        steps -= np.rint(steps / modulus).astype(np.int64) * modulus
        counts = np.concatenate([ticks.ticks[:1], ticks.ticks[:1] + np.cumsum(steps, axis=0)])
        return replace(ticks, ticks=counts)

    return _with_ticks(recording, mend, unwrapped)


def odometry_from_ticks(recording: Recording, mend: Mend) -> Recording:
    """Compute an odometry's poses anew from the counters."""
    if not recording.ticks:
        raise SlamsimError("there are no wheel counters to compute an odometry from")
    return _with_odometry(recording, mend.subject, lambda o: _counted(o, recording.ticks[0]))


def scale_odometry(recording: Recording, mend: Mend) -> Recording:
    """Multiply the path by path_factor and the turn by turn_factor."""
    path, turn = number(mend, "path_factor"), number(mend, "turn_factor")

    def scaled(odometry: RawOdometry) -> RawOdometry:
        steps = _steps(odometry) * np.array([path, path, turn])
        found = _along(odometry, steps)
        return replace(
            found,
            linear_m_s=odometry.linear_m_s * path,
            angular_rad_s=odometry.angular_rad_s * turn,
        )

    return _with_odometry(recording, mend.subject, scaled)


def remove_odometry_jumps(recording: Recording, mend: Mend) -> Recording:
    """Let the robot move on as before where a step is longer than longest_m."""
    longest_m = number(mend, "longest_m")

    def smooth(odometry: RawOdometry) -> RawOdometry:
        steps = _steps(odometry)
        jumps = np.hypot(steps[:, 0], steps[:, 1]) > longest_m
        steps[jumps & (np.arange(jumps.size) == 0)] = 0.0
        before = np.maximum.accumulate(np.where(jumps, 0, np.arange(jumps.size)))
        return _along(odometry, steps[before])

    return _with_odometry(recording, mend.subject, smooth)


def _with_ticks(
    recording: Recording, mend: Mend, change: Callable[[RawTicks], RawTicks]
) -> Recording:
    """The counters changed, and with them every odometry that says what they say."""
    before = {ticks.topic: ticks for ticks in recording.ticks}.get(mend.subject)
    found = with_topic(recording, RawTicks, mend, change)
    after = {ticks.topic: ticks for ticks in found.ticks}[mend.subject]
    for odometry in recording.odometries:
        if before is not None and _follows(odometry, before):
            found = _with_odometry(found, odometry.topic, lambda o: _counted(o, after))
    return found


def _with_odometry(
    recording: Recording, topic: str, change: Callable[[RawOdometry], RawOdometry]
) -> Recording:
    """An odometry changed, and the transform that says the same."""
    for odometry in recording.odometries:
        if odometry.topic == topic:
            changed = change(odometry)
            streams = (changed if each is odometry else each for each in recording.streams)
            found = replace(recording, streams=tuple(streams))
            names = odometry.frame_ids[:1] + odometry.child_frame_ids[:1]
            published = any((e.parent, e.child) == names for e in recording.transforms)
            return with_odometry_edge(found, changed) if published else found
    raise SlamsimError(f"there is no odometry on {topic!r}")


def _planar(odometry: RawOdometry) -> FloatArray:
    return np.column_stack([odometry.positions_m[:, :2], yaw_from_xyzw(odometry.quats_xyzw)])


def _steps(odometry: RawOdometry) -> FloatArray:
    poses = _planar(odometry)
    return between(poses[:-1], poses[1:]) if len(poses) > 1 else np.zeros((0, 3))


def _along(odometry: RawOdometry, steps: FloatArray) -> RawOdometry:
    """The odometry that begins as before and takes these steps."""
    yaw = _planar(odometry)[0, 2] + np.concatenate([[0.0], np.cumsum(steps[:, 2])])
    cos, sin = np.cos(yaw[:-1]), np.sin(yaw[:-1])
    moved = np.column_stack(
        [cos * steps[:, 0] - sin * steps[:, 1], sin * steps[:, 0] + cos * steps[:, 1]]
    )
    positions = odometry.positions_m.copy()
    positions[1:, :2] = positions[0, :2] + np.cumsum(moved, axis=0)
    return replace(odometry, positions_m=positions, quats_xyzw=xyzw_from_yaw(yaw))


def _counted(odometry: RawOdometry, ticks: RawTicks) -> RawOdometry:
    """The counters' poses at the odometry's stamps, from its first pose on."""
    poses = _at(ticks, odometry)
    start = _planar(odometry)[0]
    placed = compose(start, between(poses[0], poses))
    positions = odometry.positions_m.copy()
    positions[:, :2] = placed[:, :2]
    seconds = np.maximum(np.diff(odometry.stamps_ns) * 1e-9, 1e-9)
    steps = between(placed[:-1], placed[1:]) / seconds[:, None]
    speeds = np.concatenate([np.zeros((1, 3)), steps])
    zero = np.zeros(len(speeds))
    return replace(
        odometry,
        positions_m=positions,
        quats_xyzw=xyzw_from_yaw(placed[:, 2]),
        linear_m_s=np.column_stack([speeds[:, 0], speeds[:, 1], zero]),
        angular_rad_s=np.column_stack([zero, zero, speeds[:, 2]]),
    )


def _at(ticks: RawTicks, odometry: RawOdometry) -> FloatArray:
    """(m, 3) the counters' poses at the odometry's stamps, held at the ends."""
    order = np.unique(ticks.stamps_ns, return_index=True)[1]
    stream = EncoderStream(
        ticks.stamps_ns[order],
        ticks.ticks[order],
        ticks.ticks_per_revolution,
        ticks.wheel_radius_m,
        ticks.track_m,
    )
    path = wheel_odometry(stream)
    query_ns = np.clip(odometry.stamps_ns, path.stamps_ns[0], path.stamps_ns[-1])
    return path.at(query_ns)


def _follows(odometry: RawOdometry, ticks: RawTicks) -> bool:
    """Whether an odometry goes as far and turns as much as these counters say."""
    counted, said = _at(ticks, odometry), _planar(odometry)
    if len(said) < 2:
        return False
    amounts = [
        np.array([np.abs(steps[:, 0]).sum(), np.abs(steps[:, 2]).sum()])
        for steps in (between(poses[:-1], poses[1:]) for poses in (counted, said))
    ]
    return bool((np.abs(amounts[0] - amounts[1]) <= _SAME_PATH * amounts[0] + 1e-6).all())
