"""What an identification says, as a scenario does: tables, verdicts, charts."""

from __future__ import annotations

import numpy as np

from slamsim.config.measurements import FigureConfig, ParameterName
from slamsim.scenarios.base import Chart, Findings, Series, Sheet, Value, Verdict
from slamsim.scenarios.identify import Identified
from slamsim.scenarios.identify_fit import Fit, Foreseen, sigmas_left
from slamsim.scenarios.identify_parameters import Parameter
from slamsim.types import FloatArray

WITHIN_SIGMAS = 2.0
UNTOUCHED = 0.9
"""A parameter that keeps so much of its prior uncertainty is not told of by any figure."""
OPEN = 0.5
"""A combination that keeps so much of its prior variance is hardly told of."""
CLEAR = 0.05
"""One that keeps so little is what the figures really measure."""
PART_OF_IT = 0.3


def identification_found(found: Identified) -> Findings:
    """The findings of an identification."""
    return Findings(
        lead=_lead(found),
        numbers=_numbers(found),
        verdicts=tuple(_verdicts(found)),
        sheets=(
            _figures_sheet(found),
            _parameters_sheet(found),
            _directions_sheet(found),
            _left_out_sheet(found),
            _others_sheet(found),
        ),
        charts=(_chart(found),),
    )


def _lead(found: Identified) -> str:
    figures, space = found.experiment.figures, found.experiment.space
    left = sigmas_left(found.fit)
    silent = [p.words for p, s in zip(space.parameters, left, strict=True) if s > UNTOUCHED]
    return (
        f"{len(figures)} figures tell of {len(space) - len(silent)} of {len(space)} parameters. "
        f"What none of them tells of stays as it was believed beforehand: {', '.join(silent)}."
    )


def _numbers(found: Identified) -> dict[str, Value]:
    fit, space = found.fit, found.experiment.space
    values = space.values(fit.z)
    numbers: dict[str, Value] = {p.name: values[p.name] for p in space.parameters}
    for parameter, left in zip(space.parameters, sigmas_left(fit).tolist(), strict=True):
        numbers[f"{parameter.name}_sigma_of_logarithm"] = left * parameter.sigma
    for figure, value in zip(found.experiment.figures, found.simulated.tolist(), strict=True):
        numbers[f"simulated {figure.label}"] = None if np.isnan(value) else value
    numbers["odometry_corner_deg"] = odometry_corner_deg(found)
    return numbers


def odometry_corner_deg(found: Identified) -> float:
    """Mean corner of the identified robot as its odometry has it."""
    turned = [row["odometry_corner_deg"] for row in found.rows if "odometry_corner_deg" in row]
    return float(np.mean(np.array(turned, dtype=np.float64)))


def _expected(found: Identified) -> FloatArray:
    """(f,) figures expected of the robot: closed form, corrected by the engine."""
    return found.fit.prediction.values


def _misses(figure: FigureConfig, value: float, sigma: float) -> float:
    """How many sigmas beyond the figure; 0 for a bound that is kept."""
    off = (value - figure.value) / sigma
    if figure.bound == "at_most":
        return max(off, 0.0)
    return min(off, 0.0) if figure.bound == "at_least" else off


def _verdicts(found: Identified) -> list[Verdict]:
    verdicts = []
    expected = _expected(found)
    for i, figure in enumerate(found.experiment.figures):
        off = _misses(figure, float(expected[i]), float(found.fit.sigmas[i]))
        verdicts.append(
            Verdict(
                f"The identified robot explains {figure.label}",
                "reality",
                abs(off) <= WITHIN_SIGMAS,
                f"{expected[i]:.3g} expected, {measured(figure)} measured: {off:+.1f} sigmas of "
                f"reading and chance",
            )
        )
    for scenario, others in found.left_out.items():
        offs = _offs_left_out(found, scenario, others)
        verdicts.append(
            Verdict(
                f"The figures of {_plain(scenario)} are as those of the others have them be",
                "reality",
                all(abs(off) <= WITHIN_SIGMAS for off in offs),
                ", ".join(f"{off:+.1f}" for off in offs) + " sigmas of what the others leave open",
            )
        )
    return verdicts


def _offs_left_out(found: Identified, scenario: str, others: Foreseen) -> list[float]:
    return [
        _misses(figure, float(others.means[i]), float(others.sigmas[i]))
        for i, figure in enumerate(found.experiment.figures)
        if figure.scenario == scenario
    ]


def _plain(scenario: str) -> str:
    return {"basic_drive": "the basic drive", "umbmark": "UMBmark", "ramp": "the ramp"}[scenario]


def measured(figure: FigureConfig) -> str:
    """The figure with its uncertainty, as text."""
    kind = {"at_most": "at most ", "at_least": "at least ", None: ""}[figure.bound]
    return f"{kind}{figure.value:g} ± {figure.sigma:g}"


def _figures_sheet(found: Identified) -> Sheet:
    figures = found.experiment.figures
    others = list(dict.fromkeys(name for figure in figures for name in figure.others))
    expected, fit = _expected(found), found.fit
    rows = tuple(
        (
            figure.label,
            measured(figure),
            f"{fit.prediction.chance[i]:.2g}",
            f"{expected[i]:.3g}",
            _or_blank(float(found.simulated[i])),
            _or_blank(float(found.nominal[i])),
            *(f"{figure.others[name]:g}" if name in figure.others else "" for name in others),
        )
        for i, figure in enumerate(figures)
    )
    header = (
        "figure",
        "measured",
        "chance",
        "identified, expected",
        "identified, driven",
        "as drawn, driven",
        *others,
    )
    note = (
        "Chance: standard deviation of the figure from one experiment of so many runs to the next. "
        "Expected: mean of many experiments in closed form, corrected by the physics engine. "
        f"Driven: mean of the experiments in the engine. Of the corner odometry sees "
        f"{odometry_corner_deg(found):.1f} degrees."
    )
    return Sheet("Figures", header, rows, note)


def _or_blank(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.3g}"


def _parameters_sheet(found: Identified) -> Sheet:
    fit, space = found.fit, found.experiment.space
    values, left = space.values(fit.z), sigmas_left(fit).tolist()
    rows = tuple(
        (
            parameter.words,
            parameter.shown(parameter.value, parameter.sigma),
            parameter.shown(values[parameter.name], left[i] * parameter.sigma),
            f"{100.0 * left[i]:.0f} %",
            parameter.why,
        )
        for i, parameter in enumerate(space.parameters)
    )
    header = ("parameter", "beforehand", "with the figures", "uncertainty left", "prior because")
    note = "A parameter that keeps 90 % or more of its uncertainty is a belief, not a finding."
    return Sheet("Parameters", header, rows, note)


def directions(found: Identified) -> list[tuple[float, list[tuple[Parameter, float]]]]:
    """Share of the prior variance that is left, and what moves together in that direction.

    Of the parameters that some figure tells of; from the best known combination to the least.
    """
    fit, space = found.fit, found.experiment.space
    touched = np.flatnonzero(sigmas_left(fit) <= UNTOUCHED)
    shares, axes = np.linalg.eigh(fit.covariance[np.ix_(touched, touched)])
    made = []
    for share, axis in zip(shares.tolist(), axes.T, strict=True):
        parts = [
            (space.parameters[touched[i]], float(axis[i]))
            for i in np.argsort(-np.abs(axis))
            if abs(axis[i]) >= PART_OF_IT
        ]
        made.append((share, parts))
    return made


def _directions_sheet(found: Identified) -> Sheet:
    rows = []
    for share, parts in directions(found):
        sign = np.sign(parts[0][1])
        words = ", ".join(
            f"{'more' if sign * weight > 0 else 'less'} {parameter.words.partition(',')[0]}"
            if len(parts) > 1
            else parameter.words
            for parameter, weight in parts
        )
        verdict = "well known" if share <= CLEAR else "known" if share <= OPEN else "hardly known"
        rows.append((words, f"{100.0 * share:.1f} %", verdict))
    header = ("parameters that move together", "prior variance left", "")
    note = (
        "Axes of the posterior in units of the priors, best known first. Along a hardly known axis "
        "the parameters can be exchanged for one another without any figure noticing."
    )
    return Sheet("What can be told apart", header, tuple(rows), note)


def _left_out_sheet(found: Identified) -> Sheet:
    rows = []
    for scenario, others in found.left_out.items():
        for i, figure in enumerate(found.experiment.figures):
            if figure.scenario == scenario:
                value, sigma = float(others.means[i]), float(others.sigmas[i])
                rows.append(
                    (
                        _plain(scenario),
                        figure.label,
                        measured(figure),
                        f"{value:.3g} ± {sigma:.2g}",
                        f"{_misses(figure, value, sigma):+.1f}",
                        f"{_expected(found)[i]:.3g}",
                    )
                )
    header = ("left out", "figure", "measured", "predicted", "off [sigmas]", "when fitted")
    note = "Predicted from the figures of the other scenarios alone, with priors."
    return Sheet("Leave one scenario out", header, tuple(rows), note)


def _others_sheet(found: Identified) -> Sheet:
    space, best = found.experiment.space, found.fits[0]
    rows = []
    for fit in found.fits:
        values = space.values(fit.z)
        odds = np.exp(_evidence(fit) - _evidence(best))
        figures = "; ".join(f"{value:.3g}" for value in fit.prediction.values)
        rows.append(
            (
                "the identified one" if fit is best else "another",
                f"{odds:.2g}",
                _differing(values, space.values(best.z)) if fit is not best else "",
                figures,
            )
        )
    header = ("robot", "odds", "how it differs", "figures, in the order above")
    note = (
        "Robots that explain the figures nearly as well, found from other starting points. Odds: "
        "of the evidence (Laplace), against the identified one."
    )
    return Sheet("Other explanations", header, tuple(rows), note)


def _differing(values: dict[ParameterName, float], best: dict[ParameterName, float]) -> str:
    apart = sorted(values, key=lambda name: -abs(np.log(values[name] / best[name])))
    return ", ".join(f"{name} {values[name]:.3g} for {best[name]:.3g}" for name in apart[:3])


def _evidence(fit: Fit) -> float:
    _, volume = np.linalg.slogdet(fit.covariance)
    return float(-fit.cost + 0.5 * volume - np.log(fit.sigmas).sum())


def _chart(found: Identified) -> Chart:
    """How far each figure is off, in its own sigmas: as drawn, left out, fitted."""
    figures, sigmas = found.experiment.figures, found.fit.sigmas
    places = np.arange(1.0, len(figures) + 1.0)

    def offs(values: FloatArray) -> FloatArray:
        return np.array(
            [
                _misses(f, float(v), float(s))
                for f, v, s in zip(figures, values, sigmas, strict=True)
            ]
        )

    left_out = np.array([found.left_out[f.scenario].means[i] for i, f in enumerate(figures)])
    series = (
        Series("as drawn", "slamsim", places, offs(found.nominal), "points"),
        Series("predicted without its scenario", "slamsim", places, offs(left_out), "points"),
        Series("identified", "slamsim", places, offs(_expected(found)), "points"),
        Series("measured", "reality", places, np.zeros_like(places), "line"),
    )
    names = ", ".join(f"{i}: {f.label}" for i, f in enumerate(figures, start=1))
    return Chart(
        "How far each figure is off",
        "figure",
        "off [sigmas of reading and chance]",
        series,
        note=names,
    )
