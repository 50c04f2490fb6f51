"""Quaternions written as (w, x, y, z) where (x, y, z, w) is read: a robot that turns seems to roll.

Read so, a turn of yaw is a half turn about x less that yaw: upside down as long as it hardly turns.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.check.evidence import RecordingEvidence
from slamsim.check.fault_groups import BY_SCANS, WHEELS
from slamsim.check.findings import Curve, Finding, Measurement, Plot
from slamsim.check.question import (
    FaultKind,
    Question,
    QuestionGroup,
    anywhere,
    judge,
    same_subject,
)
from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.numbers import is_sound
from slamsim.recording import RawImu
from slamsim.recording.cleaning.streams import has_unit_length
from slamsim.recording.edits.base import edge_subject
from slamsim.recording.repairs.base import Repair

MOST_TILT_RAD = float(np.radians(20.0))
"""Steeper than any ramp that a wheeled robot climbs."""
TURNED_RAD = float(np.radians(3.0))
"""What lies on its head tilts to and fro by less while it drives on a floor."""
SHARE = 0.95
FELT_UP = 0.9
"""Cosine of gravity's direction in a world that the orientation puts upright."""
MIN_MESSAGES = 20

ORDER = Question(
    "frames.quaternion",
    "quaternions are written as x, y, z, w",
    (
        FaultKind(
            "quaternion_order",
            "quaternions are written as w, x, y, z",
            (
                same_subject("imu_orientation", "odometry_twist"),
                anywhere(
                    *WHEELS,
                    *BY_SCANS,
                    *("odometries_contradict", "tf_contradicts_odometry", "imu_axis"),
                    *("odometry_no_turn", "odometry_jump", "wheel_unit", "range_unit"),
                    *("time_offset_imu", "odometry_unsigned", "gyro_bias", "gyro_sign"),
                ),
            ),
        ),
    ),
    limit=float(np.degrees(MOST_TILT_RAD)),
    unit="deg",
    consequence="the robot never turns, and everything is mapped onto one heading",
    repairs=("reorder_quaternions",),
    limit_of_ok=False,
)


def check_quaternions(evidence: RecordingEvidence) -> Iterator[Finding]:
    """Of every odometry, moving transform and inertial unit that estimates an orientation."""
    recording = evidence.recording
    for odometry in recording.odometries:
        yield from _order(odometry.topic, odometry.stamps_ns, odometry.quats_xyzw)
    for edge in recording.transforms:
        if not edge.is_static:
            yield from _order(edge_subject(edge), edge.stamps_ns, edge.quats_xyzw)
    for imu in recording.imus:
        if imu.orientation_xyzw is not None and not _stands_upright(imu):
            yield from _order(imu.topic, imu.stamps_ns, imu.orientation_xyzw)


GROUP = QuestionGroup("quaternions", 25, (ORDER,), check_quaternions)


def _order(subject: str, stamps_ns: IntArray, quats: FloatArray) -> Iterator[Finding]:
    sound = is_sound(quats) & has_unit_length(quats)
    if int(sound.sum()) < MIN_MESSAGES:
        return
    read, meant = quats[sound], np.roll(quats[sound], -1, axis=1)
    tilts_deg = np.degrees([_tilts(each) for each in (read, meant)])
    steep, steep_meant = np.quantile(tilts_deg, SHARE, axis=1)
    wanders = float(np.ptp(np.quantile(tilts_deg[0], [1.0 - SHARE, SHARE])))
    limit = float(np.degrees(MOST_TILT_RAD))
    wrong = steep > limit > steep_meant and wanders > np.degrees(TURNED_RAD)
    since_s = (stamps_ns[sound] - stamps_ns[0]) * 1e-9
    curves = tuple(
        Curve(name, since_s, tilt, "line")
        for name, tilt in zip(("as x, y, z, w", "as w, x, y, z"), tilts_deg, strict=True)
    )
    yield judge(
        ORDER,
        subject,
        {
            "ok": "quaternions are written as x, y, z, w, or do not tell",
            "fault": f"read as x, y, z, w the robot tilts by up to {steep:.0f} deg as it drives, "
            f"read as w, x, y, z it turns upright, within {steep_meant:.1f} deg",
        },
        Measurement(float(steep), 0.0, "deg"),
        verdict="fault" if wrong else "ok",
        advice="Fill in x, y, z and w by name; libraries differ in which comes first.",
        repairs=(Repair("reorder_quaternions", subject),),
        fault_plots=(Plot(f"Tilt by {subject}", "stamp (s)", "tilt (deg)", curves, (limit,)),),
    )


def _tilts(quats_xyzw: FloatArray) -> FloatArray:
    """(n,) angle between the vertical and where the rotation puts it, rad."""
    upright = 1.0 - 2.0 * np.square(quats_xyzw[:, :2]).sum(axis=1)
    return np.asarray(np.arccos(np.clip(upright, -1.0, 1.0)))


def _stands_upright(imu: RawImu) -> bool:
    """Whether gravity, turned by the orientation as it is read, points up or down."""
    assert imu.orientation_xyzw is not None
    felt, quats = imu.linear_acceleration_m_s2, imu.orientation_xyzw
    x, y, z, w = quats.T
    up = np.column_stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])
    with np.errstate(invalid="ignore", divide="ignore"):
        cosine = (felt * up).sum(axis=1) / np.linalg.norm(felt, axis=1)
    return bool(abs(np.nanmedian(cosine)) > FELT_UP) if np.isfinite(cosine).any() else False
