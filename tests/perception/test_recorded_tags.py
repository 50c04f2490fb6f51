"""Which cameras of a recording tags are looked for with."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from slamsim.cameras.lens import CameraModel, pinhole
from slamsim.guard.errors import InputRefused, NotFound
from slamsim.perception import recorded

CAMERA = pinhole(64, 48, 60.0)


class Opened:
    """Of the topics only those in ``known`` have camera info."""

    def __init__(self, *known: str) -> None:
        self.known = known

    def pictures(self) -> Sequence[Any]:
        return [SimpleNamespace(topic=name, frame_id=name) for name in ("/front", "/rear")]

    def model(self, topic: str) -> CameraModel:
        if topic not in self.known:
            raise NotFound(f"{topic} has no camera info")
        return CAMERA


def mount_of(path: Path, topic: str, frame: str, recording: object) -> np.ndarray:
    return np.eye(4)


def test_a_camera_without_camera_info_is_left_out_and_told(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(recorded, "mount_of", mount_of)
    opened: Any = Opened("/rear")
    assert list(recorded._usable(Path("drive"), opened, opened)) == ["/rear"]
    assert "a camera is left out: /front has no camera info" in caplog.text


def test_no_camera_at_all_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def nowhere(path: Path, topic: str, frame: str, recording: object) -> np.ndarray:
        raise InputRefused(path, "no fixed transform", f"topic {topic}")

    monkeypatch.setattr(recorded, "mount_of", mount_of)
    opened: Any = Opened()
    with pytest.raises(NotFound, match="/front has no camera info"):
        recorded._usable(Path("drive"), opened, opened)
    monkeypatch.setattr(recorded, "mount_of", nowhere)
    opened = Opened("/front", "/rear")
    with pytest.raises(InputRefused, match="topic /front"):
        recorded._usable(Path("drive"), opened, opened)
