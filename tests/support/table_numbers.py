"""Whether each number of a printed table stands in what ``--json`` gives, under a key of the same
unit."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

_NUMBER = re.compile(
    r"(?<![\w.:/,-])([+-]?\d[\d,]*(?:\.\d+)?(?:e[+-]?\d+)?)(?:\s?([a-zA-Zµ°%×²/]+))?"
)
_KEYED: Mapping[str, Sequence[tuple[str, float]]] = {
    "m": [("_m", 1.0), ("_mm", 1e-3)],
    "mm": [("_m", 1e3), ("_mm", 1.0)],
    "km": [("_km", 1.0)],
    "%": [("_share", 100.0), ("_percent", 1.0), ("", 100.0)],
    "s": [("_s", 1.0), ("_ns", 1e-9), ("seconds", 1.0), ("_h", 3600.0)],
    "ms": [("_s", 1e3), ("_ms", 1.0)],
    "°": [("_deg", 1.0), ("_rad", math.degrees(1.0))],
    "°/m": [("_per_m", 1.0), ("_per_m", math.degrees(1.0))],
    "mrad": [("_mrad", 1.0)],
    "mrad/s": [("_rad_s", 1e3)],
    "rad": [("_rad", 1.0)],
}
_DECIMAL = {"B": 1.0, "kB": 1e-3, "MB": 1e-6, "GB": 1e-9}


def leaves(value: object, key: str = "") -> Iterator[tuple[str, float]]:
    """Every number under the key nearest to it; text and lists also by the numbers in them."""
    if isinstance(value, Mapping):
        for inner, each in value.items():
            yield from leaves(each, f"{key}.{inner}")
    elif isinstance(value, list | tuple):
        yield key, float(len(value))
        if key.endswith(".interval") and None not in value:  # shown as value ± half
            yield key, 0.5 * (value[1] - value[0])
        for each in value:
            yield from leaves(each, key)
    elif isinstance(value, str):
        yield from ((key, float(n.replace(",", ""))) for n, _ in _NUMBER.findall(value))
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield key, float(value)


def step_of(shown: str) -> float:
    """Half of the last digit that is shown, and what a double rounding of it adds."""
    digits = shown.replace(",", "").lower().partition("e")
    places = len(digits[0].partition(".")[2])
    return 0.505 * 10.0 ** (int(digits[2] or 0) - places)


def is_there(shown: str, unit: str, known: Sequence[tuple[str, float]]) -> bool:
    number = float(shown.replace(",", ""))
    near = step_of(shown)

    def is_it(value: float) -> bool:
        return abs(abs(value) - abs(number)) <= near

    if unit in _DECIMAL:
        sizes = (v * _DECIMAL[unit] for key, v in known if has_unit(key, "bytes"))
        mb = (v for key, v in known if key.endswith("_mb") and unit == "MB")
        return any(abs(v - number) <= near for v in (*sizes, *mb))
    for ending, factor in _KEYED.get(unit, ()):
        if any(is_it(v * factor) for key, v in known if has_unit(key, ending)):
            return True
    if unit == "%" and any(is_it(100.0 * (v - 1.0)) for key, v in known if "_scale" in key):
        return True
    return any(is_it(value) for _, value in known)


def has_unit(key: str, ending: str) -> bool:
    return any(part.endswith(ending) for part in key.split("."))


INTERVAL = re.compile(r"([\d.,]+) ± ([\d.,]+) (\S+?)(?=,|\s|$)")
DURATION = re.compile(r"\b(?:(\d+) days ?)?(?:(\d+) h ?)?(?:(\d+) min ?)?(?:(\d+) s)?\b")


def without_durations(line: str, known: Sequence[tuple[str, float]]) -> str:
    """A line without the times in two units, which are looked up here."""

    def looked_up(match: re.Match[str]) -> str:
        parts = [int(part or 0) for part in match.groups()]
        if sum(part is not None for part in match.groups()) < 2:
            return match[0]
        seconds = sum(n * size for n, size in zip(parts, (86400, 3600, 60, 1), strict=True))
        near = [v for ending, f in _KEYED["s"] for key, v in known if has_unit(key, ending)
                if abs(v * f - seconds) <= 60]  # fmt: skip
        return "" if near else match[0]

    return DURATION.sub(looked_up, line)


SAID = re.compile(
    r"within one cell|NEES (?:in map )?inside 95|within their 95 % ellipse|\(95 %\)"
    r"|covariances: 3\b|on each core|scans placed in the map; .*|the median"
)
"""Numbers that are words of a sentence."""


def numbers_without_source(
    printed: str, results: Sequence[Mapping[str, object]], places: Sequence[Path]
) -> list[tuple[str, str, str]]:
    """Line, number and unit of all that is printed and stands in no result; names of folders,
    of the places, are left out."""
    known = [leaf for values in results for leaf in leaves(values)]
    wrong = []
    for line in printed.splitlines():
        plain = line
        for place in places:
            plain = plain.replace(str(place), "")
        plain = INTERVAL.sub(r"\1 \3 \2 \3", plain)
        plain = without_durations(SAID.sub("", plain), known)
        wrong += [(line, shown, unit) for shown, unit in _NUMBER.findall(plain)
                  if not is_there(shown, unit, known)]  # fmt: skip
    return wrong
