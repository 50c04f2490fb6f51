"""Findings of an identification (verdicts, numbers, tables, a chart), and the robot as YAML, with
the source of each number."""

from __future__ import annotations

import textwrap

import numpy as np
import yaml
from pydantic import BaseModel

from slamsim.config.robot import RobotConfig
from slamsim.core.types import FloatArray
from slamsim.scenarios.base import Chart, Findings, Series, Value, Verdict
from slamsim.scenarios.identify.fit import Foreseen, sigmas_left
from slamsim.scenarios.identify.identify import Identified
from slamsim.scenarios.identify.tables import (
    UNTOUCHED,
    directions_table,
    expected_figures,
    figures_table,
    left_out_table,
    measured,
    misses,
    odometry_corner_deg,
    others_table,
    parameters_table,
    plain_name,
    set_back_table,
)

WITHIN_SIGMAS = 2.0
"""95 % of normal numbers lie within."""


def identification_found(found: Identified) -> Findings:
    """The findings of an identification."""
    return Findings(
        summary=_summary(found),
        numbers=_numbers(found),
        verdicts=tuple(_verdicts(found)),
        tables=(
            figures_table(found),
            parameters_table(found),
            directions_table(found),
            set_back_table(found),
            left_out_table(found),
            others_table(found),
        ),
        charts=(_chart(found),),
    )


def _summary(found: Identified) -> str:
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


def _verdicts(found: Identified) -> list[Verdict]:
    verdicts = []
    expected = expected_figures(found)
    for i, figure in enumerate(found.experiment.figures):
        off = misses(figure, float(expected[i]), float(found.fit.sigmas[i]))
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
                f"The figures of {plain_name(scenario)} are as those of the others have them be",
                "reality",
                all(abs(off) <= WITHIN_SIGMAS for off in offs),
                ", ".join(f"{off:+.1f}" for off in offs) + " sigmas of what the others leave open",
            )
        )
    return verdicts


def _offs_left_out(found: Identified, scenario: str, others: Foreseen) -> list[float]:
    return [
        misses(figure, float(others.means[i]), float(others.sigmas[i]))
        for i, figure in enumerate(found.experiment.figures)
        if figure.scenario == scenario
    ]


def _chart(found: Identified) -> Chart:
    """How far each figure is off, in its own sigmas: as drawn, left out, fitted."""
    figures, sigmas = found.experiment.figures, found.fit.sigmas
    places = np.arange(1.0, len(figures) + 1.0)

    def offs(values: FloatArray) -> FloatArray:
        return np.array(
            [misses(f, float(v), float(s)) for f, v, s in zip(figures, values, sigmas, strict=True)]
        )

    left_out = np.array([found.left_out[f.scenario].means[i] for i, f in enumerate(figures)])
    series = (
        Series("as drawn", "slamsim", places, offs(found.nominal), "points"),
        Series("predicted without its scenario", "slamsim", places, offs(left_out), "points"),
        Series("identified", "slamsim", places, offs(expected_figures(found)), "points"),
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


_WIDTH = 96
_DIGITS = 6


def robot_file(found: Identified, command: str) -> str:
    """YAML of the keys in which the robot differs from the defaults, under what it was made of.

    command: that which wrote it.
    """
    figures, expected = found.experiment.figures, found.fit.prediction.values.tolist()
    space, left = found.experiment.space, sigmas_left(found.fit).tolist()
    values = space.values(found.fit.z)
    told, believed = list[str](), list[str]()
    for parameter, share in zip(space.parameters, left, strict=True):
        text = parameter.shown(values[parameter.name], share * parameter.sigma)
        (told if share <= UNTOUCHED else believed).append(f"{parameter.words}: {text}")
    lines = [
        f"Identified by {command}; every number below is written by it.",
        "",
        "Fitted to, as measured and as expected of this robot:",
        *(
            f"- {figure.label}: {measured(figure)}; {value:.3g}"
            for figure, value in zip(figures, expected, strict=True)
        ),
        "",
        "What the figures tell of:",
        *(f"- {text}" for text in told),
        "",
        "Believed beforehand, no figure tells of it:",
        *(f"- {text}" for text in believed),
        "",
        "droop is made by gear friction on a proportional motor controller: rim speed lost = wheel "
        "radius * gear_friction_n_m / pid_proportional.",
    ]
    comment = "".join(f"{line}\n" for text in lines for line in _commented(text))
    body = yaml.safe_dump(_changed(found.robot, RobotConfig()), sort_keys=False, width=_WIDTH)
    return f"{comment}\n{body}"


def _commented(text: str) -> list[str]:
    """Lines that begin with #; of a list, with its own lines set in."""
    inner = "  " if text.startswith("- ") else ""
    return [f"# {line}" for line in textwrap.wrap(text, _WIDTH, subsequent_indent=inner)] or ["#"]


def _changed(model: BaseModel, plain: BaseModel | None) -> dict[str, object]:
    """The keys whose values differ from those of ``plain``, numbers to six digits."""
    changed: dict[str, object] = {}
    for name in type(model).model_fields:
        value = getattr(model, name)
        usual = getattr(plain, name, None)
        if isinstance(value, BaseModel):
            inner = _changed(value, usual if isinstance(usual, BaseModel) else None)
            if inner:
                changed[name] = inner
        elif value != usual:
            changed[name] = _written(value)
    return {"name": changed.pop("name"), **changed} if "name" in changed else changed


def _written(value: object) -> object:
    if isinstance(value, float):
        return float(f"{value:.{_DIGITS}g}")
    return list(value) if isinstance(value, tuple) else value
