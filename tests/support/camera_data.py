"""Real frames of cameras for tests, where there are any: CONTRIBUTING.md says what lies there."""

from __future__ import annotations

from pathlib import Path

import pytest

_ROOT = Path(__file__).parents[3] / "shared" / "data" / "cameras"
LIVINGROOM = _ROOT / "livingroom"
REDWOOD_TABLE = _ROOT / "redwood-depth-dist-model.npy"


def needs(path: Path) -> pytest.MarkDecorator:
    """Skip a test where this is not there, and say how it would be found."""
    reason = f"there is no {path.name} in ../shared/data/cameras"
    return pytest.mark.skipif(not path.exists(), reason=reason)
