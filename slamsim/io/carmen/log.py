"""CARMEN logs (.clf, .log, also .gz and .bz2): the classic 2-D laser recordings.

Stamps are the ``ipc_time`` of a line, which relation files refer to. The log has no time per
beam: a scan counts as one instant (``beam_dt_ns`` 0).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slamsim.core.geometry import between, matrix_from_rpy, se3_from_parts, wrap_angle
from slamsim.core.types import (
    BoolArray,
    Float32Array,
    FloatArray,
    Log,
    PlanarTrajectory,
    Scan,
    ScanGeometry,
)
from slamsim.guard.errors import InputRefused
from slamsim.io.carmen.content import CarmenContent, collect
from slamsim.io.carmen.lines import Fan, LaserLine, OdomLine
from slamsim.io.carmen.times import timed
from slamsim.io.text.stamps import epoch_of
from slamsim.recording.cleaning.no_return import RangeLimit, RangeSample
from slamsim.recording.cleaning.scans import StoredScans

_MAXIMUM_PARAMETERS = ("robot_front_laser_max", "robot_laser_max", "laser_front_laser_max")
_OFFSET_PARAMETER = "robot_frontlaser_offset"
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
    recorded = len(lines)
    warnings += oddities(content)
    limit = range_limit_of(lines, content)
    lines, made_anew = timed(lines, channel, warnings)
    odometry = _odometry(lines, [] if made_anew else content.odometry)
    if odometry is None:
        odometry = _odometry([], content.odometry)
    if odometry is None:
        raise InputRefused(path, f"{channel} lines carry no odometry and there is no ODOM line")
    lines = _covered(lines, odometry, warnings, path)
    T_base_laser = mounting_of(lines, content, warnings)
    return Log(
        name=path.name.split(".")[0],
        epoch=epoch_of(lines[0].stamp_ns),
        scans=StoredScans(_scans(lines, limit, channel, warnings)),
        odometry=odometry,
        imu=None,
        encoders=None,
        T_base_laser=T_base_laser,
        warnings=tuple(warnings),
        recorded_scans=recorded,
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


def _odometry(lines: list[LaserLine], others: list[OdomLine]) -> PlanarTrajectory | None:
    """Each scan's own odometry pose; ODOM lines where the laser lines carry none, and outside.

    Between the scans ODOM lines are left out: they are stamped by another process, up to a
    tenth of a second off against the pose of the laser line (aces), so merging both makes the
    path jump to and fro.
    """
    knots = [(line.stamp_ns, line.T_odom_base) for line in lines if line.T_odom_base is not None]
    more = [(line.stamp_ns, line.T_odom_base) for line in others]
    if knots:
        first_ns, last_ns = knots[0][0], knots[-1][0]
        knots += [(t, pose) for t, pose in more if not first_ns <= t <= last_ns]
    else:
        knots = more
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


@dataclass(frozen=True, slots=True)
class CarmenLimit:
    """From where on readings are no return. declared_m: by a PARAM line, or the codes of a SICK
    LMS, for lines that declare nothing themselves."""

    declared_m: float
    found: RangeLimit
    words: str

    def maximum_m(self, fan: Fan) -> float:
        """For the readings of a fan."""
        declared_m = self.declared_m if fan.range_max_m is None else fan.range_max_m
        return self.found.maximum_m(declared_m)


def range_limit_of(lines: Sequence[LaserLine], content: CarmenContent) -> CarmenLimit:
    """What the lines declare, as far as their readings bear it out."""
    declared_m, known_from = _declared_max(lines[0], content)
    sample = RangeSample()
    for line in lines:
        sample.add(to_single(line.readings_m), line.fan.angle_step_rad)
    poses = [lines[number].T_odom_base for number in sample.numbers]
    known = [pose[:2] for pose in poses if pose is not None]
    found = sample.limit(declared_m, np.array(known) if len(known) == len(poses) else None)
    told = found.warnings(declared_m)
    words = "; ".join(told) or f"readings from {declared_m:g} m on are no return ({known_from})"
    return CarmenLimit(declared_m, found, words)


def _declared_max(line: LaserLine, content: CarmenContent) -> tuple[float, str]:
    if line.fan.range_max_m is not None:
        return line.fan.range_max_m, "declared by the laser lines"
    declared = _parameter(content, *_MAXIMUM_PARAMETERS)
    if declared is not None and declared > 0.0:
        return declared, "declared by a PARAM line"
    return _LMS_CODES_FROM_M, "where the codes of a SICK LMS begin"


def _scans(
    lines: list[LaserLine], limit: CarmenLimit, channel: str, warnings: list[str]
) -> list[Scan]:
    warnings.append(limit.words)
    counts = Counter(line.fan.beam_count for line in lines)
    if len(counts) > 1:
        listing = ", ".join(f"{beams} beams ({n} scans)" for beams, n in counts.most_common())
        warnings.append(f"the number of beams changes: {listing}")
    geometries: dict[Fan, ScanGeometry] = {}
    scans = []
    for line in lines:
        geometry = geometries.get(line.fan)
        if geometry is None:
            geometry = _geometry(line.fan, limit.maximum_m(line.fan), channel)
            geometries[line.fan] = geometry
        ranges_m = _ranges_m(line.readings_m, geometry.range_max_m)
        scans.append(Scan(line.stamp_ns, ranges_m, geometry, line.intensities))
    return scans


def _geometry(fan: Fan, range_max_m: float, channel: str) -> ScanGeometry:
    return ScanGeometry(
        angle_min_rad=fan.angle_min_rad,
        angle_step_rad=fan.angle_step_rad,
        beam_count=fan.beam_count,
        beam_dt_ns=0,
        range_min_m=0.0,
        range_max_m=range_max_m,
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
