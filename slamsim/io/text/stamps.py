"""Stamps as exact integers, parsed from any notation."""

from __future__ import annotations

from decimal import Decimal, InvalidOperation

from slamsim.guard.errors import shown
from slamsim.guard.numbers import MOST_NS


def stamp_ns_from_decimal(seconds: str) -> int:
    """Decimal seconds to nanoseconds without passing through a float; digits beyond are cut.

    Raises ValueError for anything that is not a finite decimal number within ``MOST_NS`` of 0.
    """
    whole, _, fraction = seconds.partition(".")
    if whole.isdecimal() and (fraction.isdecimal() or not fraction) and len(whole) < 10 + 1:
        stamp_ns = int(whole) * 1_000_000_000 + int(fraction[:9].ljust(9, "0"))
    else:
        stamp_ns = _from_decimal(seconds)
    if abs(stamp_ns) > MOST_NS:
        raise ValueError(f"{shown(seconds)} s does not fit into nanoseconds of 64 bits")
    return stamp_ns


def _from_decimal(seconds: str) -> int:
    try:
        value = Decimal(seconds)
        if not value.is_finite() or value.adjusted() > 11:
            raise ValueError(f"{shown(seconds)} is not a stamp in seconds")
        return 0 if value.adjusted() < -9 else int(value.scaleb(9))
    except InvalidOperation:
        raise ValueError(f"{shown(seconds)} is not a stamp in seconds") from None


def decimal_from_stamp_ns(stamp_ns: int) -> str:
    """Seconds with all nine decimals: the inverse of ``stamp_ns_from_decimal``."""
    sign, magnitude = ("-", -stamp_ns) if stamp_ns < 0 else ("", stamp_ns)
    return f"{sign}{magnitude // 1_000_000_000}.{magnitude % 1_000_000_000:09d}"
