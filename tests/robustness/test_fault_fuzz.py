"""What fuzzing feeds is right to begin with, and what it once found stays repaired."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest
from fault_atheris import fed
from fault_fuzz_targets import TARGETS

from slamsim.guard.errors import SlamsimError

pytestmark = pytest.mark.fault

FOUND: tuple[tuple[str, bytes], ...] = (
    ("carmen", b"ODO1\x17W0.0 0 1.2 host 1.2\nFLASER 3 1 2 3 0 0 0 0 0 0 1.3 h 1.3\n"),
    ("manifest", next(iter(TARGETS["manifest"].seeds())).replace(b"faults", b"\xffaults")),
)
"""Bytes after which a loader did anything but answer or refuse."""


@pytest.mark.parametrize("name", TARGETS)
def test_every_loader_takes_its_seeds(name: str) -> None:
    target = TARGETS[name]
    answers = 0
    for data in target.seeds():
        try:
            target.run(data)
            answers += 1
        except SlamsimError:
            continue  # some are there for their words only
    assert answers or name == "saved map"


@pytest.mark.parametrize("name", TARGETS)
@pytest.mark.parametrize("data", [b"", b"\0", b"\xff" * 300, b"a: 1\n", b"0 " * 200])
def test_no_loader_stumbles_over_rubbish(name: str, data: bytes) -> None:
    try:
        TARGETS[name].run(data)
    except SlamsimError as refused:
        assert all(line.isprintable() for line in str(refused).split("\n"))


@pytest.mark.parametrize(("name", "data"), FOUND)
def test_what_was_found_stays_repaired(name: str, data: bytes) -> None:
    try:
        TARGETS[name].run(data)
    except SlamsimError:
        return


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("atheris") is None, reason="needs the extra fuzz")
def test_a_loader_is_fed(tmp_path: Path) -> None:
    for found in fed(("sums", "tum"), tmp_path, 3.0):
        assert found["runs"] > 100
        assert found["finds"] == []
