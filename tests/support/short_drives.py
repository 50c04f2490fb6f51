"""Programs and notebooks run as they are written, but for the length of their simulated drives."""

from __future__ import annotations

from typing import Any

import pytest

from slamsim.cli import common

SHORT = "drive.route.max_duration_s=8"
"""Scans of one place and of the next; a whole drive through ``tiny`` takes over a minute."""


def cut_drives_short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of simulated worlds; what a program itself says of the length is heeded."""
    config_of = common.config_of

    def shorter(world: str | None, config: Any, overrides: list[str] | None, *rest: Any) -> Any:
        first = [] if world is None else [SHORT]
        return config_of(world, config, [*first, *(overrides or ())], *rest)

    monkeypatch.setattr(common, "config_of", shorter)
