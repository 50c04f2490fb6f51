"""Mount, clock and shutter of a camera from tags on a drive, beside what made the images."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tag_drive import T_CLAIMED, Driven, Setting, driven, off_by

from slamsim.cameras.lens import CameraModel, pinhole
from slamsim.core.geometry import matrix_from_rpy
from slamsim.core.types import FloatArray, PlanarTrajectory
from slamsim.guard.numbers import BadNumbers, NoSolution
from slamsim.perception.calibration.drive import BLOCK_S, CLOCK, MOUNT, Drive
from slamsim.perception.calibration.hand_eye import mount_by_motions
from slamsim.perception.calibration.least_squares import GroupedSlopes, by_blocks
from slamsim.perception.calibration.mount import (
    ALL_LENS,
    FEWEST_SIGHTINGS,
    USUAL_FREE,
    MountFit,
    TooFew,
    best_start,
    fit_mount,
)
from slamsim.perception.calibration.path import SmoothPath
from slamsim.perception.calibration.projection import LENS, lens_names, with_lens
from slamsim.perception.calibration.survey import Survey

SHORT = Setting(seconds=30.0)
SPARSE = replace(SHORT, rate_hz=5.0)
PLANE = tuple(name for name in MOUNT if name != "z_m")


def errors(found: MountFit, setting: Setting) -> dict[str, float]:
    """What was found less what is so."""
    step = dict(zip(MOUNT, found.moved_from(setting.T_base_camera).tolist(), strict=True))
    lens = found.model.K[[0, 1, 0, 1], [0, 1, 2, 2]] - setting.model.K[[0, 1, 0, 1], [0, 1, 2, 2]]
    return {
        **step,
        "late_s": found.late_s - setting.late_s,
        "readout_s": found.readout_s - setting.readout_s,
        **dict(zip(LENS, lens.tolist(), strict=True)),
    }


@pytest.fixture(scope="module")
def short() -> Driven:
    return driven(3, SHORT)


def fitted(one: Driven, setting: Setting = SHORT, **options: object) -> MountFit:
    return fit_mount(one.views, setting.model, one.path, T_CLAIMED, **options)  # type: ignore[arg-type]


def test_mount_clock_and_shutter_are_found(short: Driven) -> None:
    found = fitted(short)
    off = errors(found, SHORT)
    for name in (*PLANE, *CLOCK):
        assert abs(off[name]) < 4.5 * found.sigma(name), name
    assert max(abs(off["x_m"]), abs(off["y_m"])) < 0.005
    assert max(abs(off[name]) for name in PLANE[2:]) < np.radians(0.1)
    assert abs(off["late_s"]) < 0.001
    assert found.sigma("x_m") < 0.003 and found.sigma("late_s") < 0.001


@pytest.mark.long
def test_a_robot_that_rocks_tells_the_mount_all_the_same() -> None:
    """By 0.2 degrees, as one does that stands on two wheels and a caster: more than a pixel."""
    rocking = replace(SHORT, tilt_sigma=0.004)
    found = fitted(driven(3, rocking), rocking)
    assert found.explains
    off = errors(found, rocking)
    for name in (*PLANE, *CLOCK):
        assert abs(off[name]) < 4.5 * found.sigma(name), name
    assert max(abs(off["x_m"]), abs(off["y_m"])) < 0.008
    assert abs(off["late_s"]) < 0.002


@pytest.mark.long
def test_a_path_in_the_plane_does_not_tell_the_height_but_a_survey_does(short: Driven) -> None:
    blind = fitted(short)
    assert blind.sigma("z_m") > 0.5
    assert blind.T_base_camera[2, 3] == pytest.approx(T_CLAIMED[2, 3], abs=0.002)
    sigmas = np.array([0.002] * 3 + [0.01] * 3)
    turned = moved_survey(short.tags, np.array([2.0, -1.0, 0.7]))
    told = fitted(short, survey={k: (T, sigmas) for k, T in enumerate(turned)})
    assert abs(errors(told, SHORT)["z_m"]) < 4.5 * told.sigma("z_m") < 0.02
    assert abs(errors(told, SHORT)["x_m"]) < 0.005


def moved_survey(tags: FloatArray, by: FloatArray) -> FloatArray:
    """(m, 4, 4) in a frame that is not the map's."""
    T = np.eye(4)
    T[:2, :2] = [[np.cos(by[2]), -np.sin(by[2])], [np.sin(by[2]), np.cos(by[2])]]
    T[:2, 3] = by[:2]
    return np.asarray(T @ tags)


def test_a_lens_that_is_claimed_wrong_is_found(short: Driven) -> None:
    claimed = with_lens(SHORT.model, np.array([4.0, 4.0, -3.0, 2.0, 0, 0, 0, 0, 0]))
    found = fit_mount(short.views, claimed, short.path, T_CLAIMED, free=USUAL_FREE | ALL_LENS)
    off = errors(found, SHORT)
    for name in LENS:
        assert abs(off[name]) < 4.5 * found.sigma(name), name
        assert found.sigma(name) < 1.0


def test_edges_that_are_all_seen_outwards_are_no_longer_focal_length(short: Driven) -> None:
    """By 0.04 px for tags of 20 px, less for larger ones: twice what is seen in rendered worlds."""
    corners_px = short.views.corners_px
    from_middle = corners_px - corners_px.mean(axis=1, keepdims=True)
    sides = np.linalg.norm(corners_px - np.roll(corners_px, 1, axis=1), axis=2).mean(axis=1)
    outwards = 0.04 * np.minimum(1.0, np.square(20.0 / sides)) / (0.5 * sides)
    moved = corners_px + outwards[:, None, None] * from_middle
    views = replace(short.views, corners_px=moved)
    found = fit_mount(views, SHORT.model, short.path, T_CLAIMED, free=USUAL_FREE | ALL_LENS)
    off = errors(found, SHORT)
    for name in ("fx_px", "fy_px"):
        assert abs(off[name]) < 2.0 * found.sigma(name), name
        assert found.sigma(name) < 0.7


def test_sightings_under_a_wrong_number_count_for_little() -> None:
    seldom = driven(3, SPARSE)
    numbers = seldom.views.numbers.copy()
    numbers[::11] = (numbers[::11] + 1) % 16
    mistaken = replace(seldom, views=replace(seldom.views, numbers=numbers))
    found = fitted(mistaken)
    assert found.doubted > 0.7 * len(numbers[::11])
    off = errors(found, SHORT)
    assert max(abs(off["x_m"]), abs(off["y_m"])) < 0.008
    assert abs(off["late_s"]) < 0.002


SLOW = pytest.mark.slow
TURNED = {"backwards": (0.0, np.pi), "upside down": (np.pi, 0.0), "aside": (np.pi, np.pi / 2)}


@cache
def looking(roll_rad: float, yaw_rad: float) -> tuple[Setting, Driven]:
    true = off_by(np.zeros(6))
    true[:3, :3] = matrix_from_rpy(roll_rad, 0.03, yaw_rad) @ true[:3, :3]
    setting = replace(SPARSE, T_base_camera=true)
    return setting, driven(3, setting)


@pytest.mark.long
@pytest.mark.parametrize(
    ("turned", "claimed"),
    [
        *(pytest.param(turned, [], id=f"unclaimed-{turned}") for turned in TURNED),
        pytest.param("upside down", [T_CLAIMED], id="claimed ahead-upside down"),
        pytest.param("backwards", [T_CLAIMED], id="claimed ahead-backwards", marks=SLOW),
        pytest.param("aside", [T_CLAIMED], id="claimed ahead-aside", marks=SLOW),
    ],
)
def test_a_camera_that_looks_anywhere_is_found(turned: str, claimed: list[FloatArray]) -> None:
    setting, one = looking(*TURNED[turned])
    start = best_start(one.views, setting.model, one.path, claimed)
    found = fit_mount(one.views, setting.model, one.path, start)
    off = errors(found, setting)
    assert found.explains and max(abs(off[name]) for name in ("x_m", "y_m")) < 0.005
    assert max(abs(off[name]) for name in MOUNT[3:]) < np.radians(0.1)


def test_tags_that_are_seen_tilted_the_wrong_way_do_not_hide_the_mount(short: Driven) -> None:
    rng, poses = np.random.default_rng(2), short.views.T_camera_tag.copy()
    wrong = rng.random(len(poses)) < 0.2
    poses[wrong, :, :3, :3] = poses[wrong, :, :3, :3] @ matrix_from_rpy(0.0, 0.6, 0.0)
    views = replace(short.views, T_camera_tag=poses)
    found = mount_by_motions(views, SmoothPath(short.path), 0.4)
    step = np.linalg.norm(found[:2, 3] - SHORT.T_base_camera[:2, 3])
    turn = Rotation.from_matrix(found[:3, :3] @ SHORT.T_base_camera[:3, :3].T).magnitude()
    assert step < 0.05 and turn < np.radians(3.0)
    few = views.those(np.arange(3))
    with pytest.raises(NoSolution, match="turned too little"):
        mount_by_motions(few, SmoothPath(short.path), 0.4)


def test_what_an_unclaimed_mount_lacks_is_told(short: Driven) -> None:
    straight = replace(short.path, poses=short.path.poses * [1.0, 1.0, 0.0])
    with pytest.raises(NoSolution, match="turned too little"):
        best_start(short.views, SHORT.model, straight, [])


@pytest.mark.long
def test_the_path_of_another_robot_explains_nothing() -> None:
    seldom = driven(3, replace(SPARSE, seconds=15.0))
    other = replace(seldom.path, poses=seldom.path.poses[::-1].copy())
    with suppress(NoSolution):
        start = best_start(seldom.views, SHORT.model, other, [T_CLAIMED])
        assert not fit_mount(seldom.views, SHORT.model, other, start).explains


def problem(one: Driven, model: CameraModel) -> Drive:
    """The equations somewhere near the solution, everything free, all tags surveyed."""
    views = one.views.those(np.arange(0, len(one.views), 40))
    numbers, tag_of = np.unique(views.numbers, return_inverse=True)
    path = SmoothPath(one.path)
    free = frozenset((*MOUNT, *CLOCK, *lens_names(model), "survey_x_m", "survey_yaw_rad"))
    sigmas = np.full((len(numbers), 6), 0.01)
    surveyed = moved_survey(one.tags[numbers], np.array([0.3, -0.2, 0.4]))
    near = off_by(np.array([0.01, -0.02, 0.01, 0.01, -0.01, 0.02]))
    return Drive(
        *(views, path, tag_of, model, near, 0.01, 0.015, one.tags[numbers], free),
        survey=Survey(surveyed, sigmas),
        T_survey_map=np.array([0.3, -0.2, 0.39]),
        scale=1e6,
    )


@pytest.mark.parametrize(
    "model",
    [
        pinhole(424, 240, 69.0),
        pinhole(424, 240, 69.0, "plumb_bob", np.array([-0.2, 0.05, 1e-3, -1e-3, 0.0])),
        pinhole(424, 240, 120.0, "equidistant", np.array([0.02, -0.005])),
    ],
)
def test_slopes_are_those_of_finite_differences(short: Driven, model: CameraModel) -> None:
    at = problem(short, model)
    equations = at.equations()
    size = len(equations.gradient)
    rng = np.random.default_rng(1)
    for _ in range(6):
        direction = rng.normal(size=size) * 1e-6
        up, down = (at.moved(sign * direction).equations().cost for sign in (1.0, -1.0))
        expected = 2.0 * float(equations.gradient @ direction)
        assert 0.5 * (up - down) == pytest.approx(expected, rel=1e-3)


def test_sums_over_blocks_need_no_zeros() -> None:
    """Of sightings of nine groups in five blocks, one of them empty: term by term."""
    rng, count = np.random.default_rng(7), 60
    shared, own, off = (rng.normal(size=(count, 4, size)) for size in (3, 2, 1))
    roots, group, block = (
        rng.normal(size=(count, 4, 4)),
        rng.integers(0, 9, count),
        rng.choice([0, 1, 3, 4], count),
    )
    slopes = GroupedSlopes(shared, own, group, 9).times(roots)
    gained, gradients = by_blocks(off[:, :, 0], slopes.of, block, 5)

    expected, pulls = np.zeros((5, 21, 21)), np.zeros((5, 21))
    for n in range(count):
        whole = np.zeros((4, 21))
        whole[:, :3] = shared[n]
        whole[:, 3 + 2 * group[n] : 5 + 2 * group[n]] = own[n]
        whole = roots[n] @ whole
        expected[block[n]] += whole.T @ whole
        pulls[block[n]] += whole.T @ off[n, :, 0]
    assert np.allclose(gained, expected, rtol=0.0, atol=1e-9)
    assert np.allclose(gradients, pulls, rtol=0.0, atol=1e-9)


def test_too_little_is_told_with_what_is_needed(short: Driven) -> None:
    few = short.views.those(np.arange(20))
    with pytest.raises(TooFew, match=f"20 times .* of 20 in all; {FEWEST_SIGHTINGS} times"):
        fit_mount(few, SHORT.model, short.path, T_CLAIMED)
    since_s = (short.views.stamps_ns - short.views.stamps_ns.min()) * 1e-9
    brief = short.views.those(since_s < 3.0 * BLOCK_S)
    if len(brief) >= FEWEST_SIGHTINGS:
        with pytest.raises(TooFew, match="spells"):
            fit_mount(brief, SHORT.model, short.path, T_CLAIMED)
    elsewhere = replace(short.views, stamps_ns=short.views.stamps_ns + 10**12)
    with pytest.raises(TooFew, match="0 times along the path"):
        fit_mount(elsewhere, SHORT.model, short.path, T_CLAIMED)


def test_a_path_of_one_pose_is_refused() -> None:
    with pytest.raises(BadNumbers, match="single pose"):
        SmoothPath(PlanarTrajectory(np.array([0]), np.zeros((1, 3))))


def test_a_path_is_not_taken_for_known_in_a_gap() -> None:
    stamps_ns = np.concatenate([np.arange(0, 20), np.arange(40, 60)]) * 100_000_000
    path = SmoothPath(PlanarTrajectory(stamps_ns, np.zeros((40, 3))))
    asked_s = np.array([0.1, 1.0, 3.0, 5.0, 5.8])
    assert path.covers(asked_s).tolist() == [False, True, False, True, False]


def test_a_robot_that_stands_tells_nothing(short: Driven) -> None:
    still = PlanarTrajectory(short.path.stamps_ns, np.zeros_like(short.path.poses))
    same = short.views.those(np.zeros(80, dtype=np.int64))
    noise = np.random.default_rng(2).normal(0.0, SHORT.noise_px, (80, 4, 2))
    at_ns = 400_000_000 + np.arange(80) * 300_000_000
    repeated = replace(same, stamps_ns=at_ns, corners_px=same.corners_px + noise)
    found = fit_mount(repeated, SHORT.model, still, T_CLAIMED)
    assert min(found.sigma(name) for name in (*MOUNT, "late_s")) > 0.1


@pytest.mark.slow
def test_intervals_hold() -> None:
    """Of 60 drives of a minute, 95 % intervals hold the truth in 93 to 97 %, all values together;
    the largest errors are within the issue's: 5 mm, 0.1 degrees, 1 ms."""
    setting, inside, largest = Setting(), [], np.zeros(3)
    for seed in range(100, 160):
        found = fitted(driven(seed, setting), setting)
        off = errors(found, setting)
        inside += [abs(off[name]) < 1.96 * found.sigma(name) for name in (*PLANE, *CLOCK)]
        shift = max(abs(off["x_m"]), abs(off["y_m"]))
        turn = max(abs(off[name]) for name in PLANE[2:])
        largest = np.maximum(largest, [shift, turn, abs(off["late_s"])])
    assert 0.93 <= np.mean(inside) <= 0.97
    assert (largest < [0.005, np.radians(0.1), 0.001]).all()
