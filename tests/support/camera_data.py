"""Real frames of cameras for tests, where there are any: CONTRIBUTING.md says what lies there."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

_ROOT = Path(os.environ.get("SLAMSIM_CAMERA_DATA", "camera-data"))
LIVINGROOM = _ROOT / "livingroom"
REDWOOD_TABLE = _ROOT / "redwood-depth-dist-model.npy"


def needs(path: Path) -> pytest.MarkDecorator:
    """Skip a test where this is not there, and say how it would be found."""
    reason = f"there is no {path.name}: SLAMSIM_CAMERA_DATA names the folder that holds it"
    return pytest.mark.skipif(not path.exists(), reason=reason)
