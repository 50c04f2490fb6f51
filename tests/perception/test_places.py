"""Places seen again: a true one is found with an honest motion, another room is none."""

from __future__ import annotations

import numpy as np
from rgbd_room import patterns, see

from slamsim.cameras.lens import pinhole
from slamsim.core.types import FloatArray
from slamsim.perception.places import APART, Places
from slamsim.perception.tag_pose import step_between
from slamsim.perception.twist import exponential

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


def test_an_image_without_room_for_a_corner_holds_none() -> None:
    for size in (1, 8):
        places = Places(pinhole(size, size, 60.0))
        grey, depth_m = np.zeros((size, size), np.uint8), np.ones((size, size), np.float32)
        assert places.add(0, 0, grey, depth_m) == []
