"""Published odometry, alone and against the wheels: jumps, standstill, contradiction."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from slamsim.check.calibration.distance_unit import ratio_of_units
from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding, Measurement
from slamsim.check.motion.integrated import IntegratedMotion, integrated_odometry, integrated_wheels
from slamsim.check.question import FaultKind, Question, QuestionGroup, anywhere, judge, unanswered
from slamsim.check.questions.wheels.counters import (
    COUNTER,
    COUNTING,
    MOVED_M,
    MOVED_RAD,
    check_counter,
    check_counting,
    counters_stand,
)
from slamsim.check.questions.wheels.distance_unit import WHEEL_UNIT
from slamsim.core.geometry import between, yaw_from_xyzw
from slamsim.core.types import BoolArray, FloatArray
from slamsim.guard.numbers import is_sound
from slamsim.recording import RawOdometry
from slamsim.recording.repairs.base import Repair

JUMP_M, JUMP_RAD = 0.04, 0.1
USUAL_STEPS = 3.0
"""A jump is longer than this and than so many times what the robot ever moves from one message to
the next, there and beside it; or further to the side."""

NEXT = 1.5
"""Times between messages: from here on one is missing."""

COMPARED_S = 1.0
"""Over so much, counts and rounding of a slow robot are small against its path."""
LONGEST_S = 1e7
"""Four months: stamps that span more are damaged."""
SCALE_LIMIT = 0.02
"""Odometry may be calibrated by up to 2 % against its own counters without being another robot."""
ODD_SHARE_LIMIT = 0.05
"""Of the seconds in which both differ: fewer are messages that were lost."""
ODOMETRY_FROZEN = FaultKind(
    "odometry_frozen",
    "the odometry stands still while the robot moves",
    (
        anywhere(
            *("wheel_slip", "odometry_contradicts_wheels", "tf_contradicts_odometry"),
            "odometries_contradict",
        ),
    ),
)
CONTRADICTS = FaultKind(
    "odometry_contradicts_wheels", "the published odometry is not what the wheels say"
)
JUMP = Question(
    "odometry.jump",
    "no step is longer than a robot makes",
    (
        FaultKind(
            "odometry_jump",
            "the odometry makes a step that no robot makes",
            (anywhere("odometry_contradicts_wheels", "wheel_slip"),),
        ),
    ),
    limit=JUMP_M,
    unit="m",
    consequence="a SLAM starts its search for the scan in the wrong place",
    repairs=("remove_odometry_jumps",),
)
FROZEN = Question(
    "odometry.frozen",
    "the odometry moves whenever the wheels turn",
    (ODOMETRY_FROZEN,),
    limit=0.0,
    unit="s",
    consequence="a SLAM without good scans maps both ends of the gap onto each other",
    excitation_wanted="driving",
)
AGAINST_WHEELS = Question(
    "odometry.wheels",
    "the odometry is what its wheels count",
    (CONTRADICTS, WHEEL_UNIT),
    limit=100.0 * SCALE_LIMIT,
    unit="%",
    consequence="path or turns of the odometry are off by this share",
    excitation_wanted="driving, with odometry and counters recorded",
    repairs=("odometry_from_ticks",),
)


def check_odometry(evidence: RecordingEvidence) -> list[Finding]:
    """What needs no other sensor than the wheels."""
    recording = evidence.recording
    findings = [f for ticks in recording.ticks if len(ticks) > 2 for f in check_counter(ticks)]
    wheels = next(filter(None, (integrated_wheels(ticks) for ticks in recording.ticks)), None)
    for odometry in recording.odometries:
        findings.append(_jump(odometry, *_jumps(odometry)))
        published = integrated_odometry(odometry)
        if published is not None and wheels is not None:
            findings += _against_wheels(published, wheels)
    return findings


GROUP = QuestionGroup(
    "motion",
    110,
    (COUNTER, COUNTING, JUMP, FROZEN, AGAINST_WHEELS),
    check_odometry,
    thorough=True,
)


def _jumps(odometry: RawOdometry) -> tuple[FloatArray, float]:
    """(k, 3) stamp, s since the first, length, m, and turn, rad, of steps that no robot makes; and
    how long a step that it makes is at most."""
    poses = np.column_stack([odometry.positions_m[:, :2], yaw_from_xyzw(odometry.quats_xyzw)])
    finite = is_sound(poses)
    poses, stamps = poses[finite], odometry.stamps_ns[finite]
    if len(poses) < 4:
        return np.zeros((0, 3)), 0.0
    moved = between(poses[:-1], poses[1:])
    seconds = np.diff(stamps) * 1e-9
    periods = np.maximum(seconds / max(float(np.median(seconds)), 1e-9), 1.0)[:, None]
    # Wheels hardly go sideways, but in what a robot turned by while messages were missing.
    aside = np.where(periods[:, 0] < NEXT, np.abs(moved[:, 1]), 0.0)
    steps = np.column_stack([np.hypot(moved[:, 0], moved[:, 1]), np.abs(moved[:, 2]), aside])
    usual = np.quantile(steps / periods, 0.99, axis=0)
    around = np.maximum(np.roll(steps / periods, 1, axis=0), np.roll(steps / periods, -1, axis=0))
    around[[0, -1]] = (steps / periods)[[1, -2]]
    least = np.array([JUMP_M, JUMP_RAD, JUMP_M])
    longest = np.maximum(least, USUAL_STEPS * np.maximum(usual, around))
    jumped = (steps > longest * periods).any(axis=1)
    since_s = (stamps[1:] - stamps[0]) * 1e-9
    return np.column_stack([since_s[jumped], steps[jumped, :2]]), float(usual[0])


def _jump(odometry: RawOdometry, jumps: FloatArray, usual_m: float) -> Finding:
    if not len(jumps):
        return judge(JUMP, odometry.topic, "no step that no robot makes", verdict="ok")
    at = int(np.argmax(jumps[:, 1] + jumps[:, 2]))
    stamp, length, turn = jumps[at]
    return judge(
        JUMP,
        odometry.topic,
        f"steps that no robot makes: {len(jumps)}, the largest {length:.2f} m and "
        f"{np.degrees(turn):.0f} deg, {stamp:.1f} s after the first message",
        Measurement(float(length), 0.0, "m"),
        verdict="fault",
        advice="Odometry must be continuous: corrections belong into map -> odom.",
        repairs=(
            Repair(
                "remove_odometry_jumps",
                odometry.topic,
                {"longest_m": 0.5 * (float(length) + usual_m)},
            ),
        ),
    )


def _against_wheels(odometry: IntegratedMotion, wheels: IntegratedMotion) -> Iterator[Finding]:
    """Path and turn of each second by the driver and by the counters that it is made from."""
    begin = max(odometry.origin_ns, wheels.origin_ns)
    end = min(int(odometry.stamps_ns[-1]), int(wheels.stamps_ns[-1]))
    if not 3e9 * COMPARED_S <= end - begin <= 1e9 * LONGEST_S:
        words = "odometry and counters hardly overlap, or their stamps span years"
        yield unanswered(AGAINST_WHEELS, odometry.topic, words)
        return
    edges_s = np.arange(0.0, (end - begin) * 1e-9, COMPARED_S)
    published, counted = (
        np.diff(motion.at(edges_s + (begin - motion.origin_ns) * 1e-9), axis=0)
        for motion in (odometry, wheels)
    )
    frozen = counters_stand(published, counted)
    yield check_counting(wheels, published, frozen)
    published, counted = published[~frozen], counted[~frozen]
    moved = np.abs(counted) > np.array([MOVED_M, MOVED_RAD])
    if not moved.any():
        words = "the wheels hardly turn: nothing to compare"
        yield unanswered(AGAINST_WHEELS, odometry.topic, words)
        return
    still = moved.any(axis=1) & (np.abs(published) < 1e-6).all(axis=1)
    if still.mean() > 0.0:
        yield _still(odometry, int(still.sum()))
    if not still.all():
        yield _scale(odometry, published[~still], counted[~still], moved[~still])


def _still(odometry: IntegratedMotion, seconds: int) -> Finding:
    return judge(
        FROZEN,
        odometry.topic,
        f"it stands still for {seconds} s while the wheels turn",
        Measurement(float(seconds), 0.0, "s"),
        verdict="fault",
        advice="Look for a driver that stalls.",
    )


def _scale(
    odometry: IntegratedMotion, published: FloatArray, counted: FloatArray, moved: BoolArray
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
    off = max((ratio - 1.0 for ratio in ratios), key=abs)
    sigma = 100.0 * float(np.median(apart[moved])) / np.sqrt(max(int(moved.sum()), 1))
    is_off = abs(off) > SCALE_LIMIT or float(odd.mean()) > ODD_SHARE_LIMIT
    return judge(
        AGAINST_WHEELS,
        odometry.topic,
        f"it shows {ratios[0]:.4g} of the path and {ratios[1]:.4g} of the turn that its wheels "
        f"count, and something else in {int(odd.sum())} of {len(odd)} s",
        Measurement(100.0 * off, sigma, "%"),
        verdict="fault" if is_off else "ok",
        fault=CONTRADICTS,
        advice="Compute the odometry from the counters, with the radius and track that are "
        "declared.",
        repairs=(Repair("odometry_from_ticks", odometry.topic),),
    )


def _other_unit(odometry: IntegratedMotion, ratio: float, metres: float) -> Finding:
    finding = judge(
        AGAINST_WHEELS,
        odometry.topic,
        f"it shows {ratio:.4g} of the path that its wheels count: one of it is {metres:.4g} m",
        Measurement(ratio, 0.0, "m/m"),
        verdict="fault",
        fault=WHEEL_UNIT,
        advice=f"Multiply its lengths by {metres:.4g}.",
        repairs=(Repair("odometry_from_ticks", odometry.topic),),
    )
    return replace(finding, limit=None)  # which is one of percent
