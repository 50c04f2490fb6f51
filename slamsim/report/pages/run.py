"""Report of a run as one self-contained HTML file."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

from slamsim.core.calibrated import calibrated_interval, calibrated_name
from slamsim.evaluate.relations import RelationScores, RelationStatistics
from slamsim.guard.output import write_atomic
from slamsim.guard.quantities import as_lengths, as_time
from slamsim.report.figures.on_map import held_figure, obstacle_figure, semantic_figure
from slamsim.report.figures.run import curve_figure, map_figure, truth_figure
from slamsim.report.pages.check import verdicts
from slamsim.report.pages.html import (
    Card,
    Table,
    cards,
    details,
    figure,
    page,
    pair,
    section,
    table,
    warnings,
)
from slamsim.report.pages.precision_tables import precision_tables
from slamsim.report.precision import precision_plots
from slamsim.report.run_view import RunView, realtime_factors, report_json
from slamsim.report.viewer.series import Panel, plots

CURVE_POINTS = 1500


def write_report(path: Path, view: RunView) -> None:
    """Write ``report.html``; raises what write_atomic raises."""
    write_atomic(path, report_html(view).encode())


def report_html(view: RunView) -> str:
    """The whole page; everything that comes from files is escaped."""
    parts = [
        cards(_verdict(view)),
        warnings(view.warnings),
        section("Map", _maps(view)),
        section("Precision", _precision(view)),
        section("Over time", _pair(view, plots(view, CURVE_POINTS))),
        section("Trajectory", _trajectory_table(view)),
        section("Relations", _relations_table(view)),
        section("Calibration", _calibration_table(view)),
        section("Time spent", _timing_table(view)),
        section("The recording", "" if view.checked is None else verdicts(view.checked.findings)),
        section("Reproduce", _reproduce(view)),
    ]
    return page(view.log.name, f"{view.verdict} {headline(view)}".strip(), "".join(parts))


def headline(view: RunView) -> str:
    """The run in one sentence."""
    numbers = report_json(view)
    sentence = (
        f"{numbers['path_length_m']:.0f} m driven in {as_time(view.duration_s)}, "
        f"{len(view.result.trajectory):,} scans mapped"
    )
    speed = realtime_factors(view)["slam"]
    if speed is not None:
        sentence += f" at {speed:.1f} × real time"
    if numbers["odometry_ate_rmse_m"] is not None:
        sentence += f"; odometry alone would be {_length(numbers['odometry_ate_rmse_m'])} off"
    if view.scores.relations is not None:
        met = view.scores.relations.all
        sentence += f". Verified relations are met to {_length(met.translation_mean_m)}"
        sentence += f" and {met.rotation_mean_deg:.2f}° on average"
    return sentence + "."


def _verdict(view: RunView) -> list[Card]:
    """The numbers that matter most, each with its context; what is unknown is left out."""
    numbers = view.scores.numbers()
    speeds = realtime_factors(view)
    relations = view.scores.relations
    made = [
        Card("ATE RMSE", _length(numbers["ate_rmse_m"]), f"max {_length(numbers['ate_max_m'])}"),
        Card("ATE / bound", _times(numbers["ate_over_bound"]), "best possible: 1\u00a0×"),
        Card("Odometry alone", _length(numbers["odometry_ate_rmse_m"]), "ATE RMSE"),
        Card("Wall recall", _share(numbers["map_wall_recall"]), "of walls in view, one cell"),
        Card("Wall precision", _share(numbers["map_wall_precision"]), "within one cell"),
        Card("Free-space IoU", _share(numbers["map_free_iou"]), "with the true floor"),
    ]
    if relations is not None:
        rotation = f"{relations.all.rotation_mean_deg:.2f}° · {relations.all.count} relations"
        made.append(Card("Relations", _length(relations.all.translation_mean_m), rotation))
    rejected = f"{view.result.closures_rejected} rejected"
    made.append(Card("Loop closures", str(view.result.closures_accepted), rejected))
    if speeds["slam"] is not None:
        made.append(Card("SLAM speed", f"{speeds['slam']:.1f} ×", "real time"))
    if speeds["simulate"] is not None:
        made.append(Card("Simulation speed", f"{speeds['simulate']:.1f} ×", "real time"))
    if view.peak_memory_mb is not None:
        made.append(Card("Peak memory", f"{view.peak_memory_mb:.0f} MB", "whole command"))
    return [card for card in made if card.value]


def _maps(view: RunView) -> str:
    against = truth_figure(view)
    caption = "Map, paths driven and loop closures, in metres"
    pictures = [figure(map_figure(view), caption, wide=True, zoom=True)]
    if against is not None:
        walls = "Mapped walls against the true ones, in metres"
        pictures.append(figure(against, walls, wide=True, zoom=True))
    return pair([*pictures, *_layers(view)], paper=True)


def _layers(view: RunView) -> list[str]:
    """What images add to the map."""
    pictures, found = [], view.obstacles
    if view.layers.obstacles is not None:
        caption = "Obstacles that depth images show, over the lidar's map, in metres"
        if found is not None and found.hidden_recall is not None:
            caption += (
                f": {found.hidden_recall:.0%} of what the lidar's plane does not meet in view of "
                f"the camera, {found.false_cells:,} cells where nothing is"
            )
        pictures.append(figure(obstacle_figure(view, view.layers.obstacles), caption, wide=True))
    if view.layers.semantic is not None:
        caption = f"Most frequent label of {view.layers.semantic.topic}, in metres"
        pictures.append(figure(semantic_figure(view, view.layers.semantic), caption, wide=True))
    return pictures


def _precision(view: RunView) -> str:
    """What was possible, what each part of SLAM cost, and how true the claimed errors are."""
    picture = held_figure(view)
    made = ""
    if picture is not None:
        caption = "Localisability along the path, in metres"
        made = pair([figure(picture, caption, wide=True)], paper=True)
    made += _pair(view, precision_plots(view, CURVE_POINTS))
    return made + precision_tables(view)


def _pair(view: RunView, curves: tuple[Panel, ...]) -> str:
    return pair([figure(curve_figure(plot, view), plot.title) for plot in curves])


def _trajectory_table(view: RunView) -> str:
    numbers = view.scores.numbers()
    if numbers["ate_rmse_m"] is None:
        return ""
    compared = [("estimate", ""), ("odometry alone", "odometry_")]
    lengths = ("ate_rmse_m", "ate_mean_m", "ate_median_m", "ate_max_m")
    told = [_lengths([numbers[prefix + key] for key in lengths]) for _, prefix in compared]
    names = ("ATE, RMSE", "ATE, mean", "ATE, median", "ATE, maximum")
    rows = list(zip(names, *told, strict=True))
    rows += [
        (label, *(_digits(numbers[prefix + key]) for _, prefix in compared))
        for label, key in (
            ("Heading, RMSE [°]", "ate_rot_rmse_deg"),
            ("Heading, maximum [°]", "ate_rot_max_deg"),
            ("RPE, translation [%]", "rpe_trans_percent"),
            ("RPE, rotation [°/m]", "rpe_rot_deg_per_m"),
        )
    ]
    note = (
        f"{numbers['evaluated_poses']:,} poses compared after a rigid alignment in the plane, "
        f"{numbers['unevaluated_poses']:,} outside the truth. RPE: mean over all stretches of "
        "1, 2, 5, 10, 20 and 50 m of true path."
    )
    return table(Table(("", *(name for name, _ in compared)), rows), note)


def _relations_table(view: RunView) -> str:
    relations, odometry = view.scores.relations, view.scores.odometry_relations
    if relations is None:
        return ""
    rows = _relation_rows("estimate", relations)
    if odometry is not None:
        rows += _relation_rows("odometry alone", odometry)
    header = ("", "relations", "count", "translation [m]", "rotation [°]")
    note = f"Mean ± standard deviation. {relations.skipped} relations outside the trajectory."
    return table(Table(header, rows), note)


def _relation_rows(name: str, scores: RelationScores) -> list[tuple[str, ...]]:
    parts: tuple[tuple[str, RelationStatistics | None], ...] = (
        ("all", scores.all),
        ("under 5 s", scores.near),
        ("over 60 s", scores.far),
    )
    return [
        (
            name,
            span,
            f"{part.count:,}",
            f"{part.translation_mean_m:.4f} ± {part.translation_std_m:.4f}",
            f"{part.rotation_mean_deg:.3f} ± {part.rotation_std_deg:.3f}",
        )
        for span, part in parts
        if part is not None
    ]


def _calibration_table(view: RunView) -> str:
    named = [(calibrated_name(name), name, one) for name, one in view.result.calibration.items()]
    for topic, found in view.result.calibration_beside.items():
        named += [(f"{topic}: {calibrated_name(name)}", name, one) for name, one in found.items()]
    rows = [
        (
            words,
            calibrated_interval(name, one.value, one.sigma),
            "drive" if one.observed else "prior",
        )
        for words, name, one in named
    ]
    note = (
        "Wheels, gyroscope and lidars, with standard deviations: as the drive shows them, or "
        "as they were assumed to be."
    )
    header = ("", "value", "told by")
    return table(Table(header, rows, words=True), note) if rows else ""


def _timing_table(view: RunView) -> str:
    rows = []
    for prefix, seconds in (("", view.seconds), ("SLAM: ", view.result.seconds)):
        for stage, spent_s in seconds.items():
            factor = f"{view.duration_s / spent_s:,.1f} ×" if spent_s >= 0.01 else ""
            rows.append((prefix + stage, f"{spent_s:.2f}", factor))
    return table(Table(("stage", "seconds", "real time"), rows)) if rows else ""


def _reproduce(view: RunView) -> str:
    made = f"<pre><code>{escape(view.command)}</code></pre>" if view.command else ""
    if view.config_yaml:
        made += details("Configuration, fully resolved", view.config_yaml)
    return made


def _length(value: object) -> str:
    """Empty if unknown."""
    return as_lengths(value)[0] if isinstance(value, int | float) else ""


def _times(value: object) -> str:
    return f"{value:.3g} ×" if isinstance(value, int | float) else ""


def _share(value: object) -> str:
    return f"{value * 100:.1f} %" if isinstance(value, int | float) else ""


def _lengths(lengths_m: Sequence[float | None]) -> list[str]:
    known_m = [length_m for length_m in lengths_m if length_m is not None]
    return as_lengths(*known_m) if len(known_m) == len(lengths_m) else ["–"] * len(lengths_m)


def _digits(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, int | float) else "–"
