"""Loops that images point to: confirmed by the lidar where they are true, refused where not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from closure_scene import keyframes
from simulated import box

from slamsim.config.back_end import GraphConfig
from slamsim.config.slam import SlamConfig
from slamsim.core.geometry import between, compose
from slamsim.core.places import SeenAgain
from slamsim.core.result import GraphEdge
from slamsim.core.types import FloatArray
from slamsim.slam.backend.back_end import BackEnd
from slamsim.slam.backend.solution import Solution
from slamsim.slam.closures.images import ImageCandidates
from slamsim.slam.frontend.keyframes import OTHER_DRIVE_M, Keyframe

STEP_M, WAY_M, PITCH_M = 0.5, 14.0, 0.8
CORRIDOR = np.concatenate(
    [
        box(-60.0, -1.0, 70.0, 1.0),
        *(box(x, -1.0, x + 0.2, -0.8) for x in np.arange(-20.0, 30.0, PITCH_M)),
    ]
)
"""Longer than a lidar sees, with pillars that are all alike: the next one is as good as the right
one."""
SLIP_M = 0.7
"""On the way back to where the first pass began: so much farther than the truth, of which 0.3 m are
expected where no match tells anything."""


@pytest.fixture(scope="module")
def driven() -> tuple[list[Keyframe], FloatArray]:
    """Key frames of two passes as a front end that slipped in between has them, and the truth."""
    along = np.arange(0.0, WAY_M, STEP_M)
    once = np.column_stack([along, np.zeros((len(along), 2))])
    true, again = np.concatenate([once, once]), np.arange(2 * len(along)) >= len(along)
    slipped = true + again[:, None] * np.array([SLIP_M, 0.0, 0.0])
    path_m = np.concatenate([along, along + 2.0 * WAY_M])
    made = [
        replace(one, T_map_base=pose, T_odom_base=pose, path_m=float(far))
        for one, pose, far in zip(keyframes(CORRIDOR, true), slipped, path_m, strict=True)
    ]
    back = made[len(along)]
    across = back.information * np.outer([0.0, 1.0, 1.0], [0.0, 1.0, 1.0])
    made[len(along)] = replace(back, information=across)
    return made, true


IMAGE_ERROR = np.array([0.08, -0.05, 0.02])


def _mapped(made: Sequence[Keyframe], again: Sequence[SeenAgain]) -> BackEnd:
    end = BackEnd(SlamConfig(), ImageCandidates(again))
    for keyframe in made:
        end.take(keyframe)
    return end


def _sightings(
    made: Sequence[Keyframe], true: FloatArray, off: FloatArray
) -> tuple[SeenAgain, ...]:
    """Each key frame of the second pass sees that of the first, ``off`` beside the truth."""
    half = len(made) // 2
    return tuple(
        SeenAgain(
            made[k].stamp_ns,
            made[k + half].stamp_ns,
            compose(between(true[k], true[k + half]), off),
        )
        for k in range(half)
    )


def _closed(end: BackEnd) -> list[tuple[int, int]]:
    return [(edge.source, edge.target) for edge in end.new_closures()]


@pytest.mark.long
def test_of_places_that_the_lidar_cannot_tell_apart_images_tell_the_right_one(
    driven: tuple[list[Keyframe], FloatArray],
) -> None:
    made, true = driven
    alone, joined = _mapped(made, ()), _mapped(made, _sightings(made, true, IMAGE_ERROR))
    for end in (alone, joined):
        end.finish()
    last_alone, last_joined = ((end.poses - true[end.kept])[-1] for end in (alone, joined))
    assert np.abs(last_alone[0]) > PITCH_M  # without a word
    assert np.hypot(*last_joined[:2]) < 0.02


@pytest.mark.long
@pytest.mark.parametrize("off", [[0.0, 3.0, 0.0], [0.0, 0.0, 1.57], [9.0 * PITCH_M, 0.0, 0.0]])
def test_what_images_say_and_walls_contradict_changes_nothing(
    driven: tuple[list[Keyframe], FloatArray], off: list[float]
) -> None:
    made, true = driven
    lied_to = _mapped(made, _sightings(made, true, np.array(off)))
    assert _closed(lied_to) == _closed(_mapped(made, ()))


def test_no_drift_is_as_large_as_what_is_left_out() -> None:
    """Of 20 m of path 3 % may be lost, five times that at most."""
    solution, step = Solution(GraphConfig()), np.array([0.5, 0.0, 0.0])
    solution.begin(np.zeros(3))
    for number in range(40):
        covariance = np.diag(np.square([0.01, 0.01, 0.002]))
        solution.extend(GraphEdge(number, number + 1, step, covariance, "match"), apart=False)
    for off_m, is_near in ((0.0, True), (2.0, True), (4.0, False)):
        T, tight = np.array([20.0, off_m, 0.0]), 1e-4 * np.eye(3)
        assert solution.may_be(GraphEdge(0, 40, T, tight, "closure")) is is_near


def test_where_a_key_frame_is_follows_from_the_images_beside_it(
    driven: tuple[list[Keyframe], FloatArray],
) -> None:
    made, _ = driven
    T = np.array([0.1, 0.2, 0.3])
    later = SeenAgain(made[3].stamp_ns + 4, made[40].stamp_ns - 4, T)
    ((number, found),) = ImageCandidates([later]).of(made, 40)
    assert number == 3 and np.allclose(found, T, rtol=0.0, atol=1e-12)
    assert not ImageCandidates([later]).of(made, 41)
    # A later drive: what its images show again was seen in it.
    path_m = made[20].path_m + OTHER_DRIVE_M
    other = [*made[:20], *(replace(one, path_m=path_m + one.path_m) for one in made[20:])]
    ((number, _),) = ImageCandidates([later]).of(other, 40)
    assert number >= 20
