"""Software versions and CPU instructions on which the bytes of a data set depend."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version

from slamsim import __version__
from slamsim.process.instructions import has_avx2

_PACKAGES = (
    "numpy",
    "scipy",
    "numba",
    "pybullet",
    "open3d-cpu",
    "open3d",
    "shapely",
    "trimesh",
    "opencv-python-headless",
    "pyarrow",
    "mcap",
    "rosbags",
    "zstandard",
    "pydantic",
    "pyyaml",
    "matplotlib",
)


@cache
def versions() -> Mapping[str, str]:
    """Name and version of all that has a part in the bytes of a data set, here."""
    found = {"slamsim": __version__, "python": platform.python_version()}
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return {**found, "libc": " ".join(platform.libc_ver()), "machine": _machine()}


def _machine() -> str:
    lacking = platform.machine() == "x86_64" and not has_avx2()
    return f"{platform.system()} {platform.machine()}{' without AVX2' if lacking else ''}"


def difference(ours: Mapping[str, str], theirs: Mapping[str, str]) -> str:
    """In which the two differ, as words; empty if in nothing."""
    names = [name for name in {**ours, **theirs} if ours.get(name) != theirs.get(name)]
    return ", ".join(
        f"{name} {theirs.get(name, 'missing')} instead of {ours.get(name, 'none')}"
        for name in names
    )
