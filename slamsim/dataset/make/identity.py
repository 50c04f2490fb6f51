"""Identity of a data set: ``dataset.yaml``, written before anything else, and software versions."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Protocol

import yaml

from slamsim import __version__
from slamsim.dataset.store.store import Store
from slamsim.guard.errors import InputRefused, SlamsimError, shown
from slamsim.guard.seal import SUMS, SumsDamaged, read_sums, sha256_of
from slamsim.guard.yaml import parse_yaml
from slamsim.process.instructions import has_avx2

IDENTITY, RECIPE = "dataset.yaml", "recipe.yaml"
_KIND = "slamsim data set 1"


@dataclass(frozen=True, slots=True)
class Identity:
    """recipe: resolved, as plain values. sequences: how many there are to be."""

    name: str
    sequences: int
    recipe: Mapping[str, Any]

    def text(self) -> str:
        """The file's contents: the same for the same data set and software.

        Its last line is the end mark of YAML, by which a file that was cut is told.
        """
        told = {
            "kind": _KIND,
            "name": self.name,
            "sequences": self.sequences,
            "versions": dict(versions()),
            "recipe": dict(self.recipe),
        }
        return yaml.safe_dump(
            told, sort_keys=False, allow_unicode=True, width=100, explicit_end=True
        )


class ReadableStore(Protocol):
    """Where a data set can be read."""

    @property
    def address(self) -> str: ...

    def read(self, path: str) -> bytes | None: ...


def read_identity(store: ReadableStore) -> Mapping[str, Any] | None:
    """What ``dataset.yaml`` says, or nothing if there is none. Raises InputRefused if it is bad."""
    data = store.read(IDENTITY)
    if data is None:
        return None
    path = f"{store.address}/{IDENTITY}"
    told = parse_yaml(data.decode("utf-8", "replace"), Path(path)).data
    if not isinstance(told, dict) or told.get("kind") != _KIND:
        raise InputRefused(path, f"it does not begin with 'kind: {_KIND}'")
    return told


def require_place_for(store: Store, identity: Identity) -> None:
    """Raise SlamsimError unless the place is empty or holds this data set, perhaps fewer of it."""
    data = store.read(IDENTITY)
    if data is None:
        if not _has_checksum(store, identity):
            require_empty(store)
        return
    if identity.text().encode().startswith(data):  # the same, or cut while it was written
        return
    found = read_identity(store)
    assert found is not None
    if found.get("name") != identity.name or found.get("recipe") != identity.recipe:
        raise SlamsimError(
            f"{store.address} holds another data set ({_first_difference(found, identity)}); "
            "choose another place"
        )
    if differs := difference(found.get("versions", {}), versions()):
        raise SlamsimError(
            f"{store.address} was begun with other software: here is {differs}; "
            "go on with the same versions, or choose another place"
        )
    if found.get("sequences", 0) > identity.sequences:
        raise SlamsimError(
            f"{store.address} is to have {found['sequences']} sequences, more than the "
            f"{identity.sequences} asked for; it can grow, not shrink"
        )


def require_empty(store: Store) -> None:
    """Raise SlamsimError if there is anything in a place."""
    if others := sorted(store.names("")):
        raise SlamsimError(
            f"{store.address} holds files that are no data set, such as {shown(others[0])}; "
            "choose another place"
        )


def _has_checksum(store: ReadableStore, identity: Identity) -> bool:
    """Whether the finished data set that lies there was this very one, though its file be lost."""
    try:
        hashes = read_sums(store.read(SUMS) or b"")
    except SumsDamaged:
        return False
    return hashes.get(IDENTITY) == sha256_of(identity.text().encode())


def claim(store: Store, identity: Identity) -> None:
    """Write ``dataset.yaml``, unless it is there as it is to be.

    Where another is there, the data set grows: it is not finished, so nothing says so any more.
    """
    text, found = identity.text().encode(), store.read(IDENTITY)
    if found == text:
        return
    if found is not None:
        store.remove(SUMS)
    store.write(IDENTITY, text)


def _first_difference(found: Mapping[str, Any], identity: Identity) -> str:
    if found.get("name") != identity.name:
        return f"its name is {shown(found.get('name'))}, not {shown(identity.name)}"
    recipe = found.get("recipe") or {}
    for key in {**recipe, **identity.recipe}:
        if recipe.get(key) != identity.recipe.get(key):
            return f"{key} of its recipe is {shown(recipe.get(key))}"
    return "its recipe is another"


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
