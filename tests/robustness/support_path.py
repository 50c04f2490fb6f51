"""For programs in this folder: modules of the other folders of tests can be imported."""

from __future__ import annotations

import sys
from pathlib import Path

_TESTS = Path(__file__).parents[1]
sys.path += [str(folder) for folder in sorted(_TESTS.iterdir()) if folder.is_dir()]
