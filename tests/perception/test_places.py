"""Places seen again: a true one is found with an honest motion, another room is none."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray
from rgbd_room import patterns, see

from slamsim.cameras.codecs.pictures import encode_png
from slamsim.cameras.lens import pinhole
from slamsim.core.geometry import se2_from_se3, se3_from_parts
from slamsim.core.types import Float32Array, FloatArray
from slamsim.io.cameras import open_cameras
from slamsim.perception.places import APART, Places
from slamsim.perception.tag_pose import step_between
from slamsim.perception.twist import exponential
from slamsim.recording import Recording
from slamsim.run.cameras import places as places_stage
from slamsim.run.cameras.places import places_seen_again

R_BASE_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
MODEL = pinhole(320, 240, 69.0)
BLANK = np.full((240, 320), 128, np.uint8)
FAR_M = np.full((240, 320), 2.0, np.float32)


def _after_a_way(places: Places) -> None:
    """As many places in between as a loop has at least."""
    for k in range(APART):
        assert places.add(k + 1, 0, BLANK, FAR_M) == []


def test_a_place_is_found_again_with_its_motion() -> None:
    rng, textures, places = np.random.default_rng(0), patterns(0), Places(MODEL)
    moved: FloatArray = exponential(np.array([0.12, -0.03, 0.1, 0.02, 0.1, 0.05]))
    places.add(0, 0, *see(MODEL, np.eye(4), textures, rng))
    _after_a_way(places)
    ((earlier, fitted),) = places.add(99, 0, *see(MODEL, moved, textures, rng))

    assert earlier == 0
    off = step_between(fitted.T_now_keyframe, np.asarray(np.linalg.inv(moved)))
    assert np.linalg.norm(off[:3]) < 0.03 and np.linalg.norm(off[3:]) < 0.02
    assert off @ np.linalg.solve(fitted.covariance, off) < 22.5  # 99.9 % of six degrees


def test_another_room_is_no_place_seen_again() -> None:
    rng, places = np.random.default_rng(1), Places(MODEL)
    places.add(0, 0, *see(MODEL, np.eye(4), patterns(1), rng))
    _after_a_way(places)
    assert places.add(99, 0, *see(MODEL, np.eye(4), patterns(2), rng)) == []


def test_the_same_picture_at_another_depth_is_refused() -> None:
    rng, textures, places = np.random.default_rng(2), patterns(2), Places(MODEL)
    grey, depth_m = see(MODEL, np.eye(4), textures, rng)
    places.add(0, 0, grey, depth_m)
    _after_a_way(places)
    # A poster of the place, hung flat 1 m ahead.
    assert places.add(99, 0, grey, np.full_like(depth_m, 1.0)) == []
    assert places.refused == 1


def test_neighbours_on_the_way_are_no_loop_but_count_once_the_path_was_lost() -> None:
    rng, textures, places = np.random.default_rng(3), patterns(3), Places(MODEL)
    places.add(0, 0, *see(MODEL, np.eye(4), textures, rng))
    assert places.add(1, 0, *see(MODEL, np.eye(4), textures, rng)) == []
    found = places.add(2, 1, *see(MODEL, np.eye(4), textures, rng))
    assert sorted(keyframe for keyframe, _ in found) == [0, 1]


@pytest.mark.parametrize("tilt_rad", [0.0, 0.3])
def test_a_recording_tells_the_place_of_its_base_unless_that_tilts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tilt_rad: float
) -> None:
    rng, textures = np.random.default_rng(4), patterns(4)
    moved: FloatArray = exponential(np.array([0.1, 0.0, 0.15, tilt_rad, 0.06, 0.0]))
    shown = [see(MODEL, np.eye(4), textures, rng), *[(BLANK, FAR_M)] * APART]
    shown.append(see(MODEL, moved, textures, rng))
    _write(tmp_path, shown)
    mount = se3_from_parts(R_BASE_OPTICAL, np.array([0.1, 0.0, 0.4]))
    monkeypatch.setattr(places_stage, "mount_of", lambda *_: mount)
    monkeypatch.setattr(places_stage, "APART_NS", 1)
    found = places_seen_again(tmp_path, Recording("r", "memory"), None)
    if tilt_rad:
        assert found == ()
        return
    (again,) = found
    with open_cameras(tmp_path) as cameras:
        first_ns, *_, last_ns = (frame.stamp_ns for frame in cameras.frames(["color"]))
    assert (again.earlier_ns, again.now_ns) == (first_ns, last_ns)
    true = se2_from_se3(mount @ moved @ np.linalg.inv(mount))
    assert np.abs(again.T_earlier_now - true).max() < 0.03


@pytest.mark.parametrize("has_odometry", [True, False])
def test_images_of_a_robot_that_stands_are_not_looked_at_again(has_odometry: bool) -> None:
    """It drives 0.1 m a second after it has stood for two seconds."""

    class Driven:
        def covers(self, *_: int) -> bool:
            return True

        def step(self, first_ns: int, last_ns: int, _: FloatArray) -> SimpleNamespace:
            x_m = [0.1 * max(1e-9 * ns - 2.0, 0.0) for ns in (first_ns, last_ns)]
            return SimpleNamespace(T_first_last=np.array([x_m[1] - x_m[0], 0.0, 0.0]))

    moved = places_stage._Moved(Driven() if has_odometry else None)  # type: ignore[arg-type]
    looked = [k for k in range(60) if moved.since_last(k * 100_000_000)]
    assert looked == ([0, 35, 50] if has_odometry else list(range(0, 60, 5)))


def _write(folder: Path, shown: list[tuple[NDArray[np.uint8], Float32Array]]) -> None:
    for name in ("color", "depth"):
        (folder / name).mkdir()
    for number, (grey, depth_m) in enumerate(shown):
        colour, depth_mm = np.repeat(grey[..., None], 3, axis=2), np.rint(1e3 * depth_m)
        (folder / "color" / f"{number:05d}.png").write_bytes(encode_png(colour))
        (folder / "depth" / f"{number:05d}.png").write_bytes(encode_png(depth_mm.astype(np.uint16)))
    intrinsic = {"width": 320, "height": 240, "intrinsic_matrix": MODEL.K.T.ravel().tolist()}
    (folder / "camera_intrinsic.json").write_text(json.dumps(intrinsic))


def test_an_image_without_room_for_a_corner_holds_none() -> None:
    for size in (1, 8):
        places = Places(pinhole(size, size, 60.0))
        grey, depth_m = np.zeros((size, size), np.uint8), np.ones((size, size), np.float32)
        assert places.add(0, 0, grey, depth_m) == []
