"""Does the heading of the odometry turn as its own path does?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slamsim.check.evidence import RecordingEvidence
from slamsim.check.fault_groups import SIZES, WHEELS
from slamsim.check.findings import Curve, Finding, Measurement, Plot
from slamsim.check.question import FaultKind, Question, QuestionGroup, anywhere, judge, unanswered
from slamsim.check.questions.wheels.counters import MOVED_M, MOVED_RAD
from slamsim.core.geometry import wrap_angle
from slamsim.core.types import FloatArray
from slamsim.guard.numbers import is_sound
from slamsim.recording import RawOdometry
from slamsim.recording.edits.motion import continuous_heading
from slamsim.recording.repairs.base import Repair

LOOK_S, MIN_LOOKS, LONGEST_S = 1.0, 5, 1e5
MOST_TURN_RAD = 1.5
"""From one second to the next: a path that turns round by more goes backward from there."""
FACTORS = {
    180.0 / np.pi: "it is in degrees",
    np.pi / 180.0: "it was taken for degrees and converted",
    -1.0: "it counts clockwise",
}
"""Of the path's turns. No other is a mistake of a driver that leaves the path as it is."""
NEAR, NEAR_CLOCKWISE, SPREAD = 0.5, 0.25, 2.0
"""Of a factor: how near the median is to it; three quarters of all seconds are nearer than twice
that. In 25 healthy drives, seven of them real, headings turned by 0.38 to 1.25 of the path: lasers
and bases beside the axle, and robots that turn between two straight pieces. Nothing but a unit
makes fifty times as much of it; a robot that drives sideways may turn against its path."""

HEADING = Question(
    "odometry.heading",
    "the odometry's heading turns as its path does",
    (
        FaultKind(
            "odometry_heading",
            "the odometry's heading is in another unit or sense than its path",
            (
                anywhere(
                    *(*SIZES, *WHEELS),
                    *("odometry_twist", "odometry_jump", "odometry_unsigned", "does_not_fit"),
                    *("tf_contradicts_odometry", "odometries_contradict", "odometry_no_turn"),
                    *("laser_angle_step", "laser_mirrored", "laser_upside_down", "imu_axis"),
                    *("laser_world_fixed", "time_offset_lidar", "time_offset_imu", "clocks_apart"),
                    *("clock_drift", "range_offset", "gyro_bias"),
                ),
            ),
        ),
    ),
    consequence="scans are turned away from the path: there is no map",
    excitation_wanted="curves",
    repairs=("scale_heading",),
)


def check_heading(evidence: RecordingEvidence) -> Iterator[Finding]:
    """Each odometry by itself."""
    for odometry in evidence.recording.odometries:
        yield _heading(odometry)


GROUP = QuestionGroup("odometry", 61, (HEADING,), check_heading)


def _heading(odometry: RawOdometry) -> Finding:
    path, heading = _turns(odometry)
    if path.size < MIN_LOOKS:
        return unanswered(HEADING, odometry.topic, "its path has too few curves")
    ratios = heading / path
    middle = float(np.median(ratios))
    size = Measurement(middle, 0.0, "of the path's turns")
    factor = min(FACTORS, key=lambda one: abs(middle / one - 1.0))
    apart = float(np.quantile(np.abs(ratios / factor - 1.0), 0.75))
    near = NEAR if factor > 0.0 else NEAR_CLOCKWISE
    wrong = abs(middle / factor - 1.0) < near and apart < SPREAD * near
    words = f"its heading turns by {middle:.3g} of what its path does"
    curve = Curve("seconds", path, heading)
    return judge(
        HEADING,
        odometry.topic,
        {"ok": words, "fault": f"{words}: {FACTORS[factor]}"},
        size,
        verdict="fault" if wrong else "ok",
        advice="Make the quaternion of a heading in radians that counts counter-clockwise.",
        repairs=(Repair("scale_heading", odometry.topic, {"factor": 1.0 / factor}),),
        fault_plots=(
            Plot(
                f"Turns of {odometry.topic} from second to second",
                "by its path (rad)",
                "by its heading (rad)",
                (curve,),
            ),
        ),
    )


def _turns(odometry: RawOdometry) -> tuple[FloatArray, FloatArray]:
    """(k,) how far the path turns from one second to the next, where it turns, and the heading."""
    none = np.zeros(0)
    sound = is_sound(odometry.positions_m) & is_sound(odometry.quats_xyzw)
    stamps_ns, first = np.unique(odometry.stamps_ns[sound], return_index=True)
    if stamps_ns.size < 3:
        return none, none
    times_s = (stamps_ns - stamps_ns[0]) * 1e-9
    if not 2.0 * LOOK_S < times_s[-1] < LONGEST_S:
        return none, none
    yaw = continuous_heading(odometry.quats_xyzw[sound][first])
    edges_s = np.arange(0.0, times_s[-1], LOOK_S)
    places = odometry.positions_m[sound][first]
    x_m, y_m = (np.diff(np.interp(edges_s, times_s, places[:, axis])) for axis in (0, 1))
    moves = np.hypot(x_m, y_m) > MOVED_M
    path = wrap_angle(np.diff(np.arctan2(y_m, x_m)))
    heading = np.diff(np.interp(edges_s[:-1] + 0.5 * LOOK_S, times_s, yaw))
    turns = moves[1:] & moves[:-1] & (np.abs(path) > MOVED_RAD) & (np.abs(path) < MOST_TURN_RAD)
    return path[turns], heading[turns]
