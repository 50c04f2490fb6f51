"""CARMEN logs (.clf, .log, also .gz and .bz2): the classic 2-D laser recordings.

Stamps are the ``ipc_time`` of a line, which relation files refer to. The log has no time per
beam: a scan counts as one instant (``beam_dt_ns`` 0).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from slamsim.geometry import between, matrix_from_rpy, se3_from_parts, wrap_angle
from slamsim.logs.carmen_content import CarmenContent, collect
from slamsim.logs.carmen_lines import Fan, LaserLine, count_backward
from slamsim.logs.scans import StoredScans
from slamsim.logs.stamps import epoch_of
from slamsim.safe.errors import InputRefused
from slamsim.types import (
    BoolArray,
    Float32Array,
    FloatArray,
    Log,
    PlanarTrajectory,
    Scan,
    ScanGeometry,
)

_MAXIMUM_PARAMETERS = ("robot_front_laser_max", "robot_laser_max", "laser_front_laser_max")
_OFFSET_PARAMETER = "robot_frontlaser_offset"
_SATURATED_SHARE = 1e-3
_LMS_CODES_FROM_M = 81.83
_RIGID_TOLERANCE = 2e-3


def read_carmen(path: Path, scan_topic: str | None = None) -> Log:
    """The log in a CARMEN file. scan_topic names the laser message, such as ``FLASER``.

    Without it: of the messages that carry odometry (else of all) the one with the most lines.
    Raises InputRefused for a file without scans, without odometry or of another kind.
    """
    content = collect(path)
    channel, warnings = _choose_channel(content, scan_topic, path)
    lines = content.lasers[channel]
    warnings += oddities(content)
    warnings += _order_warnings(channel, lines)
    lines = _sorted_unique(lines, warnings)
    odometry = _odometry(lines, content)
    if odometry is None:
        raise InputRefused(path, f"{channel} lines carry no odometry and there is no ODOM line")
    lines = _covered(lines, odometry, warnings, path)
    T_base_laser = mounting_of(lines, content, warnings)
    return Log(
        name=path.name.split(".")[0],
        epoch=epoch_of(lines[0].stamp_ns),
        scans=StoredScans(_scans(lines, content, channel, warnings)),
        odometry=odometry,
        imu=None,
        encoders=None,
        T_base_laser=T_base_laser,
        warnings=tuple(warnings),
    )


def _choose_channel(
    content: CarmenContent, wanted: str | None, path: Path
) -> tuple[str, list[str]]:
    counts = {name: len(lines) for name, lines in content.lasers.items()}
    listing = ", ".join(f"{name} ({n} lines)" for name, n in counts.items())
    if not counts:
        odom = f"{len(content.odometry)} ODOM lines"
        raise InputRefused(path, f"a log without scans: {odom}, but no FLASER or ROBOTLASER1 line")
    if wanted is not None:
        if wanted not in counts:
            raise InputRefused(path, f"no laser message {wanted!r}; there is {listing}")
        return wanted, []
    with_odometry = [n for n, lines in content.lasers.items() if lines[0].T_odom_base is not None]
    chosen = max(with_odometry or counts, key=lambda name: counts[name])
    return chosen, [f"of {listing}, {chosen} is read"] if len(counts) > 1 else []


def oddities(content: CarmenContent) -> list[str]:
    """What stands in the file besides laser and odometry lines, in words."""
    warnings = []
    if content.malformed:
        warnings.append(
            f"{content.malformed} malformed lines left out, the first at {content.first_malformed}"
        )
    if content.ignored:
        ignored = ", ".join(f"{name} ({n})" for name, n in sorted(content.ignored.items()))
        warnings.append(f"messages without a use here: {ignored}")
    return warnings


def _path_length_m(lines: list[LaserLine]) -> float:
    positions = [line.T_odom_base[:2] for line in lines if line.T_odom_base is not None]
    return sum(float(np.linalg.norm(b - a)) for a, b in pairwise(positions))


def _order_warnings(channel: str, lines: list[LaserLine]) -> list[str]:
    backward = count_backward([line.stamp_ns for line in lines])
    if not backward:
        return []
    warning = (
        f"{backward} of {len(lines)} {channel} lines are stamped before the line above: "
        "sorted by stamp"
    )
    as_written_m = _path_length_m(lines)
    as_stamped_m = _path_length_m(sorted(lines, key=lambda line: line.stamp_ns))
    if as_stamped_m > 1.05 * as_written_m:
        warning += (
            f"; the odometry path grows from {as_written_m:.0f} m to {as_stamped_m:.0f} m by that, "
            "so the stamps were wrong, not the order; each scan keeps the odometry of its line"
        )
    return [warning]


def _sorted_unique(lines: list[LaserLine], warnings: list[str]) -> list[LaserLine]:
    ordered = sorted(lines, key=lambda line: line.stamp_ns)
    kept = [ordered[0]]
    kept += [b for a, b in pairwise(ordered) if a.stamp_ns != b.stamp_ns]
    if len(kept) < len(ordered):
        warnings.append(
            f"{len(ordered) - len(kept)} scans carry the stamp of another one: the first is kept"
        )
    return kept


def _odometry(lines: list[LaserLine], content: CarmenContent) -> PlanarTrajectory | None:
    """Each scan's own odometry pose; ODOM lines where the laser lines carry none, and outside.

    Between the scans ODOM lines are left out: they are stamped by another process, up to a
    tenth of a second off against the pose of the laser line (aces), so merging both makes the
    path jump to and fro.
    """
    knots = [(line.stamp_ns, line.T_odom_base) for line in lines if line.T_odom_base is not None]
    others = [(line.stamp_ns, line.T_odom_base) for line in content.odometry]
    if knots:
        first_ns, last_ns = knots[0][0], knots[-1][0]
        knots += [(t, pose) for t, pose in others if not first_ns <= t <= last_ns]
    else:
        knots = others
    if not knots:
        return None
    stamps_ns, first = np.unique(np.array([t for t, _ in knots]), return_index=True)
    poses = np.array([pose for _, pose in knots])[first]
    poses[:, 2] = wrap_angle(poses[:, 2])
    return PlanarTrajectory(stamps_ns, poses)


def _covered(
    lines: list[LaserLine], odometry: PlanarTrajectory, warnings: list[str], path: Path
) -> list[LaserLine]:
    first_ns, last_ns = int(odometry.stamps_ns[0]), int(odometry.stamps_ns[-1])
    kept = [line for line in lines if first_ns <= line.stamp_ns <= last_ns]
    if not kept:
        raise InputRefused(
            path,
            f"no common time: scans {lines[0].stamp_ns}..{lines[-1].stamp_ns} ns, "
            f"odometry {first_ns}..{last_ns} ns",
        )
    if len(kept) < len(lines):
        warnings.append(f"{len(lines) - len(kept)} scans outside the odometry's time left out")
    return kept


def _parameter(content: CarmenContent, *names: str) -> float | None:
    for name in names:
        try:
            value = float(content.parameters[name])
        except (KeyError, ValueError):
            continue
        if np.isfinite(value):
            return value
    return None


def mounting_of(lines: list[LaserLine], content: CarmenContent, warnings: list[str]) -> FloatArray:
    """4 x 4 T_base_laser: laser pose against odometry pose, if the same in all lines."""
    offset_x_m = _parameter(content, _OFFSET_PARAMETER) or 0.0
    mounting = np.array([offset_x_m, 0.0, 0.0])
    pairs = [(a.T_odom_base, a.T_odom_laser) for a in lines if a.T_odom_laser is not None]
    if pairs:
        T_base_laser = between(np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs]))
        T_base_laser[:, 2] = np.unwrap(T_base_laser[:, 2])  # one that looks back may be at +-pi
        middle = np.median(T_base_laser, axis=0)
        if np.abs(T_base_laser - middle).max() <= _RIGID_TOLERANCE:
            mounting = np.round(middle, 6)  # the log has six decimals
        else:
            warnings.append(
                "the laser pose moves against the odometry pose (a corrected log): "
                f"the laser is taken to sit at x = {offset_x_m} m ({_OFFSET_PARAMETER})"
            )
    return se3_from_parts(
        matrix_from_rpy(0.0, 0.0, float(mounting[2])), np.array([mounting[0], mounting[1], 0.0])
    )


def range_max_of(lines: Sequence[LaserLine], content: CarmenContent) -> tuple[float, str]:
    """The reading from which on nothing was there, and how that is known.

    Declared by the line or a PARAM; else the largest reading, if at least one in a thousand
    equals it, capped where the codes of a SICK LMS begin; else beyond all readings.
    """
    if lines[0].fan.range_max_m is not None:
        return lines[0].fan.range_max_m, "declared by the laser lines"
    declared = _parameter(content, *_MAXIMUM_PARAMETERS)
    if declared is not None and declared > 0.0:
        return declared, "declared by a PARAM line"
    readings = np.concatenate([line.readings_m for line in lines])
    readings = readings[np.isfinite(readings)]
    largest = float(readings.max(initial=0.0))
    if largest >= _LMS_CODES_FROM_M or np.mean(readings == largest) >= _SATURATED_SHARE:
        return min(largest, _LMS_CODES_FROM_M), "seen as the saturation of the readings"
    return _LMS_CODES_FROM_M, "where the codes of a SICK LMS begin"


def _scans(
    lines: list[LaserLine], content: CarmenContent, channel: str, warnings: list[str]
) -> list[Scan]:
    common_max_m, known_from = range_max_of(lines, content)
    warnings.append(f"readings from {common_max_m:g} m on are no return ({known_from})")
    counts = Counter(line.fan.beam_count for line in lines)
    if len(counts) > 1:
        listing = ", ".join(f"{beams} beams ({n} scans)" for beams, n in counts.most_common())
        warnings.append(f"the number of beams changes: {listing}")
    geometries: dict[Fan, ScanGeometry] = {}
    scans = []
    for line in lines:
        geometry = geometries.get(line.fan)
        if geometry is None:
            geometry = geometries[line.fan] = _geometry(line.fan, common_max_m, channel)
        ranges_m = _ranges_m(line.readings_m, geometry.range_max_m)
        scans.append(Scan(line.stamp_ns, ranges_m, geometry, line.intensities))
    return scans


def _geometry(fan: Fan, common_max_m: float, channel: str) -> ScanGeometry:
    return ScanGeometry(
        angle_min_rad=fan.angle_min_rad,
        angle_step_rad=fan.angle_step_rad,
        beam_count=fan.beam_count,
        beam_dt_ns=0,
        range_min_m=0.0,
        range_max_m=common_max_m if fan.range_max_m is None else fan.range_max_m,
        frame_id=channel.lower(),
    )


def to_single(readings_m: FloatArray) -> Float32Array:
    """As ranges are kept; ``inf`` where a reading is too large for that."""
    with np.errstate(over="ignore"):
        return readings_m.astype(np.float32)


def _ranges_m(readings_m: FloatArray, range_max_m: float) -> Float32Array:
    """Readings at or above the maximum return nothing; none, zero or less is no reading."""
    ranges_m = to_single(readings_m)
    invalid: BoolArray = ~(ranges_m > 0.0)
    ranges_m[ranges_m >= np.float32(range_max_m)] = np.inf
    ranges_m[invalid] = np.nan
    return ranges_m
