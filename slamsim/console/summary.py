"""The main numbers of a report, as a short table."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import cast

from slamsim.core.calibrated import calibrated_short
from slamsim.guard.quantities import as_lengths, as_number, as_time, with_unit, words_of

Numbers = Mapping[str, object]

SPANS_TOLD = 5
"""Of the times at which a robot was not placed in a known map, so many of each kind are told."""


def summary(report: Numbers) -> dict[str, str]:
    """Name and value, with units, of what the report knows; what it does not know is left out."""
    lines = {name: line(report) for name, line in _LINES.items()}
    return {name: text for name, text in lines.items() if text is not None}


def labelled(values: Numbers, above: str = "") -> dict[str, str]:
    """Every value under its key in words, with its unit; nested ones below the words of theirs."""
    rows: dict[str, str] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            rows.update(labelled(value, f"{above}{words_of(key)}, "))
        elif value is not None:
            label, text = with_unit(key, value)
            alike = f"{above}{label}" in rows  # step_rmse_m beside step_rmse_mrad
            rows[f"{above}{words_of(key) if alike else label}"] = text
    return rows


def _number(report: Numbers, *keys: str) -> float | None:
    value: object = report
    for key in keys:
        value = value.get(key) if isinstance(value, Mapping) else None
    return None if value is None else float(cast(float, value))


def _driven(report: Numbers) -> str | None:
    path_m, duration_s = _number(report, "path_length_m"), _number(report, "duration_s")
    return None if path_m is None else f"{as_number(path_m)} m in {as_time(duration_s or 0.0)}"


def _localised(report: Numbers) -> str | None:
    """How many scans were placed in a known map, and when they were not."""
    spans = report.get("spans")
    if not isinstance(spans, list):
        return None
    told = [f"{report['scans_placed']:,} of {report['scans']:,} scans placed in the map"]
    for state, words in (("odometry", "by odometry"), ("unknown", "at an unknown place")):
        of_state = [span for span in spans if span["state"] == state]
        longest = sorted(of_state, key=lambda span: span["from_s"] - span["to_s"])[:SPANS_TOLD]
        times = [
            f"{as_number(s['from_s'])} to {as_number(s['to_s'])} s"
            for s in sorted(longest, key=_begin)
        ]
        rest = len(of_state) - len(longest)
        times += [f"{rest} shorter ones"] if rest else []
        told.append(
            f"{report[f'scans_{state}']:,} {words}" + (f" ({', '.join(times)})" if times else "")
        )
    return "; ".join(told)


def _begin(span: Numbers) -> float:
    return cast(float, span["from_s"])


def _trajectory(report: Numbers) -> str | None:
    keys = ("ate_rmse_m", "ate_max_m", "odometry_ate_rmse_m")
    known = [value for key in keys if (value := _number(report, key)) is not None]
    if _number(report, "ate_rmse_m") is None or len(known) < 2:
        return None
    told = as_lengths(*known[:2])
    beside = f" (odometry alone {as_lengths(known[2])[0]})" if len(known) > 2 else ""
    return f"{told[0]} RMSE, {told[1]} at most{beside}"


def _limit(report: Numbers) -> str | None:
    bound_m, ratio = _number(report, "bound_ate_m"), _number(report, "ate_over_bound")
    if bound_m is None or ratio is None:
        return None
    return (
        f"{as_lengths(bound_m)[0]} RMSE is the lower bound for any SLAM; this is "
        f"{as_number(ratio, 3)} times that"
    )


def _trust(report: Numbers) -> str | None:
    mean, inside = _number(report, "nees_mean"), _number(report, "nees_inside_95_share")
    if mean is None or inside is None:
        return None
    within = f"{100 * inside:.0f} % within their 95 % ellipse"
    return f"NEES {as_number(mean, 2)} (true covariances: 3), {within}"


def _drift(report: Numbers) -> str | None:
    percent = _number(report, "rpe_trans_percent")
    return None if percent is None else f"{as_number(percent, 3)} % of the path"


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
    return f"{as_lengths(mean_m)[0]}, {as_number(mean_deg, 3)}° mean absolute error"


def _calibration(report: Numbers) -> str | None:
    """What the drive told of wheels and gyroscope, in the units that a person thinks in."""
    found = report.get("calibration")
    if not isinstance(found, Mapping):
        return None
    told = [
        calibrated_short(name, one["value"], one["sigma"])
        for name, one in found.items()
        if one["observed"]
    ]
    return ", ".join(told) or None


def _closures(report: Numbers) -> str | None:
    accepted, rejected = report.get("loop_closures"), report.get("loop_closures_rejected")
    return None if accepted is None else f"{accepted:,} accepted, {rejected:,} rejected"


def _speed(report: Numbers) -> str | None:
    factors = report.get("realtime_factor")
    if not isinstance(factors, Mapping):
        return None
    known = [
        f"{name} {as_number(value, 3)} ×" for name, value in factors.items() if value is not None
    ]
    return ", ".join(known) + " real time"


def _memory(report: Numbers) -> str | None:
    memory_mb = _number(report, "peak_memory_mb")
    return None if memory_mb is None else f"{memory_mb:.0f} MB at most"


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
