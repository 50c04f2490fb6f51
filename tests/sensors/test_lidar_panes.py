"""Lidars before glass and mirrors: unfolded rooms, and worlds with panes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from sensing_example import PERFECT_LIDAR, prism, rectangle, standing

from slamsim.cameras.appearance import PlainGrey
from slamsim.config.lidar import LidarConfig
from slamsim.config.loading import load_run_config
from slamsim.core.geometry import se3_from_parts
from slamsim.core.types import Float32Array, FloatArray
from slamsim.sensors.base import Site
from slamsim.sensors.lidar import Lidar
from slamsim.sensors.motion import joined
from slamsim.world.build import build_world
from slamsim.world.looks.build import build_looks

EDGE_M, PLANE_M = 4.0, 0.3
ROUND = PERFECT_LIDAR.model_copy(
    update={"angle_min_deg": -180.0, "angle_step_deg": 0.5, "beam_count": 720, "meets_panes": True}
)
ANGLES = np.radians(-180.0 + 0.5 * np.arange(720))


class OnePane(PlainGrey):
    """All of the wall at x = EDGE_M is a pane with this share of light thrown back."""

    def __init__(self, share: float) -> None:
        super().__init__(1 << 20)
        self._share = share

    def materials(self, triangles: NDArray[np.uint32], points_m: FloatArray) -> NDArray[np.uint8]:
        return (1 + (np.abs(points_m[:, 0] - EDGE_M) < 1e-3)).astype(np.uint8)

    @property
    def mirroring(self) -> Float32Array:
        return np.array([0.0, 0.0, self._share], dtype=np.float32)


def ranges_before(share: float, config: LidarConfig = ROUND) -> FloatArray:
    """(720,) of a lidar in the middle of a room of 8 x 6 m."""
    mesh = prism(rectangle(-EDGE_M, -3.0, EDGE_M, 3.0))
    site = Site(mesh, 0, start_ns=0, appearance=lambda: OnePane(share))
    lidar = Lidar(config, se3_from_parts(np.eye(3), np.array([0, 0, PLANE_M])), site)
    return np.asarray(lidar.scan_batch(joined(None, standing(0.2)), np.zeros(1, np.int64))[0][0])


def box_range(low_x: float, high_x: float) -> FloatArray:
    """(720,) from the origin to the sides of a box, by slabs."""
    with np.errstate(divide="ignore"):
        along_x = np.where(np.cos(ANGLES) > 0, high_x, low_x) / np.cos(ANGLES)
        along_y = 3.0 / np.abs(np.sin(ANGLES))
    return np.asarray(np.minimum(along_x, along_y))


def on_pane() -> NDArray[np.bool_]:
    return np.asarray(np.abs(ANGLES) < np.arctan2(3.0, EDGE_M) - 1e-6)


def test_a_mirror_shows_the_room_unfolded() -> None:
    ranges, flash = ranges_before(0.9), np.abs(np.degrees(ANGLES)) < 2.9
    unfolded = box_range(-EDGE_M, 3.0 * EDGE_M)  # the room and its image behind the mirror
    expected = np.where(flash, box_range(-EDGE_M, EDGE_M), unfolded)
    beside = np.abs(np.abs(np.degrees(ANGLES)) - 3.0) > 0.2
    assert np.allclose(ranges[beside], expected[beside], atol=2e-3)


def test_glass_answers_along_its_normal_alone() -> None:
    ranges = ranges_before(0.08)
    near, far = np.abs(np.degrees(ANGLES)) < 2.9, np.abs(np.degrees(ANGLES)) > 3.1
    assert np.allclose(ranges[near], (EDGE_M / np.cos(ANGLES))[near], atol=1e-4)
    assert np.isinf(ranges[on_pane() & far]).all()
    assert np.allclose(ranges[~on_pane()], box_range(-EDGE_M, EDGE_M)[~on_pane()], atol=1e-4)


def test_without_the_setting_panes_are_wall() -> None:
    plain = ROUND.model_copy(update={"meets_panes": False})
    assert np.allclose(ranges_before(0.9, plain), box_range(-EDGE_M, EDGE_M), atol=1e-4)


@pytest.mark.parametrize("edges", [0.0, 2.0])
def test_panes_of_a_world_change_the_beams_that_meet_them(edges: float) -> None:
    panes = ("world.looks.panes.glass=6", "world.looks.panes.mirrors=6")
    config = load_run_config("tiny", None, (*panes, "sensors.lidar.meets_panes=true"))
    world = build_world(config.world, 1)
    looks = build_looks(world, config.world.looks)
    seen = []
    for meets in (True, False):
        lidar = ROUND.model_copy(
            update={
                "meets_panes": meets,
                "mixed": ROUND.mixed.model_copy(update={"divergence_mrad": edges}),
            }
        )
        site = Site(world.mesh, 1, start_ns=0, appearance=lambda: looks)
        mount = se3_from_parts(np.eye(3), np.array([0, 0, 0.2]))
        drive = standing(0.2, *world.start_pose[:2].tolist())
        sensor = Lidar(lidar, mount, site, with_truth=True)
        ranges, _, truth = sensor.scan_batch(joined(None, drive), np.zeros(1, np.int64))
        assert truth is not None
        seen.append((ranges[0], truth.ranges_m[0]))
    (with_panes, true), (without, same) = seen
    assert np.array_equal(true, same)  # the truth is the surface that is there
    changed = with_panes != without
    assert 5 < changed.sum() < 500
    assert (with_panes[changed] > without[changed] - 0.5).all()
