"""Writes the identified robot as YAML, with the source of each number."""

from __future__ import annotations

import textwrap

import yaml
from pydantic import BaseModel

from slamsim.config.robot import RobotConfig
from slamsim.scenarios.identify.fit import sigmas_left
from slamsim.scenarios.identify.identify import Identified
from slamsim.scenarios.identify.tables import UNTOUCHED, measured

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
