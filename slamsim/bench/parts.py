"""The parts of ``slamsim bench``, and which options of the command line each uses."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from slamsim.guard.errors import OverrideRefused, SlamsimError

_DRIVE = ("--set", "--config", "--seed", "--world", "--seconds", "--path")
_SPEED = (*_DRIVE, "--repeats")
_CHECK = ("--seed", "--seconds", "--clean", "--faults", "--workers", "--logs")
USED: Mapping[str, Sequence[str]] = {
    **dict.fromkeys(("all", "sense", "drive", "simulate", "slam"), _SPEED),
    "slam --peers": (*_DRIVE, "--peers", "--logs"),
    "accuracy": (*_DRIVE, "--seeds", "--workers", "--logs", "--bound"),
    "matcher": (*_DRIVE, "--logs"),
    "matcher --recording": ("--set", "--config", "--recording"),
    "check": (*_CHECK, "--seeds", "--pairs", "--curves", "--long"),
    "check --recording": (*_CHECK, "--recording", "--long"),
    "check --independent": (*_CHECK, "--seeds", "--independent", "--pairs", "--mutations", "--fix"),
    "check --cameras": (*_CHECK, "--seeds", "--cameras"),
    "dataset": ("--config", "--seeds"),
    "robustness": ("--seed", "--cases", "--workers", "--logs"),
    "robustness --only": ("--seed", "--only", "--logs"),
    "online": ("--set", "--config", "--seed", "--world", "--path"),
    "live": ("--set", "--config", "--seed", "--world", "--seconds"),
    "cameras": _DRIVE,
}
"""Options of each part, and of what an option makes of it, beside --quiet and --json, which all
use."""


def require_used(part: str, given: Collection[str]) -> None:
    """Raise SlamsimError for a part that there is not, OverrideRefused for an option that it would
    ignore: who gives it expects another measurement. given: names of options."""
    if part not in USED:
        known = ", ".join(name for name in USED if " " not in name)
        raise SlamsimError(f"there is no bench {part!r}; choose from {known}")
    variant = next((f"{part} {option}" for option in given if f"{part} {option}" in USED), part)
    used = USED[variant]
    for option in given:
        if option not in (*used, "--quiet", "--json"):
            reason = f"bench {variant} does not use it; it uses {', '.join(used)}"
            raise OverrideRefused(option, reason)
