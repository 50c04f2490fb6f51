"""The picture of a world from its start: what is seen is where geometry says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from looks_example import looks_of, room
from world_helpers import PLAIN

from slamsim.cameras.lens import pinhole
from slamsim.config.layout import LooksConfig
from slamsim.config.run import RunConfig
from slamsim.core.types import FloatArray
from slamsim.run.cameras.world_view import view_png
from slamsim.run.recording import export_world
from slamsim.world.looks.tags import Tag
from slamsim.world.model import World

LOOKS = {"tags": {"count": 4, "size_m": [0.2, 0.3]}, "posters": {"count": 4}}


def in_front_of(at: World, tag: Tag) -> World:
    """The world with its start 1.2 m before a tag, looking at it by 20 degrees from the left."""
    right, out = tag.T_map_tag[:2, 0], tag.T_map_tag[:2, 2]
    away = np.cos(0.35) * out - np.sin(0.35) * right
    x_m, y_m = tag.T_map_tag[:2, 3] + 1.2 * away
    return replace(at, start_pose=np.array([x_m, y_m, np.arctan2(-away[1], -away[0])]))


def expected_px(at: World, tag: Tag) -> FloatArray:
    """(4, 2) pixels of the corners of its black square, upper left first."""
    half = 0.5 * tag.size_m
    square = np.array([[-half, half], [half, half], [half, -half], [-half, -half]])
    corners = square @ tag.T_map_tag[:3, :2].T + tag.T_map_tag[:3, 3]
    x_m, y_m, yaw = at.start_pose
    ahead, left = (np.cos(yaw), np.sin(yaw), 0.0), (-np.sin(yaw), np.cos(yaw), 0.0)
    away = corners - [x_m, y_m, 0.5]
    seen = np.column_stack([-away @ left, -away[:, 2], away @ ahead])
    pixels, _ = pinhole(480, 270, 75.0).project(seen)
    return np.asarray(pixels)


def test_opencv_finds_tags_in_the_picture_where_they_hang() -> None:
    at = room(half_m=3.0)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.ArucoDetector(dictionary, parameters)
    tags = looks_of(at, **LOOKS).tags
    assert len(tags) == 4
    for tag in tags:
        before = in_front_of(at, tag)
        picture = view_png(before, LooksConfig.model_validate(LOOKS))
        image = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR)
        assert image is not None and image.shape == (270, 480, 3)
        corners, ids, _ = detector.detectMarkers(image)
        found = dict(zip(np.ravel(ids).tolist(), corners, strict=True))
        assert np.abs(found[tag.id][0] - expected_px(before, tag)).max() < 1.0


def test_a_world_is_written_with_a_view_where_one_is_asked_for(tmp_path: Path) -> None:
    config = RunConfig.model_validate({"world": PLAIN})

    export_world(config, tmp_path / "without")
    export_world(config, tmp_path / "with", with_view=True)

    assert not (tmp_path / "without" / "view.png").exists()
    assert (tmp_path / "with" / "view.png").read_bytes().startswith(b"\x89PNG")
