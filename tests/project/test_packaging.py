"""What is declared for installation is what the package imports, and nothing besides."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterable
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from sources import imports_of

import slamsim

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
OPTIONAL = {"dask": "cluster", "distributed": "cluster", "gymnasium": "gym"} | dict.fromkeys(
    ("genz-icp", "karto-scanmatcher", "small-gicp"), "peers"
)
"""Distributions that some part alone needs, and the extra that brings them."""
NOT_IMPORTED = {"paramiko": "fsspec", "s3fs": "fsspec"}
"""Distributions that others of ours load by name."""
OF_ROS = {"rclpy", "rcl_interfaces", "launch", "launch_ros"}
"""Modules that a ROS 2 installation has, and no package index."""
PARTS = {"markupsafe": "jinja2", "pydantic-core": "pydantic"}
"""Distributions that belong to another one, which pins them."""


COMPILES_AHEAD = "slamsim map tiny --set sensors.lidar=lds_01"
"""What an installation runs, so that no later command waits for the compiler."""


def distribution(requirement: str) -> str:
    found = re.match(r"[\w.-]+", requirement)
    assert found is not None
    return found[0].lower().replace("_", "-")


def declared(extra: str | None = None) -> set[str]:
    if extra is None:
        return set(map(distribution, PROJECT["dependencies"]))
    return set(map(distribution, PROJECT["optional-dependencies"][extra]))


def imported(paths: Iterable[Path]) -> set[str]:
    """The libraries that the files import, wherever in their text."""
    names = {name for path in paths for name in imports_of(path)}
    return names - set(sys.stdlib_module_names) - {"slamsim"}


def test_what_the_package_imports_is_declared_and_what_is_declared_is_imported() -> None:
    owners = packages_distributions()
    needed = set()
    for module in imported((ROOT / "slamsim").rglob("*.py")) - OF_ROS:
        names = map(distribution, owners.get(module, [module]))
        of_module = {PARTS.get(name, name) for name in names}
        assert of_module & (declared() | OPTIONAL.keys()), f"{module} is not declared"
        needed |= of_module
    # of two wheels with the same module, one for each kind of processor, one is installed
    unused = {each for each in declared() - needed if not each.startswith("open3d")}
    assert unused == set()


def test_an_extra_brings_what_its_part_needs_and_nothing_twice() -> None:
    for name, extra in OPTIONAL.items():
        assert name in declared(extra) and name not in declared()
    for extra in ("cloud", "cluster", "gym", "peers"):
        assert not declared(extra) & declared()
        assert declared(extra) <= OPTIONAL.keys() | NOT_IMPORTED.keys()


def test_constraints_pin_what_is_declared() -> None:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pinned = {distribution(line) for line in lines if not line.startswith("#")}
    everything = declared().union(*map(declared, PROJECT["optional-dependencies"]))
    assert everything - pinned <= {"open3d", "atheris"}  # of other processors; only for fuzzing


def test_the_page_on_installing_names_every_package_and_extra() -> None:
    page = (ROOT / "docs" / "install.md").read_text()
    assert {
        name for name in declared() | OPTIONAL.keys() if not re.search(rf"\b{name}\b", page)
    } == set()
    extras = re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)
    assert sorted(extras) == sorted(PROJECT["optional-dependencies"])


INSTALLS = "Dockerfile", ".devcontainer/devcontainer.json", "docs/install.md", "docs/ros.md"


@pytest.mark.parametrize("name", INSTALLS)
def test_an_installation_compiles_ahead(name: str) -> None:
    assert f"{COMPILES_AHEAD} " in (ROOT / name).read_text()


@pytest.mark.slow
def test_what_is_compiled_ahead_is_what_the_first_recording_needs(tmp_path: Path) -> None:
    """With another lidar, read from a file, and checked: of some 130 kernels few are left, for
    what this drive meets and the drive of the installation did not."""
    cache = tmp_path / "cache"

    def compiled_by(*words: str) -> int:
        before = len([*cache.rglob("*.nbc")])
        command = [sys.executable, "-m", *words, "--quiet"]
        environment = os.environ | {"NUMBA_CACHE_DIR": str(cache)}
        subprocess.run(
            command, cwd=tmp_path, env=environment, stdout=subprocess.DEVNULL, check=True
        )
        return len([*cache.rglob("*.nbc")]) - before

    assert compiled_by(*COMPILES_AHEAD.split()) > 100
    other = "--set", "sensors.lidar=rplidar_a2", "--set", "drive.route.max_duration_s=20"
    compiled_by("slamsim", "simulate", "tiny", "--drive-seed", "1", "--out", "drive", *other)
    assert compiled_by("slamsim", "map", "drive", "--out", "mapped") <= 3
    assert compiled_by("slamsim", "check", "drive") <= 3


def test_the_changelog_tells_of_this_version() -> None:
    headings = re.findall(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert headings[0] == "Unreleased" and slamsim.__version__ in headings


def test_the_shell_completes_commands() -> None:
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            "import sys; sys.argv = ['slamsim']; from slamsim.entry import main; main()",
        ],
        env={
            **os.environ,
            "_SLAMSIM_COMPLETE": "complete_bash",
            "COMP_WORDS": "slamsim loc",
            "COMP_CWORD": "1",
        },
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert done.stdout.split() == ["localise"]
