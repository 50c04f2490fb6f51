"""The published odometry by itself and against the wheels: jumps, standstill, contradiction; and
where the wheels slip."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.check.calibration import Calibration
from slamsim.check.counting import (
    MOVED_M,
    MOVED_RAD,
    check_counter,
    check_counting,
    counters_stand,
)
from slamsim.check.course import Course, odometry_course, wheel_course
from slamsim.check.distance_unit import ratio_of_units
from slamsim.check.findings import Curve, Estimate, Finding, Mend, Plot
from slamsim.core.geometry import between, yaw_from_xyzw
from slamsim.core.types import BoolArray, FloatArray
from slamsim.guard.numbers import is_sound
from slamsim.recording import RawOdometry, Recording

JUMP_M, JUMP_RAD = 0.04, 0.1
USUAL_STEPS = 3.0
"""A jump is longer than this and than so many times what the robot ever moves from one message to
the next, there and beside it."""

COMPARED_S = 1.0
LONGEST_S = 1e7
SCALE_LIMIT = 0.02
ODD_SHARE_LIMIT = 0.05
POSES_SHARE = 0.05
"""Of poses instead of counters so much of the whole must slip: scans err as much in corridors."""

SLIP_LIMIT_M, SLIP_LIMIT_RAD = 0.1, 0.15
"""Of all slips together: less is lost on any floor."""


def check_odometry(recording: Recording) -> list[Finding]:
    """What needs no other sensor than the wheels."""
    findings = [f for ticks in recording.ticks if len(ticks) > 2 for f in check_counter(ticks)]
    wheels = next(filter(None, (wheel_course(ticks) for ticks in recording.ticks)), None)
    for odometry in recording.odometries:
        jumps = _jumps(odometry)
        findings.append(_jump(odometry, jumps))
        course = odometry_course(odometry)
        if course is not None and wheels is not None:
            findings += _against_wheels(course, wheels)
    return findings


def check_slip(calibration: Calibration) -> list[Finding]:
    """Wheels against scans, second by second."""
    spells, wheels = calibration.spells, calibration.model.wheels
    if spells is None or wheels is None:
        return []
    if not calibration.comparable:
        words = "turns of wheels and scans do not follow each other"
        return [Finding("wheels.slip", wheels.topic, "cannot tell", words)]
    frozen = float(np.abs(spells.scans - spells.wheels)[spells.frozen, 0].sum())
    slips = spells.slipping & ~(spells.beside_frozen & spells.frozen.any())
    excess = np.abs(spells.wheels - spells.scans)[slips].sum(axis=0)
    plot = Plot(
        "wheels against scans, second by second",
        "since the middle of the drive, s",
        "path, m",
        (
            Curve("wheels", spells.start_s, spells.wheels[:, 0]),
            Curve("scans", spells.start_s, spells.scans[:, 0]),
        ),
    )
    findings = []
    if spells.frozen.any():
        count = int(spells.frozen.sum())
        words = f"the wheels stand still for {count} s while the scans move, by {frozen:.2f} m"
        advice = "Look for a driver that stalls; leave these spells to the scans."
        findings.append(
            Finding(
                *("wheels.frozen", wheels.topic, "bad", words, "odometry_frozen", advice),
                *(Estimate(float(count), 0.0, "s"), 0.0),
                plots=(plot,),
            )
        )
    limits = np.array([SLIP_LIMIT_M, SLIP_LIMIT_RAD])
    if not wheels.wired:
        limits = np.maximum(limits, POSES_SHARE * np.abs(spells.wheels).sum(axis=0))
    bad = bool((excess > limits).any())
    words = (
        f"in {int(slips.sum())} of {len(slips)} s wheels and scans differ, together by "
        f"{excess[0]:.2f} m and {np.degrees(excess[1]):.1f} deg"
    )
    advice = "Do not trust the wheels there: let scans or gyroscope tell the motion."
    findings.append(
        Finding(
            *("wheels.slip", wheels.topic, "bad" if bad else "ok", words),
            *("wheel_slip" if bad else None, advice if bad else ""),
            *(Estimate(float(excess[0]), 0.0, "m"), float(limits[0])),
            plots=(plot,),
        )
    )
    return findings


def _jumps(odometry: RawOdometry) -> FloatArray:
    """(k, 3) stamp, s since the first, length, m, and turn, rad, of steps that no robot makes."""
    poses = np.column_stack([odometry.positions_m[:, :2], yaw_from_xyzw(odometry.quats_xyzw)])
    finite = is_sound(poses)
    poses, stamps = poses[finite], odometry.stamps_ns[finite]
    if len(poses) < 4:
        return np.zeros((0, 3))
    moved = between(poses[:-1], poses[1:])
    steps = np.column_stack([np.hypot(moved[:, 0], moved[:, 1]), np.abs(moved[:, 2])])
    seconds = np.diff(stamps) * 1e-9
    periods = np.maximum(seconds / max(float(np.median(seconds)), 1e-9), 1.0)[:, None]
    usual = np.quantile(steps / periods, 0.99, axis=0)
    around = np.maximum(np.roll(steps / periods, 1, axis=0), np.roll(steps / periods, -1, axis=0))
    around[[0, -1]] = (steps / periods)[[1, -2]]
    longest = np.maximum(np.array([JUMP_M, JUMP_RAD]), USUAL_STEPS * np.maximum(usual, around))
    jumped = (steps > longest * periods).any(axis=1)
    since_s = (stamps[1:] - stamps[0]) * 1e-9
    return np.column_stack([since_s[jumped], steps[jumped]])


def _jump(odometry: RawOdometry, jumps: FloatArray) -> Finding:
    if not len(jumps):
        return Finding("odometry.jump", odometry.topic, "ok", "no step that no robot makes")
    at = int(np.argmax(jumps[:, 1] + jumps[:, 2]))
    stamp, length, turn = jumps[at]
    words = (
        f"steps that no robot makes: {len(jumps)}, the largest {length:.2f} m and "
        f"{np.degrees(turn):.0f} deg, {stamp:.1f} s after the first message"
    )
    return Finding(
        *("odometry.jump", odometry.topic, "bad", words, "odometry_jump"),
        "Odometry must be continuous: corrections belong into map -> odom.",
        *(Estimate(float(length), 0.0, "m"), JUMP_M),
        (Mend("remove_odometry_jumps", odometry.topic, {"longest_m": 0.5 * float(length)}),),
    )


def _against_wheels(odometry: Course, wheels: Course) -> Iterator[Finding]:
    """Path and turn of each second by the driver and by the counters that it is made from."""
    begin = max(odometry.origin_ns, wheels.origin_ns)
    end = min(int(odometry.stamps_ns[-1]), int(wheels.stamps_ns[-1]))
    if not 3e9 * COMPARED_S <= end - begin <= 1e9 * LONGEST_S:
        words = "odometry and counters hardly overlap, or their stamps span years"
        yield Finding("odometry.wheels", odometry.topic, "cannot tell", words)
        return
    edges_s = np.arange(0.0, (end - begin) * 1e-9, COMPARED_S)
    published, counted = (
        np.diff(course.at(edges_s + (begin - course.origin_ns) * 1e-9), axis=0)
        for course in (odometry, wheels)
    )
    frozen = counters_stand(published, counted)
    yield check_counting(wheels, published, frozen)
    published, counted = published[~frozen], counted[~frozen]
    moved = np.abs(counted) > np.array([MOVED_M, MOVED_RAD])
    if not moved.any():
        words = "the wheels hardly turn: nothing to compare"
        yield Finding("odometry.wheels", odometry.topic, "cannot tell", words)
        return
    still = moved.any(axis=1) & (np.abs(published) < 1e-6).all(axis=1)
    if still.mean() > 0.0:
        yield _still(odometry, int(still.sum()))
    if not still.all():
        yield _scale(odometry, published[~still], counted[~still], moved[~still])


def _still(odometry: Course, seconds: int) -> Finding:
    return Finding(
        *("odometry.frozen", odometry.topic, "bad"),
        f"it stands still for {seconds} s while the wheels turn",
        *("odometry_frozen", "Look for a driver that stalls."),
        *(Estimate(float(seconds), 0.0, "s"), 0.0),
    )


def _scale(
    odometry: Course, published: FloatArray, counted: FloatArray, moved: BoolArray
) -> Finding:
    ratios = [
        float(np.median(published[moved[:, k], k] / counted[moved[:, k], k]))
        if moved[:, k].any()
        else 1.0
        for k in (0, 1)
    ]
    if ratios[0] > 0.0 and (unit := ratio_of_units(ratios[0])) is not None:
        return _other_unit(odometry, ratios[0], 1.0 / unit)
    expected = counted * np.array(ratios)
    apart = np.abs(published - expected)
    odd = ((apart > 0.1 * np.abs(counted)) & (apart > np.array([MOVED_M, MOVED_RAD]))).any(axis=1)
    words = (
        f"it shows {ratios[0]:.4g} of the path and {ratios[1]:.4g} of the turn that its wheels "
        f"count, and something else in {int(odd.sum())} of {len(odd)} s"
    )
    off = max((ratio - 1.0 for ratio in ratios), key=abs)
    bad = abs(off) > SCALE_LIMIT or float(odd.mean()) > ODD_SHARE_LIMIT
    sigma = 100.0 * float(np.median(apart[moved])) / np.sqrt(max(int(moved.sum()), 1))
    mend = Mend("odometry_from_ticks", odometry.topic)
    advice = "Compute the odometry from the counters, with the radius and track that are declared."
    return Finding(
        *("odometry.wheels", odometry.topic, "bad" if bad else "ok", words),
        *("odometry_contradicts_wheels" if bad else None, advice if bad else ""),
        *(Estimate(100.0 * off, sigma, "%"), 100.0 * SCALE_LIMIT),
        (mend,) if bad else (),
    )


def _other_unit(odometry: Course, ratio: float, metres: float) -> Finding:
    return Finding(
        *("odometry.wheels", odometry.topic, "bad"),
        f"it shows {ratio:.4g} of the path that its wheels count: one of it is {metres:.4g} m",
        *("wheel_unit", f"Multiply its lengths by {metres:.4g}."),
        *(Estimate(ratio, 0.0, "m/m"), None),
        (Mend("odometry_from_ticks", odometry.topic),),
    )
