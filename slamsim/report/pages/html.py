"""The report's HTML: a few building blocks and one style sheet. All text given is escaped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from slamsim.report.figures.run import Picture

_STYLE = """
:root { color-scheme: light dark; --ink: #1b1f24; --soft: #5b6470; --paper: #ffffff;
  --card: #f4f6f8; --line: #dfe3e8; --accent: #0072b2; --warn: #fff4e0; --warn-line: #e69f00; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e9ee; --soft: #9aa4b1; --paper: #14171b;
  --card: #1d2127; --line: #2c323a; --accent: #56b4e9; --warn: #2b2415; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 1180px; padding: 2rem 1.25rem 4rem; color: var(--ink);
  background: var(--paper); line-height: 1.5;
  font-family: system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", sans-serif; }
h1 { margin: 0; font-size: 1.9rem; line-height: 1.2; letter-spacing: -0.02em;
  overflow-wrap: anywhere; }
h2 { margin: 2.5rem 0 0.9rem; font-size: 1.15rem; }
.lead { margin: 0.5rem 0 1.5rem; max-width: 46rem; color: var(--soft); font-size: 1.05rem; }
.cards { display: grid; gap: 0.75rem;
  grid-template-columns: repeat(auto-fill, minmax(150px, 1fr)); }
.card { padding: 0.8rem 1rem; border-radius: 10px; background: var(--card); }
.card .name, .card .context { color: var(--soft); font-size: 0.8rem; }
.card .value { font-size: 1.5rem; font-weight: 600; font-variant-numeric: tabular-nums;
  white-space: nowrap; }
.pair { display: grid; gap: 1rem;
  grid-template-columns: repeat(auto-fit, minmax(min(420px, 100%), 1fr)); }
figure { margin: 0; padding: 0.75rem; border: 1px solid var(--line); border-radius: 10px; }
figure.wide { max-width: 700px; }
figcaption { font-size: 0.85rem; font-weight: 600; }
.legend { display: flex; flex-wrap: wrap; gap: 0.1rem 1rem; margin: 0.25rem 0 0.5rem; padding: 0;
  list-style: none; color: var(--soft); font-size: 0.78rem; }
.legend i { display: inline-block; width: 1.1em; height: 0.3em; margin-right: 0.4em;
  border-radius: 2px; vertical-align: middle; }
.paper .legend { color: #4a525c; }
figure svg { display: block; width: 100%; height: auto; }
figure svg text { font-family: inherit !important; }
.paper figure { background: #eceef1; color: #1b1f24; border-color: transparent; }
.paper image { image-rendering: pixelated; }
.scroll { margin-top: 1.25rem; overflow-x: auto; }
h2 + .scroll { margin-top: 0; }
table { border-collapse: collapse; font-size: 0.9rem; font-variant-numeric: tabular-nums; }
th, td { padding: 0.35rem 1.1rem 0.35rem 0; border-bottom: 1px solid var(--line);
  text-align: right; white-space: nowrap; }
th { color: var(--soft); font-weight: 500; }
th:first-child, td:first-child { text-align: left; }
.note { margin: 0.6rem 0 0; max-width: 46rem; color: var(--soft); font-size: 0.85rem; }
.warnings { margin: 1.5rem 0 0; padding: 0.8rem 1rem 0.8rem 2rem; border-radius: 10px;
  border-left: 4px solid var(--warn-line); background: var(--warn); }
pre { margin: 0; padding: 0.9rem 1rem; overflow-x: auto; border-radius: 10px;
  background: var(--card); font-size: 0.85rem; }
details { margin-top: 0.75rem; }
summary { cursor: pointer; color: var(--accent); }
details pre { margin-top: 0.6rem; }
footer { margin-top: 3rem; color: var(--soft); font-size: 0.8rem; }
"""


@dataclass(frozen=True, slots=True)
class Card:
    """One number that matters: what it is, the number with its unit, and its context."""

    name: str
    value: str
    context: str


@dataclass(frozen=True, slots=True)
class Table:
    header: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


RUN_FOOTER = (
    "Made by slamsim. All numbers, under stable keys, are in report.json beside this file; "
    "slamsim view opens the recording."
)


def page(title: str, lead: str, body: str, footer: str = RUN_FOOTER, style: str = "") -> str:
    """body: HTML; style: CSS of its own. The policy forbids the page to fetch anything at all."""
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy"
  content="default-src 'none'; style-src 'unsafe-inline'; img-src data:">
<title>{escape(title)} · slamsim</title>
<style>{_STYLE}{style}</style>
</head>
<body>
<header><h1>{escape(title)}</h1><p class="lead">{escape(lead)}</p></header>
<main>{body}</main>
<footer>{escape(footer)}</footer>
</body>
</html>
"""


def section(title: str, body: str) -> str:
    """A headed part of the page; nothing at all for an empty body (HTML)."""
    return f"<section><h2>{escape(title)}</h2>{body}</section>" if body else ""


def cards(items: Sequence[Card]) -> str:
    made = "".join(
        f'<div class="card"><div class="name">{escape(card.name)}</div>'
        f'<div class="value">{escape(card.value)}</div>'
        f'<div class="context">{escape(card.context)}</div></div>'
        for card in items
    )
    return f'<div class="cards">{made}</div>'


def figure(picture: Picture, caption: str, wide: bool = False) -> str:
    kind = ' class="wide"' if wide else ""
    legend = "".join(
        f'<li><i style="background:{escape(colour)}"></i>{escape(name)}</li>'
        for name, colour in picture.legend
    )
    return (
        f"<figure{kind}><figcaption>{escape(caption)}</figcaption>"
        f'<ul class="legend">{legend}</ul>{picture.svg}</figure>'
    )


def pair(figures: Sequence[str], paper: bool = False) -> str:
    """Figures side by side where there is room, nothing for none; paper: on a light ground."""
    kind = "pair paper" if paper else "pair"
    return f'<div class="{kind}">{"".join(figures)}</div>' if figures else ""


def table(content: Table, note: str = "") -> str:
    header = "".join(f"<th>{escape(cell)}</th>" for cell in content.header)
    rows = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>"
        for row in content.rows
    )
    below = f'<p class="note">{escape(note)}</p>' if note else ""
    return (
        f'<div class="scroll"><table><thead><tr>{header}</tr></thead>'
        f"<tbody>{rows}</tbody></table></div>{below}"
    )


def warnings(texts: Sequence[str]) -> str:
    items = "".join(f"<li>{escape(text)}</li>" for text in texts)
    return f'<ul class="warnings" aria-label="Warnings">{items}</ul>' if items else ""


def details(summary: str, text: str) -> str:
    """Preformatted text that is folded away."""
    return (
        f"<details><summary>{escape(summary)}</summary>"
        f"<pre><code>{escape(text)}</code></pre></details>"
    )
