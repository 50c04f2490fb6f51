"""Restricts results to CPU instructions that all x86-64 processors since 2013 have."""

from __future__ import annotations

import os
import platform
from typing import Any

_SAME = {"NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR", "OPENBLAS_CORETYPE": "Haswell"}
"""NumPy's sine and OpenBLAS's products differ in the last bit where there is AVX-512."""


def settle_instructions() -> None:
    """Have processes that are begun from here on compute with AVX2 and FMA, whatever is newer.

    So the same work gives the same bytes on every x86-64 processor that has these.
    """
    if platform.machine() == "x86_64" and has_avx2():
        os.environ.update(_SAME)


def has_avx2() -> bool:
    """Whether this processor, of the kind x86-64, has AVX2 and FMA."""
    import numpy as np

    config: Any = np.show_config(mode="dicts")
    return "X86_V3" in config["SIMD Extensions"]["found"]
