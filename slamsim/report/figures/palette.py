"""Colours: one per meaning, the same in the Rerun recording and in the report.

After Okabe & Ito (2008), whose colours people with every common kind of colour vision tell apart;
the blue is a little lighter than theirs, to be seen on black as well.
"""

from __future__ import annotations

ESTIMATE = "#1a82c9"
ODOMETRY = "#e69f00"
TRUTH = "#009e73"
ACCEPTED = "#cc79a7"
WITHDRAWN = "#d55e00"
SCAN = "#56b4e9"
NEUTRAL = "#8a8f98"
INK = "#1b1f24"


def rgb(colour: str) -> tuple[int, int, int]:
    """0..255 each, of ``#rrggbb``."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
