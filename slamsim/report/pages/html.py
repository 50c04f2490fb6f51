"""The report's HTML: a few building blocks and one style sheet. All text given is escaped."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from slamsim.report.figures.run import Picture


@dataclass(frozen=True, slots=True)
class Card:
    """One number that matters: what it is, the number with its unit, and its context."""

    name: str
    value: str
    context: str


@dataclass(frozen=True, slots=True)
class Table:
    """words: cells hold sentences, which wrap; on a narrow screen each row is a list of them."""

    header: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    words: bool = False


RUN_FOOTER = (
    "Made by slamsim. All numbers, under stable keys, are in report.json beside this file; "
    "slamsim view opens the recording."
)


def page(title: str, lead: str, body: str, footer: str = RUN_FOOTER, style: str = "") -> str:
    """body: HTML; style: CSS of its own. The policy forbids the page to fetch anything at all."""
    return str(_blocks().page(title, lead, body, footer, style))


def section(title: str, body: str) -> str:
    """A headed part of the page; nothing at all for an empty body (HTML)."""
    return str(_blocks().section(title, body))


def cards(items: Sequence[Card]) -> str:
    return str(_blocks().cards(items))


def figure(picture: Picture, caption: str, wide: bool = False, zoom: bool = False) -> str:
    """zoom: with a box that enlarges it fourfold, to be moved about."""
    return str(_blocks().figure(picture, caption, wide, zoom))


def pair(figures: Sequence[str], paper: bool = False) -> str:
    """Figures side by side where there is room, nothing for none; paper: on a light ground."""
    return str(_blocks().pair([Markup(one) for one in figures], paper))


def table(content: Table, note: str = "") -> str:
    return str(_blocks().table(content, note))


def gauge(interval: tuple[float, float], limit: float | None) -> str:
    """A value in the middle of its interval on a scale from 0 or below, with the limit on the
    side, or sides, where the interval lies; nothing for numbers that are not finite."""
    low, high = interval
    marks = (
        [] if limit is None else [one for one in (-limit, limit) if one * low > 0 or one * high > 0]
    )
    begin, end = min(0.0, low, *marks), max(0.0, high, *marks)
    if not (math.isfinite(begin) and math.isfinite(end) and end > begin):
        return ""
    return Markup(_blocks().gauge(low, 0.5 * (low + high), high, begin, end, marks))


def warnings(texts: Sequence[str]) -> str:
    return str(_blocks().warnings(texts))


def details(summary: str, text: str) -> str:
    """Preformatted text that is folded away."""
    return str(_blocks().details(summary, text))


@cache
def _blocks() -> Any:
    """The macros of ``blocks.html.jinja``."""
    loader = jinja2.FileSystemLoader(Path(__file__).parent)
    environment = jinja2.Environment(
        loader=loader, autoescape=True, undefined=jinja2.StrictUndefined
    )
    environment.globals["zip"] = partial(zip, strict=True)
    return environment.get_template("blocks.html.jinja").module
