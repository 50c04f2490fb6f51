"""Tags in the pose graph: a robot that is nearly blind is held by them."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from simulated import Simulated, ate_rmse_m
from tag_hall import (
    TAGS_IN_ROOM,
    half_blind_hall,
    hall,
    mistaken,
    observed,
    room,
    surveyed,
    tags_on_walls,
)

from slamsim.config.slam import LandmarksConfig, MotionConfig, SlamConfig
from slamsim.core.geometry import between, compose, inverse, wrap_angle
from slamsim.core.landmarks import CameraErrors, TagObservation, TagsSeen
from slamsim.core.result import SlamResult
from slamsim.core.types import PlanarTrajectory
from slamsim.guard.errors import InputRefused, SlamsimError
from slamsim.perception.recorded import known_tags, surveyed_tags
from slamsim.perception.tag_families import parse_tags
from slamsim.slam.landmarks import joint
from slamsim.slam.landmarks.graph import with_landmarks
from slamsim.slam.landmarks.nodes import nodes_of
from slamsim.slam.landmarks.views import tag_views
from slamsim.slam.mapping.saved_map import SavedMap, read_saved_map, write_saved_map
from slamsim.slam.session import map_log

TAGS = tags_on_walls()
CONFIG = SlamConfig(calibrate_laser=False)
"""Half of what a short log costs is the calibration of its laser, which has tests of its own."""


@pytest.fixture(scope="module")
def driven() -> tuple[Simulated, SlamResult, tuple[TagObservation, ...]]:
    sim = hall(0, max_s=110.0)
    return sim, map_log(sim.log, CONFIG)[0], observed(sim, TAGS, 0, 250_000_000)


@cache
def two_drives() -> tuple[Simulated, Simulated]:
    """Through one room."""
    return room(4), room(5)


@cache
def mapped_room() -> tuple[SlamResult, SavedMap]:
    """By the first of them, with its four tags."""
    first, _ = two_drives()
    seen = observed(first, TAGS_IN_ROOM, 4, 400_000_000)
    return map_log(first.log, CONFIG, tags=TagsSeen(seen, family="apriltag_36h11"))


@pytest.mark.slow
def test_observations_err_as_they_claim(
    driven: tuple[Simulated, SlamResult, tuple[TagObservation, ...]],
) -> None:
    sim, _, observations = driven
    nees = []
    for one in observations:
        T_map_base = sim.truth.at(np.array([one.stamp_ns]))[0]
        off = one.T_base_tag - between(T_map_base, TAGS[one.number])
        off[2] = wrap_angle(off[2])
        nees.append(off @ np.linalg.solve(one.covariance, off))

    assert len(nees) > 500
    assert 2.0 < np.mean(nees) < 4.0  # three degrees of freedom


@pytest.mark.long
def test_a_blind_robot_is_held_by_tags(
    driven: tuple[Simulated, SlamResult, tuple[TagObservation, ...]],
) -> None:
    sim, without, observations = driven
    result = with_landmarks(without, None, TagsSeen(observations), CONFIG)

    ate_m = ate_rmse_m(result.trajectory, sim.truth)
    assert ate_m < 0.02
    assert ate_rmse_m(without.trajectory, sim.truth) > 10.0 * ate_m
    assert [tag.number for tag in result.landmarks] == sorted({o.number for o in observations})
    assert np.array_equal(result.trajectory.stamps_ns, without.trajectory.stamps_ns)


@pytest.mark.slow
def test_tags_leave_a_path_as_good_where_the_lidar_is_blind_half_of_the_way() -> None:
    """Wheels that scans calibrate elsewhere are better there than what is assumed of wheels."""
    sim = half_blind_hall(3)
    seen = [replace(one, camera="front", row=0.5) for one in observed(sim, TAGS, 3, 150_000_000)]
    tags = TagsSeen(tuple(seen), cameras={"front": CameraErrors()})
    without, held = map_log(sim.log, CONFIG)[0], map_log(sim.log, CONFIG, tags=tags)[0]

    assert held.landmarks and not held.failed
    both = [ate_rmse_m(each.trajectory, sim.truth) for each in (held, without)]
    assert both[0] < 1.2 * both[1]


@pytest.mark.long
def test_surveyed_tags_put_the_map_into_their_frame(
    driven: tuple[Simulated, SlamResult, tuple[TagObservation, ...]],
) -> None:
    sim, without, observations = driven
    moved = np.array([3.0, -2.0, 0.7])
    known = surveyed(compose(moved, TAGS))
    result = with_landmarks(without, None, TagsSeen(observations, known), CONFIG)

    true = compose(moved, sim.truth.at(result.trajectory.stamps_ns))
    off_m = np.linalg.norm(result.trajectory.poses[:, :2] - true[:, :2], axis=1)
    assert np.sqrt(np.mean(off_m**2)) < 0.06
    assert all(tag.is_surveyed for tag in result.landmarks)
    assert max(np.sqrt(np.trace(tag.covariance[:2, :2])) for tag in result.landmarks) < 0.004


@pytest.mark.long
def test_mistaken_numbers_are_doubted(
    driven: tuple[Simulated, SlamResult, tuple[TagObservation, ...]],
) -> None:
    sim, without, observations = driven
    wrong = mistaken(observations, every=97, number=1)
    result = with_landmarks(without, None, TagsSeen(wrong, surveyed(TAGS)), CONFIG)

    assert ate_rmse_m(result.trajectory, sim.truth) < 0.08
    assert sum(tag.doubted for tag in result.landmarks) > 0


def test_a_tag_in_two_places_is_left_out_and_the_others_stay(
    driven: tuple[Simulated, SlamResult, tuple[TagObservation, ...]],
) -> None:
    _, without, observations = driven
    once = observations[len(observations) // 2]
    apart = np.array([2.0, 1.5, 0.5])
    twice = (replace(once, number=99), replace(observations[0], number=99, T_base_tag=apart))
    result = with_landmarks(without, None, TagsSeen((*observations, *twice)), CONFIG)

    assert [tag.number for tag in result.landmarks] == sorted({o.number for o in observations})
    assert any("tag 99 is left out" in words for words in result.warnings)


def test_a_surveyed_tag_that_stands_elsewhere_is_told(
    driven: tuple[Simulated, SlamResult, tuple[TagObservation, ...]],
) -> None:
    sim, without, observations = driven
    places = TAGS.copy()
    places[4, :2] += 1.0
    result = with_landmarks(without, None, TagsSeen(observations, surveyed(places)), CONFIG)

    assert ate_rmse_m(result.trajectory, sim.truth) < 0.08
    told = [words for words in result.warnings if "where the survey has it" in words]
    assert len(told) == 1
    assert told[0].startswith("tag 4 ")


@pytest.mark.long
@pytest.mark.parametrize("wrong", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_a_wrong_survey_of_one_tag_is_found_where_the_lidar_is_blind(
    driven: tuple[Simulated, SlamResult, tuple[TagObservation, ...]], wrong: int
) -> None:
    """1.4 m, beside the tag by which the drive begins: it pulled the path off by 0.4 and 1 m."""
    sim, without, observations = driven
    places = TAGS.copy()
    places[wrong, :2] += 1.0
    result = with_landmarks(without, None, TagsSeen(observations, surveyed(places)), CONFIG)

    assert ate_rmse_m(result.trajectory, sim.truth) < 0.03
    (told,) = [words for words in result.warnings if "where the survey has it" in words]
    assert told.startswith(f"tag {wrong} ")
    assert [tag.number for tag in result.landmarks if not tag.is_surveyed] == [wrong]


@pytest.mark.long
@pytest.mark.parametrize("factor", [0.8, pytest.param(1.1, marks=pytest.mark.slow)])
def test_a_wrong_size_of_the_tags_is_told_where_the_lidar_is_blind(
    driven: tuple[Simulated, SlamResult, tuple[TagObservation, ...]], factor: float
) -> None:
    """It was silent, the map off by 0.26 m with 10 % and claimed to be sure within 20 mm."""
    sim, without, observations = driven
    camera = CameraErrors(middle_m=(0.1, 0.02))
    middle = np.array([*camera.middle_m, 0.0])
    wider = np.array([factor, factor, 1.0])
    seen = [
        replace(one, T_base_tag=middle + wider * (one.T_base_tag - middle), camera="front")
        for one in observations
    ]
    tags = TagsSeen(tuple(seen), cameras={"front": camera})
    result = with_landmarks(without, None, tags, CONFIG)

    assert any("the size of the tags or of the wheels may be wrong" in w for w in result.warnings)
    assert ate_rmse_m(result.trajectory, sim.truth) < 0.22
    start = result.graph.keyframes
    T_map_truth = compose(start.poses[0], inverse(sim.truth.at(start.stamps_ns[:1])[0]))
    for tag in result.landmarks:
        off = between(compose(T_map_truth, TAGS[tag.number]), tag.T_map_tag)[:2]
        assert off @ np.linalg.solve(tag.covariance[:2, :2], off) < 25.0


def test_a_right_size_of_the_tags_is_not_doubted(
    driven: tuple[Simulated, SlamResult, tuple[TagObservation, ...]],
) -> None:
    _, without, observations = driven
    seen = tuple(replace(one, camera="front") for one in observations)
    tags = TagsSeen(seen, cameras={"front": CameraErrors(middle_m=(0.1, 0.02))})

    assert with_landmarks(without, None, tags, CONFIG).warnings == without.warnings


def test_a_solution_that_does_not_settle_is_told(
    driven: tuple[Simulated, SlamResult, tuple[TagObservation, ...]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _, without, observations = driven
    monkeypatch.setattr(joint, "MOST_STEPS", 1)
    monkeypatch.setattr(joint, "SETTLED", 1e-12)
    result = with_landmarks(without, None, TagsSeen(observations[:40]), CONFIG)

    assert any("it is not exact" in words for words in result.warnings)
    assert result.landmarks


def test_an_unseen_survey_is_told(
    driven: tuple[Simulated, SlamResult, tuple[TagObservation, ...]],
) -> None:
    _, without, observations = driven
    others = tuple(replace(tag, number=tag.number + 100) for tag in surveyed(TAGS))
    result = with_landmarks(without, None, TagsSeen(observations[:50], others), CONFIG)

    assert any("surveyed" in words for words in result.warnings)
    assert not any(tag.is_surveyed for tag in result.landmarks)


def test_tags_seen_at_another_time_hold_nothing(
    driven: tuple[Simulated, SlamResult, tuple[TagObservation, ...]],
) -> None:
    _, without, observations = driven
    late = [replace(one, stamp_ns=one.stamp_ns + 10**12) for one in observations[:20]]
    result = with_landmarks(without, None, TagsSeen(tuple(late)), CONFIG)

    assert np.array_equal(result.trajectory.poses, without.trajectory.poses)
    assert any("tags were seen only" in words for words in result.warnings)


def test_without_tags_nothing_is_other(
    driven: tuple[Simulated, SlamResult, tuple[TagObservation, ...]],
) -> None:
    sim, without, _ = driven
    again, _ = map_log(sim.log, CONFIG, tags=TagsSeen())

    assert again.trajectory.poses.tobytes() == without.trajectory.poses.tobytes()
    assert again.landmarks == ()


def test_steps_are_cut_where_tags_are_seen_between_key_frames(
    driven: tuple[Simulated, SlamResult, tuple[TagObservation, ...]],
) -> None:
    _, without, observations = driven
    nodes = nodes_of(without, TagsSeen(observations), MotionConfig(), None)

    assert len(nodes.track) > len(without.graph.keyframes)
    chain = Counter((e.source, e.target) for e in nodes.edges if e.kind != "closure")
    assert sorted(chain.elements()) == [(k, k + 1) for k in range(len(nodes.track) - 1)]
    kept = nodes.track.stamps_ns[nodes.keyframes]
    assert np.array_equal(kept, without.graph.keyframes.stamps_ns)
    for edge in nodes.edges:
        there = nodes.track.poses[edge.source], nodes.track.poses[edge.target]
        assert np.allclose(edge.T_source_target, between(*there))


@pytest.mark.long
def test_tags_of_a_camera_that_sits_otherwise_leave_a_lidars_path_as_good() -> None:
    """15 mm and 0.3 degrees off, 12 ms late: far more than the lidar's path is off."""
    sim = room(3)
    without, _ = map_log(sim.log, CONFIG)
    wrong = [
        replace(
            one,
            T_base_tag=compose(np.array([0.015, -0.01, 0.005]), one.T_base_tag),
            stamp_ns=one.stamp_ns + 12_000_000,
            camera="front",
        )
        for one in observed(sim, TAGS_IN_ROOM, 3, 150_000_000)[:-3]
    ]
    tags = TagsSeen(tuple(wrong), cameras={"front": CameraErrors(place_m=0.01)})
    held, _ = map_log(sim.log, CONFIG, tags=tags)

    assert held.landmarks and not held.failed
    assert np.mean([tag.doubted / tag.seen for tag in held.landmarks]) < 0.1
    assert not np.array_equal(held.trajectory.poses, without.trajectory.poses)
    both = [ate_rmse_m(each.trajectory, sim.truth) for each in (held, without)]
    assert both[1] < 0.002
    assert both[0] < 1.2 * both[1]


@pytest.mark.long
def test_tags_of_an_earlier_map_are_landmarks_of_the_continued_one(tmp_path: Path) -> None:
    (first, second), (mapped, saved) = two_drives(), mapped_room()
    saved = replace(saved, landmarks=saved.landmarks[:3])
    write_saved_map(tmp_path / "map.npz", saved)
    earlier = read_saved_map(tmp_path / "map.npz")
    assert [tag.number for tag in earlier.landmarks] == [0, 1, 2]
    assert {tag.family for tag in earlier.landmarks} == {"apriltag_36h11"}
    others = TagsSeen(observed(first, TAGS_IN_ROOM[:1], 4, 10**9), family="aruco_4x4_50")
    with pytest.raises(SlamsimError, match="tags of apriltag_36h11, this drive of aruco_4x4_50"):
        map_log(second.log, CONFIG, earlier=earlier, tags=others)
    with pytest.raises(SlamsimError, match="4 surveyed tags do not go with an earlier map"):
        map_log(second.log, CONFIG, earlier=earlier, tags=TagsSeen((), surveyed(TAGS_IN_ROOM)))
    write_saved_map(tmp_path / "without.npz", replace(saved, landmarks=()))
    assert not any("landmark" in name for name in np.load(tmp_path / "without.npz").files)

    again = [one for one in observed(second, TAGS_IN_ROOM, 5, 400_000_000) if one.number != 1]
    on, whole = map_log(
        second.log, CONFIG, earlier=earlier, start=np.zeros(3), tags=TagsSeen(tuple(again))
    )
    assert not on.failed
    assert [tag.number for tag in on.landmarks] == [0, 2, 3]
    assert [tag.number for tag in whole.landmarks] == [0, 1, 2, 3]
    assert len(whole) > len(on.graph.keyframes)
    T_map_truth = compose(
        mapped.trajectory.poses[0], inverse(first.truth.at(mapped.trajectory.stamps_ns[:1])[0])
    )
    before = {tag.number: tag for tag in mapped.landmarks[:3]}
    for tag in on.landmarks:
        off = between(compose(T_map_truth, TAGS_IN_ROOM[tag.number]), tag.T_map_tag)
        assert np.hypot(*off[:2]) < 0.02
        if tag.number in before:
            assert np.trace(tag.covariance) < np.trace(before[tag.number].covariance)
    # An earlier map that may move is as unsure in itself as it was; with tags it claimed half.
    alone, _ = map_log(second.log, CONFIG, earlier=earlier, start=np.zeros(3))
    claimed = [
        np.median(np.trace(each.graph.covariances[:, :2, :2], axis1=1, axis2=2))
        for each in (on, alone)
    ]
    assert claimed[0] > 0.8 * claimed[1]


@pytest.mark.long
def test_a_tag_that_was_carried_elsewhere_is_mapped_anew() -> None:
    (first, second), (mapped, saved) = two_drives(), mapped_room()
    places = TAGS_IN_ROOM.copy()
    places[0, 1] += 1.0
    again = TagsSeen(observed(second, places, 5, 400_000_000))
    on, whole = map_log(second.log, CONFIG, earlier=saved, start=np.zeros(3), tags=again)

    T_map_truth = compose(
        mapped.trajectory.poses[0], inverse(first.truth.at(mapped.trajectory.stamps_ns[:1])[0])
    )
    off = between(compose(T_map_truth, places[0]), whole.landmarks[0].T_map_tag)
    assert np.hypot(*off[:2]) < 0.02
    assert on.landmarks[0].doubted < on.landmarks[0].seen
    told = [words for words in on.warnings if "where the map that is continued has it" in words]
    assert len(told) == 1
    assert told[0].startswith("tag 0 ")


@pytest.mark.long
def test_tags_of_a_drive_that_nothing_joins_hang_on_its_own_first_key_frame() -> None:
    (_, second), (_, saved) = two_drives(), mapped_room()
    saved = replace(saved, landmarks=())
    tags = TagsSeen(observed(second, TAGS_IN_ROOM, 5, 400_000_000))
    on, whole = map_log(second.log, CONFIG, earlier=saved, tags=tags)

    assert len(whole) == len(on.graph.keyframes)
    assert len(whole.landmarks) == 4
    for tag in whole.landmarks:
        assert np.sqrt(np.trace(tag.covariance[:2, :2])) < 0.1  # in the earlier map a metre


def test_views_are_means_that_leave_out_what_is_far_off(
    driven: tuple[Simulated, SlamResult, tuple[TagObservation, ...]],
) -> None:
    _, without, _ = driven
    stamp_ns = int(without.graph.keyframes.stamps_ns[0])
    covariance = np.diag(np.square([0.02, 0.01, 0.05]))
    places = np.array([[2.0, 0.1, 3.0], [2.02, 0.1, 3.02], [1.99, 0.11, 2.98], [4.0, 0.1, 3.0]])
    observations = [TagObservation(stamp_ns, 4, place, covariance) for place in places]
    (view,) = tag_views(
        without.trajectory,
        without.graph.keyframes,
        TagsSeen(tuple(observations)),
        LandmarksConfig(),
    )

    assert (view.node, view.number) == (0, 4)
    assert np.allclose(view.edge.T_source_target, places[:3].mean(axis=0), atol=1e-3)
    assert np.sqrt(view.edge.covariance[0, 0]) < 0.02


def test_shared_errors_of_a_camera_move_a_tag_as_their_slopes_say() -> None:
    path = PlanarTrajectory(
        np.arange(3) * 10**8, np.array([[0.0, 0, 0], [0.05, 0, 0.1], [0.1, 0.01, 0.2]])
    )
    T_base_tag, camera = np.array([1.8, 0.6, 2.5]), CameraErrors(middle_m=(0.1, 0.02))
    one = TagObservation(10**8, 1, T_base_tag, 1e-4 * np.eye(3), "front", row=0.4)
    (view,) = tag_views(path, path, TagsSeen((one,), cameras={"front": camera}), LandmarksConfig())

    errors = 0.1 * np.array([2e-4, -1e-4, 3e-4, 1e-4, 2e-4, 1e-4])
    later_s = errors[3] + one.row * errors[4]
    moved = path.at(np.array([10**8 + round(1e9 * later_s)]))[0]
    looked = compose(between(path.poses[1], moved), errors[:3])
    farther = T_base_tag + errors[5] * np.append(T_base_tag[:2] - camera.middle_m, 0.0)
    expected = between(T_base_tag, compose(looked, farther))
    assert np.allclose(view.slopes @ errors, expected, atol=1e-6)
    assert np.linalg.norm(expected) > 2e-5


PLACE = "position_m: [1.0, 2.0, 0.5], quat_xyzw: [0.5, 0.5, 0.5, 0.5]"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (f"tags: [{{id: 1, {PLACE}}}, {{id: 2, family: aruco_4x4_50, {PLACE}}}]", ""),
        (f"tags: [{{id: 1, {PLACE}}}, {{id: 1, {PLACE}}}]", "twice"),
        ("tags: [{id: 1, position_m: [1.0, 2.0, 0.5]}]", "quat_xyzw"),
        (f"tags: [{{id: 1, {PLACE}, yaw_deg: 3.0}}]", "yaw_deg"),
        (f"tags: [{{id: -1, {PLACE}}}]", "id"),
        ("tags: [{id: 1, position_m: [1, 2, 0], quat_xyzw: [0, 0, 1, 1]}]", "length 1.41"),
    ],
)
def test_a_survey_is_read_or_refused(tmp_path: Path, text: str, told: str) -> None:
    path = tmp_path / "survey.yaml"
    path.write_text(text)
    config = LandmarksConfig(tags="apriltag_36h11:0.2", surveyed=str(path))
    if not told:
        (tag,) = known_tags(config)
        assert tag.number == 1
        assert np.allclose(tag.T_map_tag, [1.0, 2.0, 0.0])  # z of the tag is x of the map
        return
    with pytest.raises(InputRefused, match=told):
        known_tags(config)
    with pytest.raises(InputRefused, match=told):  # for calibration alike
        surveyed_tags(path, parse_tags(config.tags))
