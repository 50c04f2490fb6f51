"""One colour for one meaning, in the recording and in the report (Okabe & Ito 2008).

The eight colours are told apart by people with every common kind of colour vision.
"""

from __future__ import annotations

ESTIMATE = "#0072b2"
ODOMETRY = "#e69f00"
TRUTH = "#009e73"
ACCEPTED = "#cc79a7"
WITHDRAWN = "#d55e00"
SCAN = "#56b4e9"
NEUTRAL = "#8a8f98"


def rgb(colour: str) -> tuple[int, int, int]:
    """0..255 each, of ``#rrggbb``."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
