"""Collects the lines of a CARMEN log: laser channels, odometry, parameters, anomalies."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from slamsim.guard.errors import InputRefused, printable
from slamsim.guard.text import open_lines
from slamsim.io.carmen.lines import (
    LaserLine,
    OdomLine,
    parse_configured,
    parse_flaser,
    parse_odom,
)
from slamsim.io.input_errors import damaged

_OTHER_MESSAGES = ("SYNC", "TRUEPOS", "NMEAGGA", "NMEARMC", "SONAR", "BUMPER", "MARKER", "IMU")
_LASERS = ("FLASER", "RLASER", *(f"{kind}LASER{i}" for kind in ("ROBOT", "RAW") for i in "12345"))
MEASURING = frozenset((*_LASERS, "ODOM"))


@dataclass(slots=True)
class CarmenContent:
    """lasers: the lines of each laser message, in file order. odometry: ODOM lines likewise.

    malformed: how many lines could not be read. first_malformed: the first of them, in words.
    """

    lasers: dict[str, list[LaserLine]] = field(default_factory=dict)
    odometry: list[OdomLine] = field(default_factory=list)
    parameters: dict[str, str] = field(default_factory=dict)
    ignored: Counter[str] = field(default_factory=Counter)
    malformed: int = 0
    first_malformed: str = ""


def parse_line(words: list[str]) -> LaserLine | OdomLine | None:
    """What a line measures, None for one of another kind; ValueError if it is no CARMEN line."""
    name = words[0]
    if name == "ODOM":
        return parse_odom(words)
    if name in _LASERS:
        return (parse_flaser if name in ("FLASER", "RLASER") else parse_configured)(words)
    if name == "PARAM" and len(words) < 3:
        raise ValueError("a PARAM without a value")
    if not (name.rstrip("0123456789-").isupper() or name.startswith(_OTHER_MESSAGES)):
        raise ValueError(f"{name[:30]!r} is not a CARMEN message")
    return None


def _take_line(content: CarmenContent, words: list[str]) -> None:
    name, line = words[0], parse_line(words)
    if isinstance(line, OdomLine):
        content.odometry.append(line)
    elif line is not None:
        content.lasers.setdefault(name, []).append(line)
    elif name == "PARAM":
        content.parameters[words[1]] = words[2]
    else:
        content.ignored[printable(name[:30])] += 1


def collect(path: Path) -> CarmenContent:
    """Reads every line of a file; raises as ``open_lines`` does, and InputRefused when nothing is
    a CARMEN message.

    A line that cannot be read is counted and left out.
    """
    content = CarmenContent()
    number = 0
    for number, line in _lines(path):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            _take_line(content, words)
        except ValueError as error:
            content.malformed += 1
            if content.malformed == 1:
                content.first_malformed = f"line {number}: {error}"
    if not (content.lasers or content.odometry):
        if number == 0:
            raise InputRefused(path, "the file is empty; a CARMEN log has FLASER and ODOM lines")
        seen = content.first_malformed or f"{number} lines without a laser or odometry message"
        raise InputRefused(path, f"this is not a CARMEN log with FLASER and ODOM lines ({seen})")
    return content


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    try:
        yield from open_lines(path)
    except InputRefused as refusal:
        if not refusal.where:
            raise
        raise damaged(path, refusal.reason, refusal.where, refusal) from None
