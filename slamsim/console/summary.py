"""The main numbers of a report, as a short table."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import cast

Numbers = Mapping[str, object]

SPANS_TOLD = 5
"""Of the times at which a robot was not placed in a known map, so many of each kind are told."""


def summary(report: Numbers) -> dict[str, str]:
    """Name and value, with units, of what the report knows; what it does not know is left out."""
    lines = {name: line(report) for name, line in _LINES.items()}
    return {name: text for name, text in lines.items() if text is not None}


def flat(values: Numbers, prefix: str = "") -> dict[str, str]:
    """Every number under its dotted key, nested ones included; lists and unknowns left out."""
    rows: dict[str, str] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            rows.update(flat(value, f"{prefix}{key}."))
        elif isinstance(value, float):
            rows[f"{prefix}{key}"] = f"{value:.4g}"
        elif value is not None and not isinstance(value, list | tuple):
            rows[f"{prefix}{key}"] = str(value)
    return rows


def _number(report: Numbers, *keys: str) -> float | None:
    value: object = report
    for key in keys:
        value = value.get(key) if isinstance(value, Mapping) else None
    return None if value is None else float(cast(float, value))


def _driven(report: Numbers) -> str | None:
    path_m, duration_s = _number(report, "path_length_m"), _number(report, "duration_s")
    return None if path_m is None else f"{path_m:.1f} m in {duration_s:.1f} s"


def _localised(report: Numbers) -> str | None:
    """How many scans were placed in a known map, and when they were not."""
    spans = report.get("spans")
    if not isinstance(spans, list):
        return None
    told = [f"{report['scans_placed']} of {report['scans']} scans placed in the map"]
    for state, words in (("odometry", "by odometry"), ("unknown", "place unknown")):
        of_state = [span for span in spans if span["state"] == state]
        longest = sorted(of_state, key=lambda span: span["from_s"] - span["to_s"])[:SPANS_TOLD]
        times = [f"{s['from_s']:.1f} to {s['to_s']:.1f} s" for s in sorted(longest, key=_begin)]
        rest = len(of_state) - len(longest)
        times += [f"{rest} shorter ones"] if rest else []
        told.append(
            f"{report[f'scans_{state}']} {words}" + (f" ({', '.join(times)})" if times else "")
        )
    return "; ".join(told)


def _begin(span: Numbers) -> float:
    return cast(float, span["from_s"])


def _trajectory(report: Numbers) -> str | None:
    ate_m, odometry_m = _number(report, "ate_rmse_m"), _number(report, "odometry_ate_rmse_m")
    if ate_m is None:
        return None
    beside = "" if odometry_m is None else f"   (odometry alone {_metres(odometry_m)})"
    return f"{_metres(ate_m)} RMSE, {_metres(_number(report, 'ate_max_m'))} at most{beside}"


def _limit(report: Numbers) -> str | None:
    bound_m, ratio = _number(report, "bound_ate_m"), _number(report, "ate_over_bound")
    if bound_m is None or ratio is None:
        return None
    return f"{_fine(bound_m)} RMSE is the lower bound for any SLAM; this is {ratio:.3g} times that"


def _trust(report: Numbers) -> str | None:
    mean, inside = _number(report, "nees_mean"), _number(report, "nees_inside_95_share")
    if mean is None or inside is None:
        return None
    return f"NEES {mean:.2g} (true covariances: 3), {100 * inside:.0f} % within their 95 % ellipse"


def _drift(report: Numbers) -> str | None:
    percent = _number(report, "rpe_trans_percent")
    return None if percent is None else f"{percent:.3g} % of the path"


def _walls(report: Numbers) -> str | None:
    recall, precision = _number(report, "map_wall_recall"), _number(report, "map_wall_precision")
    if recall is None or precision is None:
        return None
    return f"{100 * recall:.1f} % found, {100 * precision:.1f} % true, within one cell"


def _free(report: Numbers) -> str | None:
    overlap = _number(report, "map_free_iou")
    return None if overlap is None else f"{100 * overlap:.1f} % overlap with the true floor"


def _relations(report: Numbers) -> str | None:
    mean_m = _number(report, "relations", "all", "translation_mean_m")
    mean_deg = _number(report, "relations", "all", "rotation_mean_deg")
    if mean_m is None or mean_deg is None:
        return None
    return f"{mean_m:.4f} m, {mean_deg:.3f}° mean absolute error"


def _calibration(report: Numbers) -> str | None:
    """What the drive told of wheels and gyroscope, in the units that a person thinks in."""
    found = report.get("calibration")
    if not isinstance(found, Mapping):
        return None
    told = []
    for name, one in found.items():
        label, unit, factor, offset = _CALIBRATED[name]
        if one["observed"]:
            value, sigma = factor * (one["value"] - offset), factor * one["sigma"]
            told.append(f"{label} {value:.3f} ± {sigma:.3f} {unit}")
    return ", ".join(told) or None


def _closures(report: Numbers) -> str | None:
    accepted, rejected = report.get("loop_closures"), report.get("loop_closures_rejected")
    return None if accepted is None else f"{accepted} accepted, {rejected} rejected"


def _speed(report: Numbers) -> str | None:
    factors = report.get("realtime_factor")
    if not isinstance(factors, Mapping):
        return None
    known = [f"{name} {value:.3g} ×" for name, value in factors.items() if value is not None]
    return ", ".join(known) + " real time"


def _memory(report: Numbers) -> str | None:
    memory_mb = _number(report, "peak_memory_mb")
    return None if memory_mb is None else f"{memory_mb:.0f} MB at most"


def _fine(value_m: float) -> str:
    return f"{1e3 * value_m:.3g} mm" if value_m < 0.01 else _metres(value_m)


def _metres(value: float | None) -> str:
    if value is None:
        return "unknown"
    return f"{1e3 * value:.1f} mm" if value < 0.1 else f"{value:.2f} m"


_CALIBRATED = {
    "wheel_radius_left_m": ("radius left", "mm", 1e3, 0.0),
    "wheel_radius_right_m": ("right", "mm", 1e3, 0.0),
    "track_m": ("track", "mm", 1e3, 0.0),
    "path_scale": ("path", "%", 1e2, 1.0),
    "turn_scale": ("turn", "%", 1e2, 1.0),
    "curvature_rad_per_m": ("curvature", "°/m", math.degrees(1.0), 0.0),
    "gyro_bias_rad_s": ("gyro bias", "mrad/s", 1e3, 0.0),
    "gyro_scale": ("gyro scale", "%", 1e2, 1.0),
    "laser_angle_scale": ("angle step", "%", 1e2, 1.0),
    "laser_range_offset_m": ("ranges", "mm", 1e3, 0.0),
    "laser_sweep_s": ("sweep", "ms", 1e3, 0.0),
    "laser_x_m": ("laser x", "mm", 1e3, 0.0),
    "laser_y_m": ("y", "mm", 1e3, 0.0),
    "laser_yaw_rad": ("yaw", "°", math.degrees(1.0), 0.0),
}
"""Of each number: its short name, unit, unit's factor and what is taken off before."""

_LINES: dict[str, Callable[[Numbers], str | None]] = {
    "driven": _driven,
    "localised": _localised,
    "trajectory error": _trajectory,
    "limit": _limit,
    "consistency": _trust,
    "drift": _drift,
    "walls": _walls,
    "free space": _free,
    "relations": _relations,
    "loop closures": _closures,
    "calibration": _calibration,
    "speed": _speed,
    "memory": _memory,
}
