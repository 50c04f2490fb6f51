"""What the stops of the basic drive say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from slamsim.config.scenarios.robots import BasicDriveConfig
from slamsim.core.types import FloatArray
from slamsim.scenarios.base import Chart, Findings, Outcome, ResultTable, Series, Source, Verdict
from slamsim.scenarios.scripted import (
    FIFTH_STOP_DRIVE_S,
    FIFTH_STOP_M,
    FIFTH_STOP_SPEEDS_M_S,
    IDENTIFIED,
)

IDEAL = "ideal motors"
FIFTH = 4
CLOSE_M = 0.3
STRAIGHT_M = 0.01
"""A robot that stops this near to where theory has it, and never leaves the line by more, drives
perfectly straight: a fifth of a per cent of the way."""
ELLIPSE_SIGMAS = 2.0
"""86 % of normal positions lie within."""


@dataclass(frozen=True, slots=True, eq=False)
class Stops:
    """Of one robot. places_m: (runs, stops, 2). paths_m: one (n, 2) for each run."""

    robot: str
    places_m: FloatArray
    paths_m: tuple[FloatArray, ...]

    @property
    def means_m(self) -> FloatArray:
        return np.asarray(self.places_m.mean(axis=0))

    def covariance_m2(self, stop: int) -> FloatArray:
        """(2, 2); zero for a single run."""
        places = self.places_m[:, stop]
        return np.cov(places.T, ddof=1) if len(places) > 1 else np.zeros((2, 2))


def stops_found(
    config: BasicDriveConfig, outcomes: Sequence[Outcome], robots: Sequence[str]
) -> Findings:
    """The findings of all robots of which a run came to its end."""
    theory_m = theoretical_stops_m(config)
    found = [stops for name in robots if (stops := _stops_of(name, outcomes)) is not None]
    compared = _is_the_studys(config)
    return Findings(
        summary=_summary(found, theory_m),
        numbers=_numbers(found),
        verdicts=(*_straight(found, theory_m), *(_fifth(found) if compared else ())),
        tables=(*_stop_tables(found, theory_m), *((_compared(found),) if compared else ())),
        charts=(_places_chart(found, theory_m, compared), _paths_chart(found)),
    )


def theoretical_stops_m(config: BasicDriveConfig) -> FloatArray:
    """(stops,) x of each stop by speed and time alone; y is 0."""
    return np.array([x for v in config.speeds_m_s for x in (v * config.drive_s, 0.0)])


def _is_the_studys(config: BasicDriveConfig) -> bool:
    return (config.speeds_m_s, config.drive_s) == (FIFTH_STOP_SPEEDS_M_S, FIFTH_STOP_DRIVE_S)


def _stops_of(robot: str, outcomes: Sequence[Outcome]) -> Stops | None:
    own = [outcome.arrays for outcome in outcomes if outcome.values["robot"] == robot]
    if not own:
        return None
    places_m = np.stack([arrays["stops"][:, :2] for arrays in own])
    return Stops(robot, places_m, tuple(arrays["path_m"] for arrays in own))


def _summary(found: Sequence[Stops], theory_m: FloatArray) -> str:
    told = [
        f"{stops.robot} ends its last way out at ({x:.2f}, {y:.2f}) m"
        for stops in found
        for x, y in [stops.means_m[-2].tolist()]
    ]
    return f"Theory has the last way out end at ({theory_m[-2]:g}, 0) m; " + ", ".join(told) + "."


def _numbers(found: Sequence[Stops]) -> dict[str, float]:
    numbers = {}
    for stops in found:
        key = stops.robot.replace(" ", "_")
        for stop, (x, y) in enumerate(stops.means_m.tolist(), start=1):
            numbers[f"{key}_stop_{stop}_x_m"], numbers[f"{key}_stop_{stop}_y_m"] = x, y
    return numbers


def _straight(found: Sequence[Stops], theory_m: FloatArray) -> list[Verdict]:
    ideal = next((stops for stops in found if stops.robot == IDEAL), None)
    if ideal is None:
        return []
    off_m = _off_theory_m(ideal, theory_m)
    aside_m = max(float(np.abs(path[:, 1]).max()) for path in ideal.paths_m)
    numbers = f"stops off by {1e3 * off_m:.1f} mm at most, path aside by {1e3 * aside_m:.1f} mm"
    verdicts = [
        Verdict(
            "Gazebo, without a motor model, drives perfectly straight to where theory has it; "
            "ideal motors on equal wheels do so here too",
            "study",
            max(off_m, aside_m) < STRAIGHT_M,
            numbers,
        )
    ]
    for stops in found:
        if stops is not ideal and len(stops.places_m) > 1:
            out_m, back_m = (
                float(np.sqrt([np.trace(stops.covariance_m2(s)) for s in which]).mean())
                for which in (range(0, len(theory_m), 2), range(1, len(theory_m), 2))
            )
            verdicts.append(
                Verdict(
                    f"{stops.robot}: wheels that are unequal bend the way back as they bent the "
                    "way out, so the stops near the start scatter less than the far ones",
                    "theory",
                    back_m < out_m,
                    f"{1e3 * back_m:.0f} mm near the start, {1e3 * out_m:.0f} mm far from it",
                )
            )
    return verdicts


def _off_theory_m(stops: Stops, theory_m: FloatArray) -> float:
    off = stops.means_m - np.column_stack([theory_m, np.zeros_like(theory_m)])
    return float(np.linalg.norm(off, axis=1).max())


def _from_reality_m(place_m: FloatArray) -> float:
    return float(np.linalg.norm(place_m - np.array(FIFTH_STOP_M["reality"])))


def _fifth(found: Sequence[Stops]) -> list[Verdict]:
    identified = next((stops for stops in found if stops.robot == IDENTIFIED), None)
    if identified is None:
        return []
    off_m = _from_reality_m(identified.means_m[FIFTH])
    unity_m, gazebo_m = (
        _from_reality_m(np.array(FIFTH_STOP_M[source]))
        for source in cast(list[Source], ["unity", "gazebo"])
    )
    x, y = identified.means_m[FIFTH].tolist()
    return [
        Verdict(
            f"The identified robot makes its fifth stop within {CLOSE_M:g} m of the real one",
            "target",
            off_m < CLOSE_M,
            f"({x:.2f}, {y:.2f}) m, {off_m:.2f} m from (5.5, 0.3) m",
        ),
        Verdict(
            "It is closer to reality than Unity and Gazebo",
            "target",
            off_m < min(unity_m, gazebo_m),
            f"{off_m:.2f} m against {unity_m:.2f} m (Unity) and {gazebo_m:.2f} m (Gazebo)",
        ),
    ]


def _stop_tables(found: Sequence[Stops], theory_m: FloatArray) -> list[ResultTable]:
    header = ("stop", "theory x [m]", "mean x [m]", "mean y [m]", "sd x [m]", "sd y [m]", "off [m]")
    tables = []
    for stops in found:
        rows = []
        for stop, x in enumerate(theory_m):
            mean, sd = stops.means_m[stop], np.sqrt(np.diag(stops.covariance_m2(stop)))
            off = float(np.linalg.norm(mean - (x, 0.0)))
            numbers = (f"{value:.3f}" for value in (*mean, *sd, off))
            rows.append((str(stop + 1), f"{x:g}", *numbers))
        runs = len(stops.places_m)
        note = "It is the same in every run." if runs == 1 else ""
        tables.append(
            ResultTable(f"Stops of {stops.robot}, {runs} runs", header, tuple(rows), note)
        )
    return tables


def _compared(found: Sequence[Stops]) -> ResultTable:
    places: dict[str, FloatArray] = {
        "theory": np.array(FIFTH_STOP_M["theory"]),
        "real robot": np.array(FIFTH_STOP_M["reality"]),
        "Unity": np.array(FIFTH_STOP_M["unity"]),
        "Gazebo": np.array(FIFTH_STOP_M["gazebo"]),
        **{f"slamsim, {stops.robot}": stops.means_m[FIFTH] for stops in found},
    }
    rows = tuple(
        (name, f"{place[0]:.2f}", f"{place[1]:.2f}", f"{_from_reality_m(place):.2f}")
        for name, place in places.items()
    )
    header = ("who", "x [m]", "y [m]", "from reality [m]")
    return ResultTable("Fifth stop", header, rows, "Figures of others are those of the study.")


def _places_chart(found: Sequence[Stops], theory_m: FloatArray, compared: bool) -> Chart:
    series = [
        Series("theory", "theory", theory_m, np.zeros_like(theory_m), "points"),
        *(part for stops in found for part in _clusters(stops)),
    ]
    if compared:
        for source in cast(list[Source], ["reality", "unity", "gazebo"]):
            x, y = FIFTH_STOP_M[source]
            name = f"{source}, fifth stop"
            series.append(Series(name, source, np.array([x]), np.array([y]), "points"))
    return Chart(
        "Where it stops",
        "x [m]",
        "y [m]",
        tuple(series),
        note=f"Ellipses: {ELLIPSE_SIGMAS:g} standard deviations of the runs of one robot.",
    )


def _clusters(stops: Stops) -> list[Series]:
    places_m = stops.places_m.reshape(-1, 2)
    parts = [Series(stops.robot, "slamsim", places_m[:, 0], places_m[:, 1], "points")]
    if len(stops.places_m) > 1:
        circle = np.linspace(0.0, 2.0 * np.pi, 49)
        unit = np.stack([np.cos(circle), np.sin(circle)])
        rings = []
        for stop, mean in enumerate(stops.means_m):
            variances, axes = np.linalg.eigh(stops.covariance_m2(stop))
            half_axes_m = ELLIPSE_SIGMAS * np.sqrt(np.maximum(variances, 0.0))
            rings += [mean[:, None] + axes @ (half_axes_m[:, None] * unit), np.full((2, 1), np.nan)]
        x, y = np.hstack(rings)
        parts.append(Series(f"{stops.robot}, 2 sigma", "slamsim", x, y, "line"))
    return parts


def _paths_chart(found: Sequence[Stops]) -> Chart:
    series = []
    for stops in found:
        gap = np.full((1, 2), np.nan)
        joined = np.vstack([part for path in stops.paths_m for part in (path, gap)])
        dashed = len(stops.paths_m) == 1
        series.append(
            Series(stops.robot, "slamsim", joined[:, 0], joined[:, 1], "line", dashed=dashed)
        )
    note = "Widened across: one metre of y is drawn longer than one of x."
    return Chart("The way that each run took", "x [m]", "y [m]", tuple(series), note=note)
