"""The tables of an identification."""

from __future__ import annotations

import numpy as np

from slamsim.config.measurements import FigureConfig, ParameterName
from slamsim.core.types import FloatArray
from slamsim.scenarios.base import ResultTable
from slamsim.scenarios.identify.fit import RobotFit, sigmas_left
from slamsim.scenarios.identify.identify import Identified
from slamsim.scenarios.identify.model import Parameter

UNTOUCHED = 0.9
"""A parameter that keeps so much of its prior uncertainty is not told of by any figure."""
OPEN = 0.5
"""A combination that keeps so much of its prior variance is hardly told of."""
CLEAR = 0.05
"""One that keeps so little is what the figures really measure."""
PART_OF_IT = 0.3
"""Of a unit vector: a parameter with a smaller share is left out of the words."""


def odometry_corner_deg(found: Identified) -> float:
    """Mean corner of the identified robot as its odometry has it."""
    turned = [row["odometry_corner_deg"] for row in found.rows if "odometry_corner_deg" in row]
    return float(np.mean(np.array(turned, dtype=np.float64)))


def expected_figures(found: Identified) -> FloatArray:
    """(f,) figures expected of the robot: closed form, corrected by the engine."""
    return found.fit.prediction.values


def misses(figure: FigureConfig, value: float, sigma: float) -> float:
    """How many sigmas beyond the figure; 0 for a bound that is kept."""
    off = (value - figure.value) / sigma
    if figure.bound == "at_most":
        return max(off, 0.0)
    return min(off, 0.0) if figure.bound == "at_least" else off


def plain_name(scenario: str) -> str:
    """A scenario as a sentence names it."""
    return {"basic_drive": "the basic drive", "umbmark": "UMBmark", "ramp": "the ramp"}[scenario]


def measured(figure: FigureConfig) -> str:
    """The figure with its uncertainty, as text."""
    kind = {"at_most": "at most ", "at_least": "at least ", None: ""}[figure.bound]
    return f"{kind}{figure.value:g} ± {figure.sigma:g}"


def figures_table(found: Identified) -> ResultTable:
    """Every figure as measured, as of the identified robot, as drawn, and as others have it."""
    figures = found.experiment.figures
    others = list(dict.fromkeys(name for figure in figures for name in figure.others))
    expected, fit = expected_figures(found), found.fit
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
    return ResultTable("Figures", header, rows, note)


def _or_blank(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.3g}"


def parameters_table(found: Identified) -> ResultTable:
    """What was believed of each parameter, and what the figures make of that."""
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
    return ResultTable("Parameters", header, rows, note)


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


def directions_table(found: Identified) -> ResultTable:
    """The axes of the posterior in words."""
    rows = []
    for share, parts in directions(found):
        sign = np.sign(parts[0][1])
        words = ", ".join(
            f"{'more' if sign * weight > 0 else 'less'} {parameter.short}"
            for parameter, weight in parts
        )
        verdict = "well known" if share <= CLEAR else "known" if share <= OPEN else "hardly known"
        rows.append((words, f"{100.0 * share:.1f} %", verdict))
    header = ("parameters that move together", "prior variance left", "")
    note = (
        "Axes of the posterior in units of the priors, best known first. Along a hardly known axis "
        "the parameters can be exchanged for one another without any figure noticing."
    )
    return ResultTable("What can be told apart", header, tuple(rows), note)


def set_back_table(found: Identified) -> ResultTable:
    """What each parameter does to the figures."""
    experiment, z = found.experiment, found.fit.z
    rows = [("as found", *(f"{value:.3g}" for value in expected_figures(found)))]
    for i in np.flatnonzero(sigmas_left(found.fit) <= UNTOUCHED):
        back = z.copy()
        back[i] = 0.0
        figures = (f"{value:.3g}" for value in experiment.predict(back).values)
        rows.append((experiment.space.parameters[i].words, *figures))
    header = ("set back", *(figure.label for figure in experiment.figures))
    note = (
        "Each parameter set back to what was believed beforehand, all others as found: the figures "
        "that move are those that tell of it."
    )
    return ResultTable("Which figure tells of what", header, tuple(rows), note)


def left_out_table(found: Identified) -> ResultTable:
    """What the figures of the other scenarios have each scenario be."""
    rows = []
    for scenario, others in found.left_out.items():
        for i, figure in enumerate(found.experiment.figures):
            if figure.scenario == scenario:
                value, sigma = float(others.means[i]), float(others.sigmas[i])
                rows.append(
                    (
                        plain_name(scenario),
                        figure.label,
                        measured(figure),
                        f"{value:.3g} ± {sigma:.2g}",
                        f"{misses(figure, value, sigma):+.1f}",
                        f"{expected_figures(found)[i]:.3g}",
                    )
                )
    header = ("left out", "figure", "measured", "predicted", "off [sigmas]", "when fitted")
    note = "Predicted from the figures of the other scenarios alone, with priors."
    return ResultTable("Leave one scenario out", header, tuple(rows), note)


def others_table(found: Identified) -> ResultTable:
    """The other maxima of the posterior."""
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
    return ResultTable("Other explanations", header, tuple(rows), note)


def _differing(values: dict[ParameterName, float], best: dict[ParameterName, float]) -> str:
    apart = sorted(values, key=lambda name: -abs(np.log(values[name] / best[name])))
    return ", ".join(f"{name} {values[name]:.3g} for {best[name]:.3g}" for name in apart[:3])


def _evidence(fit: RobotFit) -> float:
    _, volume = np.linalg.slogdet(fit.covariance)
    return float(-fit.cost + 0.5 * volume - np.log(fit.sigmas).sum())
