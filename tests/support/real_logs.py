"""Real laser logs beside the repository, for tests that are skipped where they are absent."""

from __future__ import annotations

from pathlib import Path

import pytest

RADISH = Path(__file__).parents[3] / "shared" / "data" / "radish"
needs_radish = pytest.mark.skipif(
    not RADISH.is_dir(), reason="the Radish logs are not at ../shared/data/radish"
)


def radish(name: str) -> tuple[Path, Path]:
    """The log of that name, and its relations."""
    return RADISH / name / f"{name}.clf.bz2", RADISH / name / f"{name}.relations"
