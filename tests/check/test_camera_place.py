"""What scans and gyroscope tell of cameras, on rooms and panoramas that are computed here."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, zoom

from slamsim.cameras.align import DepthAlignment
from slamsim.cameras.depth_model import correlated_noise
from slamsim.cameras.frames import CameraClaim
from slamsim.cameras.lens import pinhole
from slamsim.cameras.survey import CameraSurvey
from slamsim.check.evidence import RecordingEvidence
from slamsim.check.findings import Finding, Measurement, decide
from slamsim.check.motion.depth_floor import fit_floor
from slamsim.check.motion.depth_slices import NAMES, SliceFit, fit_slices
from slamsim.check.motion.image_leans import SeenLeans, fit_readout, seen_leans
from slamsim.check.motion.image_turns import SeenTurns, TurnFit, fit_turns, seen_turns
from slamsim.check.motion.integrated import IntegratedMotion
from slamsim.check.questions.cameras.axes import check_axes
from slamsim.check.questions.cameras.colours import likeness
from slamsim.check.questions.cameras.depth import check_unit
from slamsim.check.questions.cameras.place import before_the_axle_m, check_place, check_turns
from slamsim.check.questions.cameras.shutter import check_shutter
from slamsim.check.questions.cameras.stereo import check_stereo
from slamsim.check.questions.cameras.tilt import check_tilt
from slamsim.config.faults import FaultChoice
from slamsim.config.loading import load_run_config
from slamsim.core.geometry import matrix_from_rpy, se3_from_parts, xyzw_from_matrix, xyzw_from_yaw
from slamsim.core.types import FloatArray, IntArray
from slamsim.io.cameras.survey import read_with_cameras
from slamsim.recording import (
    RawImu,
    RawOdometry,
    RawScans,
    Recording,
    ScanLayout,
    TransformEdge,
)
from slamsim.recording.repairs.apply import apply_repairs
from slamsim.sensors.faults.registry import chosen_fault, injected
from slamsim.simulation.simulate import simulate

R_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
ROOM_M = np.array([[-2.0, 3.5], [-1.5, 2.5]])
SECONDS, SCAN_NS, IMAGE_NS = 20.0, 100_000_000, 100_000_000
WIDTH, HEIGHT, FOV_DEG = 48, 36, 80.0
LIDAR_HEIGHT_M, CAMERA_HEIGHT_M = 0.2, 0.3
Claimed = tuple[CameraSurvey, FloatArray]


def poses(at_ns: IntArray) -> FloatArray:
    """(n, 3) of a robot that weaves about the middle of the room."""
    t = at_ns * 1e-9
    yaw = 0.8 * np.sin(0.9 * t) + 0.25 * t
    return np.column_stack([0.5 + 0.9 * np.sin(0.3 * t), 0.5 + 0.6 * np.cos(0.4 * t), yaw])


def distances(origins: FloatArray, angles: FloatArray) -> FloatArray:
    """Along rays in the plane to the walls of the room; a pillar stands in a corner of it."""
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    with np.errstate(divide="ignore"):
        steps = [
            np.where(
                directions[..., k] * side > 0.0,
                (wall - origins[..., k]) / directions[..., k],
                np.inf,
            )
            for k in range(2)
            for wall, side in zip(ROOM_M[k], (-1.0, 1.0), strict=True)
        ]
    along = ((np.array([2.6, 1.6]) - origins) * directions).sum(axis=-1)
    off = np.square(np.array([2.6, 1.6]) - origins).sum(axis=-1) - along**2
    pillar = np.where(
        (off < 0.3**2) & (along > 0), along - np.sqrt(np.maximum(0.09 - off, 0.0)), np.inf
    )
    return np.asarray(np.min([*steps, pillar], axis=0))


@cache
def recording() -> Recording:
    odometry_ns = np.arange(-(10**9), round((SECONDS + 1.0) * 1e9), 20_000_000, dtype=np.int64)
    path, zeros = poses(odometry_ns), np.zeros((odometry_ns.size, 3))
    odometry = RawOdometry(
        *("/odom", ("odom",), odometry_ns, None, ("base_link",)),
        *(np.column_stack([path[:, :2], 0.0 * path[:, 0]]), xyzw_from_yaw(path[:, 2])),
        *(zeros, zeros),
    )
    stamps_ns = np.arange(0, round(SECONDS * 1e9), SCAN_NS, dtype=np.int64)
    layout = ScanLayout(-np.pi, np.pi, np.radians(1.0), 1e-4, 0.1, 0.05, 12.0)
    beams = np.arange(360)
    then = poses((stamps_ns[:, None] + 100_000 * beams).ravel()).reshape(-1, 360, 3)
    angles = then[..., 2] - np.pi + np.radians(1.0) * beams
    scans = RawScans(
        *("/scan", ("laser",), stamps_ns, None, (layout,)),
        *(np.zeros(stamps_ns.size, np.int32), distances(then[..., :2], angles).astype(np.float32)),
    )
    return Recording("room", "memory", streams=(odometry, scans))


def claim_of(model: Any) -> CameraClaim:
    about = (model.width, model.height, model.distortion_model, model.coefficients, model.K)
    return CameraClaim("topic /info", "camera", *about)


def survey(kind: Any, stamps_ns: IntArray, model: Any, **seen: Any) -> CameraSurvey:
    count = np.arange(stamps_ns.size)
    nothing: dict[str, Any] = {
        "brightness": np.full(count.size, 90.0),
        "depths_m": np.full((count.size, 3), np.nan),
        "thumbnails": np.zeros((0, 0, 0), np.uint8),
        "numbers": count,
    }
    return CameraSurvey(
        *("/images", kind, "camera", (model.width, model.height), claim_of(model)),
        *(stamps_ns, stamps_ns, count.astype(np.uint32), count),
        **{**nothing, **seen},
    )


@cache
def seen_from(x_m: float, y_m: float, yaw_rad: float, scale: float, delay_s: float) -> Claimed:
    """Depth images of a level camera there, and where it truly is."""
    model = pinhole(WIDTH, HEIGHT, FOV_DEG)
    stamps_ns = np.arange(50_000_000, round((SECONDS - 0.5) * 1e9), IMAGE_NS, dtype=np.int64)
    base = poses(stamps_ns - round(1e9 * delay_s))
    cos, sin = np.cos(base[:, 2]), np.sin(base[:, 2])
    origins = base[:, :2] + np.column_stack([cos * x_m - sin * y_m, sin * x_m + cos * y_m])
    rays = model.rays()
    azimuths = -np.arctan2(rays[:, 0], rays[:, 2])
    grids = []
    for origin, heading in zip(origins, base[:, 2] + yaw_rad, strict=True):
        flat_m = distances(np.tile(origin, (len(rays), 1)), heading + azimuths)
        depth_m = flat_m * np.cos(azimuths)
        drop = rays[:, 1] / rays[:, 2]
        floor_m = np.where(drop > 0.0, CAMERA_HEIGHT_M / np.maximum(drop, 1e-9), np.inf)
        grids.append(scale * np.minimum(depth_m, floor_m).reshape(HEIGHT, WIDTH))
    T = se3_from_parts(
        matrix_from_rpy(0.0, 0.0, yaw_rad) @ R_OPTICAL, np.array([x_m, y_m, CAMERA_HEIGHT_M])
    )
    grids_m = np.array(grids, dtype=np.float32)
    return survey("depth", stamps_ns, model, grids_m=grids_m), T


TILTS = st.floats(-0.3, 0.3)


@settings(max_examples=12, deadline=None)
@given(TILTS, TILTS, st.integers(0, 2**32 - 1))
def test_the_floor_tells_which_way_is_up(pitch_rad: float, roll_rad: float, seed: int) -> None:
    """Beside walls, with noise, and with a table that is nearer in a third of the images."""
    depth, T = seen_from(0.1, 0.05, 0.3, 1.0, 0.0)
    rng = np.random.default_rng(seed)
    grids_m = depth.grids_m * (1.0 + 0.003 * depth.grids_m * rng.normal(size=depth.grids_m.shape))
    grids_m[::3, int(0.8 * HEIGHT) :] *= 0.6
    R_claimed = T[:3, :3] @ matrix_from_rpy(pitch_rad, 0.0, roll_rad).T
    found = fit_floor(replace(depth, grids_m=grids_m.astype(np.float32)), R_claimed)
    assert found is not None
    assert found.up @ T[2, :3] > np.cos(np.radians(0.3))
    assert found.height_m == pytest.approx(CAMERA_HEIGHT_M, abs=0.01)


@pytest.mark.long
@pytest.mark.parametrize(
    ("pitch_deg", "roll_deg", "question"), [(6.0, 0.0, "pitch"), (0.0, -4.0, "roll")]
)
def test_a_tilted_camera_is_told_and_set_right(
    pitch_deg: float, roll_deg: float, question: str
) -> None:
    depth, T = seen_from(0.1, 0.05, 0.3, 1.0, 0.0)
    T_claimed = T.copy()
    T_claimed[:3, :3] = T[:3, :3] @ matrix_from_rpy(*np.radians([pitch_deg, 0.0, roll_deg])).T
    wrong = with_mount(depth, T_claimed)
    told = {one.check: one for one in check_tilt(RecordingEvidence(wrong)) if one.fault}
    (found,) = told.values()
    assert found.check == f"camera.{question}" and found.fault == "camera_mount"
    assert found.estimate is not None
    assert found.estimate.value == pytest.approx(pitch_deg + roll_deg, abs=0.3)
    places = [one for one in check_place(RecordingEvidence(wrong)) if one.fault]
    assert not places  # a tilt is no other place

    right = apply_repairs(wrong, found.repairs)
    assert not [one for one in check_tilt(RecordingEvidence(right)) if one.fault]
    T_right = RecordingEvidence(right).frames.between("base_link", "camera")
    assert T_right is not None
    np.testing.assert_allclose(T_right[2, :3], T[2, :3], atol=0.006)


def test_a_camera_at_another_height_is_told_and_set_right() -> None:
    depth, T = seen_from(0.1, 0.05, 0.3, 1.0, 0.0)
    T_claimed = T.copy()
    T_claimed[2, 3] += 0.1
    wrong = with_mount(depth, T_claimed, "base_footprint")
    (found,) = (one for one in check_tilt(RecordingEvidence(wrong)) if one.fault)
    assert found.check == "camera.z" and found.estimate is not None
    assert found.estimate.value == pytest.approx(-100.0, abs=6.0)
    right = apply_repairs(wrong, found.repairs)
    assert not [one for one in check_tilt(RecordingEvidence(right)) if one.fault]
    of_base_link = check_tilt(RecordingEvidence(with_mount(depth, T_claimed)))
    assert [one.verdict for one in of_base_link if one.check == "camera.z"] == ["inconclusive"]


def test_without_a_floor_nothing_is_told_of_tilts() -> None:
    depth, T = seen_from(0.1, 0.05, 0.3, 1.0, 0.0)
    walls = depth.grids_m.copy()
    walls[:, HEIGHT // 2 :] = np.nan
    found = list(check_tilt(RecordingEvidence(with_mount(replace(depth, grids_m=walls), T))))
    assert [one.verdict for one in found] == ["inconclusive"] * 3
    assert all("show a floor" in one.words for one in found)


@pytest.mark.long
@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.0, np.nan, np.inf, 1e-30, 1e30, 2.0]),
    st.floats(0.0, 1.0),
)
def test_hopeless_depths_never_break_it(seed: int, value: float, share: float) -> None:
    depth, T = seen_from(0.1, 0.05, 0.3, 1.0, 0.0)
    rng = np.random.default_rng(seed)
    grids_m = depth.grids_m.copy()
    grids_m[rng.random(grids_m.shape) < share] = value
    grids_m[:, rng.integers(0, HEIGHT) :, rng.integers(0, WIDTH) :] = value
    for one in check_tilt(RecordingEvidence(with_mount(replace(depth, grids_m=grids_m), T))):
        assert one.estimate is None or np.isfinite(one.estimate.sigma)


def with_mount(depth: CameraSurvey, T: FloatArray, base: str = "base_link") -> Recording:
    """The recording with a camera and a lidar at these places of the base."""
    lidar = np.eye(4)
    lidar[2, 3] = LIDAR_HEIGHT_M
    edges = [
        TransformEdge(
            *("/tf_static", base, frame, True, np.zeros(1, np.int64), None),
            *(place[None, :3, 3], xyzw_from_matrix(place[:3, :3])[None]),
        )
        for frame, place in (("camera", T), ("laser", lidar))
    ]
    whole = recording()
    odometry = [replace(one, child_frame_ids=(base,)) for one in whole.odometries]
    whole = whole.with_streams(RawOdometry, odometry)
    return replace(whole, transforms=tuple(edges), cameras=(depth,))


def fitted(depth: CameraSurvey, T_claimed: FloatArray) -> SliceFit:
    T_base_laser = se3_from_parts(np.eye(3), np.array([0.0, 0.0, LIDAR_HEIGHT_M]))
    told = recording()
    found = fit_slices(told, depth, told.scans[0], T_claimed, T_base_laser)
    assert found is not None
    return found


@pytest.mark.long
@pytest.mark.parametrize(
    ("place", "scale", "focal", "delay_s"),
    [
        ((0.0, 0.0, 0.0), 1.0, 1.0, 0.37),
        ((0.03, 0.02, np.radians(-2.0)), 0.97, 0.96, -0.05),
        *(
            pytest.param(*alone, marks=pytest.mark.slow)
            for alone in (
                ((0.0, 0.0, 0.0), 1.0, 1.0, 0.0),
                ((0.06, -0.04, np.radians(4.0)), 1.0, 1.0, 0.0),
                ((0.0, 0.0, 0.0), 1.04, 1.0, 0.0),
                ((0.0, 0.0, 0.0), 1.0, 1.06, 0.0),
                ((0.0, 0.0, 0.0), 1.0, 1.0, 0.08),
            )
        ),
    ],
)
def test_one_fit_tells_place_scale_focal_length_and_delay(
    place: tuple[float, float, float], scale: float, focal: float, delay_s: float
) -> None:
    """The camera claims to be at (0.1, 0) ahead; its depths, focal length and stamps are off."""
    depth, T_true = seen_from(0.1 + place[0], place[1], place[2], scale, delay_s)
    _, T_claimed = seen_from(0.1, 0.0, 0.0, 1.0, 0.0)
    assert depth.claim is not None
    K = depth.claim.K * np.array([[focal], [focal], [1.0]])
    K[:2, 2] = depth.claim.K[:2, 2]
    found = fitted(replace(depth, claim=replace(depth.claim, K=K)), T_claimed)
    wanted = (*place, 1.0 / scale - 1.0, 1.0 - focal, delay_s)
    within = (8e-3, 8e-3, 3e-3, 6e-3, 6e-3, 3e-3)
    for name, value, true, most in zip(NAMES, found.values, wanted, within, strict=True):
        assert abs(value - true) < most, (name, value, true)
    assert T_true[0, 3] == pytest.approx(0.1 + place[0])


@pytest.mark.long
@pytest.mark.usefixtures("drives_here")
def test_a_camera_far_from_its_claimed_place_is_not_taken_for_one_of_other_sizes(
    tmp_path: Path,
) -> None:
    """Between walls a metre away, nearer to them is nearly as if depths and focal length were
    wrong: 25 rounds of the fit found 86 of 200 mm, and depths 4 % too short."""
    lens = "{width: 80, height: 60, horizontal_fov_deg: 87}"
    depth = f"{{kind: depth, encoding: png, lens: {lens}, depth: {{is_exact: true}}}}"
    about = "rate_hz: 4, mount: {x_m: 0.1, z_m: 0.3, yaw_deg: 10}"
    camera = f"{{type: camera, name: cam, {about}, imagers: {{depth: {depth}}}}}"
    overrides = ["drive.route.max_duration_s=15.0", f"sensors.additional=[{camera}]"]
    simulate(load_run_config("labyrinth", None, overrides, 3), tmp_path / "log")
    healthy = read_with_cameras(tmp_path / "log")
    for by_m in (0.0, 0.2, -0.2):
        moved = chosen_fault(FaultChoice(name="camera_moved", size=by_m))
        recording = injected(healthy, [moved], 1)
        evidence, (camera_there,) = RecordingEvidence(recording), recording.cameras
        places = [
            evidence.frames.between(evidence.base, frame)
            for frame in (camera_there.frame_id, recording.scans[0].frame_ids[0])
        ]
        assert places[0] is not None and places[1] is not None
        fit = fit_slices(recording, camera_there, recording.scans[0], places[0], places[1])
        assert fit is not None
        found = dict(zip(NAMES, fit.values, strict=True))
        assert found["x_m"] == pytest.approx(by_m, abs=5e-3)
        assert abs(found["scale"]) < 3e-3 and abs(found["focal"]) < 3e-3


@cache
def registered_depths() -> Claimed:
    """Noisy depth images in the pixels of a camera beside, and where that is."""
    model, wide_m, noise_px, baseline_m = pinhole(640, 80, 80.0), 0.06, 0.065, 0.05
    stamps_ns = np.arange(50_000_000, round((SECONDS - 0.5) * 1e9), IMAGE_NS, dtype=np.int64)
    T_base_depth = se3_from_parts(R_OPTICAL, np.array([0.1, 0.0, CAMERA_HEIGHT_M]))
    T_base_camera = se3_from_parts(R_OPTICAL, np.array([0.1, wide_m, CAMERA_HEIGHT_M]))
    alignment = DepthAlignment(model, model, np.linalg.inv(T_base_camera) @ T_base_depth)
    azimuths = -np.arctan2(*model.rays()[:640, [0, 2]].T)
    rng, step = np.random.default_rng(5), 8
    grids = []
    for x_m, y_m, yaw in poses(stamps_ns).tolist():
        origin = np.array([x_m + 0.1 * np.cos(yaw), y_m + 0.1 * np.sin(yaw)])
        flat_m = distances(np.tile(origin, (640, 1)), yaw + azimuths) * np.cos(azimuths)
        disparity_px = model.focal_px[0] * baseline_m / np.tile(flat_m, (80, 1))
        noisy_px = disparity_px + noise_px * correlated_noise(disparity_px.shape, 5, rng)
        depths_mm = np.rint(1e3 * model.focal_px[0] * baseline_m / noisy_px).astype(np.uint16)
        aligned = alignment.aligned(depths_mm)[step // 2 :: step, step // 2 :: step]
        grids.append(np.where(aligned > 0, 1e-3 * aligned, np.nan))
    grids_m = np.array(grids, dtype=np.float32)
    return survey("depth", stamps_ns, model, grids_m=grids_m, grid_px=step), T_base_camera


@pytest.mark.long
@pytest.mark.parametrize(("factor", "verdict"), [(1.0, "ok"), (1.05, "fault"), (0.95, "fault")])
def test_depths_in_the_pixels_of_another_camera_are_as_long_as_ranges_or_not(
    factor: float, verdict: str
) -> None:
    """The nearest of several in a pixel is kept: they are 1 % too short where nothing is wrong."""
    healthy, T = registered_depths()
    depth = replace(healthy, grids_m=(factor * healthy.grids_m).astype(np.float32))
    beside = replace(depth, topic="/colour", kind="colour", grids_m=np.zeros((0, 0, 0), np.float32))
    whole = replace(with_mount(depth, T), cameras=(depth, beside))
    found = {one.check: one for one in check_place(RecordingEvidence(whole))}
    scale = found.pop("camera.depth_scale")
    assert scale.verdict == verdict, scale.words
    assert not [one for one in found.values() if one.fault]


def test_what_images_that_look_one_way_mix_up_is_less_sure() -> None:
    """Towards the same walls, place, scale and focal length change what is seen alike."""
    depth, T = registered_depths()
    headings = poses(depth.stamps_ns)[:, 2]
    same_way = np.flatnonzero(np.abs(np.angle(np.exp(1j * (headings - headings[20])))) < 0.15)
    sizes = [NAMES.index("scale"), NAMES.index("focal")]
    few, all_ways = fitted(depth.selected(same_way), T), fitted(depth, T)
    assert np.all(few.mixed[sizes] > 1.5 * all_ways.mixed[sizes])


def test_a_depth_camera_on_its_side_is_measured_like_one_that_stands() -> None:
    """With noise of its depths, by which alone rows would cross the height of the lidar."""
    depth, T = seen_from(0.1, 0.0, 0.0, 1.0, 0.0)
    assert depth.claim is not None
    rng = np.random.default_rng(3)
    noise = 1.0 + rng.normal(0.0, 0.01, depth.grids_m.shape)
    grids_m = np.rot90(depth.grids_m * noise, axes=(1, 2)).astype(np.float32)
    K = depth.claim.K.copy()
    K[:2, 2] = K[1::-1, 2]
    claim = replace(depth.claim, width=HEIGHT, height=WIDTH, K=K)
    on_its_side = replace(depth, size=(HEIGHT, WIDTH), claim=claim, grids_m=grids_m)
    R = T[:3, :3] @ matrix_from_rpy(0.0, 0.0, np.pi / 2.0)
    found = fitted(on_its_side, se3_from_parts(R, T[:3, 3]))
    for name, value, sigma in zip(NAMES, found.values, found.sigmas, strict=True):
        assert abs(value) < 0.01, name
        assert sigma < 0.01, name


def test_images_without_walls_at_that_height_tell_nothing() -> None:
    depth, T_near = seen_from(0.1, 0.0, 0.0, 1.0, 0.0)
    T = T_near.copy()
    T[2, 3] = 5.0
    T_base_laser = se3_from_parts(np.eye(3), np.array([0.0, 0.0, LIDAR_HEIGHT_M]))
    told = recording()
    assert fit_slices(told, depth, told.scans[0], T, T_base_laser) is None
    nowhere = replace(told, streams=told.scans)
    assert fit_slices(nowhere, depth, told.scans[0], T, T_base_laser) is None


def test_a_camera_info_of_another_size_tells_nothing_of_the_place() -> None:
    depth, T = seen_from(0.1, 0.0, 0.0, 1.0, 0.0)
    assert depth.claim is not None
    halved = replace(depth, claim=replace(depth.claim, width=WIDTH // 2, height=HEIGHT // 2))
    found = list(check_place(RecordingEvidence(with_mount(halved, T))))
    assert {one.verdict for one in found} == {"inconclusive"}
    assert all("another size" in one.words for one in found)


def test_depths_in_another_unit_tell_nothing() -> None:
    """No point is near a scan, and an offset of nought would be taken for a good place."""
    depth, T = seen_from(0.1, 0.0, 0.0, 1.0, 0.0)
    T_base_laser = se3_from_parts(np.eye(3), np.array([0.0, 0.0, LIDAR_HEIGHT_M]))
    told = recording()
    far = replace(depth, grids_m=1000.0 * depth.grids_m)
    assert fit_slices(told, far, told.scans[0], T, T_base_laser) is None


@pytest.mark.long
def test_the_delay_of_a_robot_that_stands_is_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    def still(at_ns: IntArray) -> FloatArray:
        return np.tile([0.5, 0.5, 0.4], (at_ns.size, 1))

    monkeypatch.setitem(globals(), "poses", still)
    monkeypatch.setitem(globals(), "recording", recording.__wrapped__)
    found = fitted(*seen_from.__wrapped__(0.1, 0.0, 0.0, 1.0, 0.0))
    assert found.sigmas[NAMES.index("delay_s")] > 0.9
    assert found.sigmas[NAMES.index("yaw_rad")] < 0.01


@pytest.mark.parametrize(
    "pose", [(2.3, 0.2, -0.1), (0.5, 0.5, np.pi), (0.0, -0.5, -2.4)], ids=["wall", "room", "corner"]
)
def test_a_camera_whose_robot_stands_has_no_fault(
    monkeypatch: pytest.MonkeyPatch, pose: tuple[float, float, float]
) -> None:
    """All depths shrunk to nothing, and the camera moved onto the wall, fit the scans exactly."""

    def still(at_ns: IntArray) -> FloatArray:
        return np.tile(pose, (np.size(at_ns), 1))

    monkeypatch.setitem(globals(), "poses", still)
    monkeypatch.setitem(globals(), "recording", recording.__wrapped__)
    depth, T_claimed = seen_from.__wrapped__(0.1, 0.0, 0.0, 1.0, 0.0)
    noise = 0.003 * np.random.default_rng(1).normal(size=depth.grids_m.shape)
    noisy_m = (depth.grids_m * (1.0 + noise * depth.grids_m)).astype(np.float32)
    told = with_mount(replace(depth, grids_m=noisy_m), T_claimed)

    found = list(check_place(RecordingEvidence(told)))

    assert found and not [finding.fault for finding in found if finding.fault]


@pytest.mark.parametrize(("depth_m", "factors"), [(2000.0, [1e-3]), (0.002, [])])
def test_float_depths_are_never_made_smaller_still(depth_m: float, factors: list[float]) -> None:
    depths_m = np.full((20, 3), depth_m)
    depth = survey("depth", np.arange(20), pinhole(40, 30, 70.0), depths_m=depths_m, is_metric=True)
    (found,) = check_unit(RecordingEvidence(Recording("a", "memory", cameras=(depth,))))
    assert found.verdict == "fault"
    assert [repair.parameters["factor"] for repair in found.repairs] == factors


def turned(t: NDArray[np.floating[Any]]) -> FloatArray:
    return np.asarray(0.5 * np.sin(1.3 * t) + 0.2 * np.sin(3.1 * t), np.float64)


def panorama() -> NDArray[np.float64]:
    """(rows, 2000): smooth noise and upright bars all around."""
    rng = np.random.default_rng(5)
    smooth = zoom(rng.uniform(20.0, 130.0, (15, 250)), (6, 8), order=1)
    bars = zoom(np.repeat(rng.uniform(0.0, 100.0, (1, 40)), 90, axis=0), (1, 50), order=0)
    return np.asarray(smooth + bars)


@cache
def turning_images(delay_s: float, readout_s: float, focal: float) -> CameraSurvey:
    model = pinhole(160, 90, 70.0)
    stamps_ns = np.arange(10**9, 21 * 10**9, 100_000_000, dtype=np.int64)
    columns, rows = np.meshgrid(np.arange(160.0), np.arange(90.0))
    azimuths = -np.arctan((columns - model.centre_px[0]) / model.focal_px[0])
    around = panorama()
    images = []
    for at_s in (stamps_ns * 1e-9 - delay_s).tolist():
        heading = turned(np.asarray(at_s + readout_s * rows / 89.0, dtype=np.float64))
        place = (heading + azimuths + np.pi) * around.shape[1] / (2.0 * np.pi)
        images.append(map_coordinates(around, [rows, place], order=1, mode="wrap"))
    model = replace(model, K=model.K * np.array([[focal], [focal], [1.0]]))
    return survey("grey", stamps_ns, model, thumbnails=np.array(images, dtype=np.uint8))


def turn_fit(camera: CameraSurvey) -> TurnFit | None:
    assert camera.claim is not None
    stamps_ns = np.arange(0, 22 * 10**9, 10_000_000, dtype=np.int64)
    totals = turned(np.asarray(stamps_ns * 1e-9, dtype=np.float64))[:, None]
    gyro = IntegratedMotion("/imu", stamps_ns, totals, np.array([1e-5]))
    model = camera.claim.model()
    leans = seen_leans(camera, model, R_OPTICAL)
    return fit_turns(seen_turns(camera, model, R_OPTICAL), leans, gyro)


def test_things_near_on_one_side_of_few_turns_make_the_delay_unsure() -> None:
    at_s = np.arange(0.0, 42.0, 0.01)
    rates = [
        rate * np.clip(np.minimum((at_s - begin) / 0.35, (begin + lasts - at_s) / 0.35), 0.0, 1.0)
        for begin, rate, lasts in ((29.5, 1.0, 2.1), (34.6, -0.2, 0.5), (36.2, 0.25, 1.6))
    ]
    totals = 0.01 * np.cumsum(np.sum(rates, axis=0))
    stamps_ns = (1e9 * at_s).round().astype(np.int64)
    gyro = IntegratedMotion("/imu", stamps_ns, totals[:, None], np.array([1e-5]))
    starts_s = np.sort(np.concatenate([np.arange(1.0, 40.0, 0.4), np.arange(1.1, 40.0, 0.4)]))
    pair = np.repeat(np.arange(starts_s.size), 2)
    first_s = starts_s[pair]
    turned_rad = np.interp(first_s + 0.1, at_s, totals) - np.interp(first_s, at_s, totals)
    # In the first turn something near comes into view and goes.
    nearer = np.interp(first_s, (29.5, 30.9, 31.4, 33.0, 33.1), (1.2, 1.2, 0.9, 0.9, 1.0))
    for seed in range(12):
        rng = np.random.default_rng(seed)
        others = np.where(first_s > 33.0, 0.2 * rng.random(20)[(first_s // 2.0).astype(int)], 0.0)
        seen = SeenTurns(
            (1e9 * first_s).astype(np.int64),
            (1e9 * (first_s + 0.1)).astype(np.int64),
            (nearer + others) * turned_rad + rng.normal(0.0, 7e-4, first_s.size),
            np.tile([0.25, 0.75], starts_s.size),
            pair,
        )
        fit = fit_turns(seen, SeenLeans(np.zeros(0, np.int64), np.zeros(0)), gyro)
        assert fit is not None
        delay_s, sigma_s = fit.delay_s
        assert abs(delay_s) < 2.5 * sigma_s < 0.12, seed


@pytest.mark.parametrize("gain", [0.6, 1.0, 1.7, 2.5, -1.0, -1.3])
@pytest.mark.parametrize("wild_share", [0.0, 0.1])
def test_delay_and_gain_are_found_however_far_images_turn(gain: float, wild_share: float) -> None:
    """On a robot that mostly went straight, a camera with 1.5 times the focal length was told to be
    118 ms late, and one that was mirrored was not; how sure that is depended on the delay."""
    at_s, totals = np.arange(0.0, 42.0, 0.01), np.zeros(4200)
    for begin, rate, lasts in ((6.0, 0.8, 2.0), (12.2, -0.7, 1.0), (25.0, -0.6, 1.5), (31, 0.5, 2)):
        ramps = np.minimum((at_s - begin) / 0.35, (begin + lasts - at_s) / 0.35)
        totals += 0.01 * np.cumsum(rate * np.clip(ramps, 0.0, 1.0))
    gyro = IntegratedMotion(
        "/imu", (1e9 * at_s).round().astype(np.int64), totals[:, None], np.array([1e-5])
    )
    first_s = np.repeat(np.arange(1.0, 40.0, 0.2), 2)
    rng, sigmas = np.random.default_rng(3), []
    nearer = 1.0 + 0.2 * rng.random(20)[(first_s // 2.0).astype(int)]
    turned_rad = np.interp(first_s + 0.1, at_s, totals) - np.interp(first_s, at_s, totals)
    turned_rad = gain * nearer * turned_rad + rng.normal(0.0, 2e-4, first_s.size)
    wild = rng.random(first_s.size) < wild_share
    turned_rad[wild] = rng.uniform(-0.5, 0.5, wild.sum())
    for delay_s in (0.0, 0.3):
        seen = SeenTurns(
            (1e9 * (first_s + delay_s)).astype(np.int64),
            (1e9 * (first_s + delay_s + 0.1)).astype(np.int64),
            turned_rad,
            np.tile([0.25, 0.75], first_s.size // 2),
            np.repeat(np.arange(first_s.size // 2), 2),
        )
        leans = SeenLeans(np.zeros(0, np.int64), np.zeros(0))
        assert fit_turns(seen, leans, replace(gyro, totals=np.zeros((4200, 1)))) is None
        fit = fit_turns(seen, leans, gyro)
        assert fit is not None
        assert abs(fit.delay_s[0] - delay_s) < 2.5 * fit.delay_s[1] < 0.1
        assert abs((1.0 + fit.gain[0]) / gain - 1.1) < 0.1
        sigmas.append(fit.delay_s[1])
    assert sigmas[0] == pytest.approx(sigmas[1], rel=1e-3)


@pytest.mark.long
@pytest.mark.parametrize(
    ("delay_s", "readout_s"),
    [(-0.2, 0.03), *(pytest.param(*one, marks=pytest.mark.slow) for one in ((0, 0), (0.06, 0.03)))],
)
def test_turns_of_images_tell_delay_and_readout(delay_s: float, readout_s: float) -> None:
    found = turn_fit(turning_images(delay_s, readout_s, 1.0))
    assert found is not None
    assert found.readout_s is not None
    assert found.delay_s[0] == pytest.approx(delay_s, abs=3e-3)
    assert found.readout_s[0] == pytest.approx(readout_s, abs=2e-3)
    assert found.readout_s[1] < 2e-3
    assert found.gain[0] == pytest.approx(0.0, abs=0.02)


def turning_recording(camera: CameraSurvey) -> Recording:
    """With the odometry of the same turns."""
    stamps_ns = np.arange(0, 22 * 10**9, 20_000_000, dtype=np.int64)
    yaw, none = turned(stamps_ns * 1e-9), np.zeros((stamps_ns.size, 3))
    odometry = RawOdometry(
        *("/odom", ("odom",), stamps_ns, None, ("base_link",)),
        *(none, xyzw_from_yaw(yaw), none, none),
    )
    return Recording("turns", "memory", streams=(odometry,), cameras=(camera,))


@pytest.mark.long
@pytest.mark.parametrize(
    ("readout_s", "told_s", "verdict"),
    [
        (0.0, None, "ok"),
        pytest.param(0.03, 0.03, "ok", marks=pytest.mark.slow),
        pytest.param(0.03, None, "fault", marks=pytest.mark.slow),
        pytest.param(0.03, 0.0, "fault", marks=pytest.mark.slow),
        pytest.param(0.0, 0.03, "fault", marks=pytest.mark.slow),
        (-0.03, None, "fault"),
    ],
)
def test_a_shutter_that_rolls_otherwise_than_told_is_a_fault(
    readout_s: float, told_s: float | None, verdict: str
) -> None:
    """By the odometry alone; a negative readout is that of a camera on its head."""
    camera = turning_images(0.0, readout_s, 1.0)
    assert camera.claim is not None
    camera = replace(camera, claim=replace(camera.claim, readout_s=told_s))
    (found,) = check_shutter(RecordingEvidence(turning_recording(camera)))
    assert found.verdict == verdict, found
    assert found.estimate is not None
    assert found.estimate.value == pytest.approx(1e3 * (readout_s - (told_s or 0.0)), abs=3.0)
    if verdict == "fault":
        assert found.fault == "camera_rolling_shutter"
        fixed = apply_repairs(turning_recording(camera), found.repairs)
        (again,) = check_shutter(RecordingEvidence(fixed))
        assert again.verdict == "ok", again


@pytest.mark.long
def test_what_surrounds_the_image_of_a_lens_tells_nothing_of_the_shutter() -> None:
    """Black, upright at its sides, and of all images."""
    camera = turning_images(0.0, 0.03, 1.0)
    height, width = camera.thumbnails.shape[1:]
    rows, columns = np.mgrid[:height, :width]
    inside = np.hypot((columns - width / 2.0) / 0.7, (rows - height / 2.0) / 0.9) < height
    seen = replace(camera, thumbnails=np.where(inside, camera.thumbnails, 0).astype(np.uint8))
    (found,) = check_shutter(RecordingEvidence(turning_recording(seen)))
    assert found.estimate is not None
    assert found.estimate.value == pytest.approx(30.0, abs=3.0)


@pytest.mark.long
@pytest.mark.parametrize("tilt_s", [-0.04, pytest.param(0.04, marks=pytest.mark.slow)])
def test_a_robot_that_tilts_in_turns_has_no_rolling_shutter(tilt_s: float) -> None:
    """A global shutter on a base that rolls by 0.04 rad for each rad/s, as its gyroscope tells."""
    camera, rays = turning_images(0.0, 0.0, 1.0), pinhole(160, 90, 70.0).rays() @ R_OPTICAL.T
    around, step_s = panorama(), 0.005
    images = []
    for at_s in (camera.stamps_ns * 1e-9).tolist():
        before, now, after = turned(at_s + np.array([-step_s, 0.0, step_s]))
        tilt = tilt_s * (after - before) / (2.0 * step_s)
        x, y, z = (rays @ matrix_from_rpy(tilt, 0.0, 0.0).T).T
        column = (now + np.arctan2(y, x) + np.pi) * around.shape[1] / (2.0 * np.pi)
        row = 44.5 - 114.0 * z / np.hypot(x, y)
        seen = map_coordinates(around, [row, column], order=1, mode="grid-wrap")
        images.append(seen.reshape(90, 160))
    camera = replace(camera, thumbnails=np.array(images, dtype=np.uint8))
    stamps_ns = np.arange(0, 22 * 10**9, 10_000_000, dtype=np.int64)
    at = stamps_ns * 1e-9
    rate = (turned(at + step_s) - turned(at - step_s)) / (2.0 * step_s)
    tilting = tilt_s * np.gradient(rate, 0.01)
    rates = np.column_stack([tilting, 0.0 * rate, rate])
    imu = RawImu("/imu", ("base_link",), stamps_ns, None, rates, np.zeros_like(rates))
    whole = turning_recording(camera)
    untold, told = (
        next(iter(check_shutter(RecordingEvidence(each))))
        for each in (whole, replace(whole, streams=(*whole.streams, imu)))
    )
    assert untold.estimate is not None
    assert told.estimate is not None
    # At the middle column; towards the sides a tilt leans what is upright by less.
    assert untold.estimate.value == pytest.approx(1e3 * tilt_s * 90.0 / 114.25, rel=0.2)
    assert abs(told.estimate.value) < 0.25 * abs(untold.estimate.value)
    assert told.verdict != "fault"


def test_a_camera_on_its_side_shows_nothing_of_its_shutter() -> None:
    """What is upright runs along its rows, each of which is of one instant."""
    camera = turning_images(0.0, 0.03, 1.0)
    assert camera.claim is not None
    on_its_side = np.rot90(camera.thumbnails, axes=(1, 2)).copy()
    R_turned = R_OPTICAL @ matrix_from_rpy(0.0, 0.0, np.pi / 2.0)
    seen = replace(camera, thumbnails=on_its_side)
    model = replace(camera.claim.model(), width=90, height=160)
    assert seen_leans(seen, model, R_turned).leans_rad.size < 0.05 * len(camera)


def test_a_shutter_is_as_long_where_edges_are_not_smooth() -> None:
    """A lean of two pixels is then a stair of three upright pieces."""
    rng = np.random.default_rng(5)
    edges = np.sort(rng.uniform(-np.pi, np.pi, 60))
    greys = rng.uniform(20.0, 230.0, 61)
    readout_s, model = 0.02, pinhole(160, 120, 70.0)
    columns, rows = np.meshgrid(np.arange(160.0), np.arange(120.0))
    azimuths = -np.arctan((columns - model.centre_px[0]) / model.focal_px[0])
    at_s = np.arange(1.0, 16.0, 0.1)
    images = []
    for one_s in at_s.tolist():
        place = turned(np.asarray(one_s + readout_s * rows / 119.0)) + azimuths
        seen = greys[np.searchsorted(edges, (place + np.pi) % (2.0 * np.pi) - np.pi)]
        images.append(seen + rng.normal(0.0, 2.0, seen.shape))
    shown = np.clip(images, 0.0, 255.0).astype(np.uint8)
    camera = survey("grey", np.rint(1e9 * at_s).astype(np.int64), model, thumbnails=shown)
    leans = seen_leans(camera, model, R_OPTICAL)
    middle_s = np.asarray(1e-9 * leans.stamps_ns + 0.5 * readout_s, np.float64)
    rates_rad_s = (turned(middle_s + 0.005) - turned(middle_s - 0.005)) / 0.01
    found = fit_readout(leans.leans_rad, middle_s, rates_rad_s)
    assert found is not None
    # Pieces at the ends of an edge are still cut off: each line alone measures 17 ms.
    assert found[0] == pytest.approx(readout_s, abs=1.9e-3)


def corridor_leans(seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Leans, times and turn rates of a camera with a shutter of 20 ms: images along a corridor all
    lean the same to 0.2 degrees, those of its corner each in its own way."""
    times_s = np.arange(0.0, 40.0, 1.0 / 7.0)
    rates = np.where(abs(times_s - 31.0) < 2.0, 0.6, 0.0) - 0.5 * (abs(times_s - 34.0) < 1.0)
    scatter_rad = np.deg2rad(np.where(rates == 0.0, 0.2, 0.7))
    return 0.02 * rates + np.random.default_rng(seed).normal(0.0, scatter_rad), times_s, rates


def test_a_corridor_does_not_make_what_its_corner_shows_wild() -> None:
    found = [fit_readout(*corridor_leans(seed)) for seed in range(20)]
    readouts_s, sigmas_s = np.transpose([fit for fit in found if fit is not None])
    assert len(readouts_s) == 20
    assert (abs(readouts_s - 0.02) < 4.5 * sigmas_s).all()
    assert abs(readouts_s.mean() - 0.02) < 0.004


def test_few_long_turns_past_patterns_that_lean_tell_no_shutter() -> None:
    """Of a robot that goes round things, each leaning its own way by 2 degrees: of 60 such drives
    with a global shutter 35 were told as a rolling one."""
    times_s = np.arange(0.0, 45.0, 1.0 / 6.0)
    turn = np.searchsorted([4.0, 8.0, 14.0, 27.0, 33.0, 44.0], times_s)
    rates = np.array([0.0, -0.5, 0.0, 0.35, 0.0, -0.4, 0.0])[turn]
    told = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        views = np.where(turn % 2, 50 + turn, times_s // 2.0).astype(np.int64)
        leans = rng.normal(0.0, np.deg2rad(2.0), 60)[views] + rng.normal(0.0, 0.01, views.size)
        found = fit_readout(leans, times_s, rates)
        assert found is not None
        told += decide(Measurement(1e3 * found[0], 1e3 * found[1], "ms"), 8.0) == "fault"
    assert told <= 1


def test_a_corner_that_leans_by_itself_is_no_shutter() -> None:
    leans, times_s, rates = corridor_leans(0)
    leans[abs(times_s - 31.0) < 1.5] += np.deg2rad(25.0)
    assert fit_readout(leans, times_s, rates) is None


def test_a_camera_that_sees_what_lies_alone_shows_no_lean() -> None:
    rows = np.repeat(np.arange(90)[:, None] // 15 % 2, 160, axis=1)
    images = np.tile(np.asarray(40 + 150 * rows, np.uint8), (3, 1, 1))
    camera = survey("grey", np.arange(3), pinhole(160, 90, 70.0), thumbnails=images)
    assert camera.claim is not None
    assert not seen_leans(camera, camera.claim.model(), R_OPTICAL).leans_rad.size


def test_a_longer_focal_length_makes_turns_small() -> None:
    camera = turning_images(0.0, 0.0, 1.0)
    assert camera.claim is not None
    K = camera.claim.K.copy()
    K[[0, 1], [0, 1]] *= 1.3
    found = turn_fit(replace(camera, claim=replace(camera.claim, K=K)))
    assert found is not None
    assert found.gain[0] == pytest.approx(1.0 / 1.3 - 1.0, abs=0.04)


def test_a_robot_that_stands_turns_nothing() -> None:
    camera = turning_images(0.0, 0.0, 1.0)
    still = replace(camera, thumbnails=np.repeat(camera.thumbnails[:1], len(camera), axis=0))
    assert turn_fit(still) is None


def test_features_of_noise_tell_no_turn() -> None:
    """Noise is everywhere alike from image to image, and seems to stand still."""
    camera = turning_images(0.0, 0.0, 1.0)
    rng = np.random.default_rng(7)
    dim = 90.0 + 0.02 * camera.thumbnails.astype(float)
    noisy = np.rint(dim + rng.normal(0.0, 4.0, dim.shape)).astype(np.uint8)
    assert turn_fit(replace(camera, thumbnails=noisy)) is None


def test_images_of_which_nothing_is_found_again_tell_no_turn() -> None:
    """Every other image is of a lens that was covered."""
    camera = turning_images(0.0, 0.0, 1.0)
    images = camera.thumbnails.copy()
    images[1::2] = 3
    assert turn_fit(replace(camera, thumbnails=images)) is None


@pytest.mark.parametrize(
    "rpy_deg", [(0.0, 0.0, 90.0), (0.0, 0.0, -100.0), (0.0, -90.0, 0.0), (0.0, 90.0, 0.0)]
)
def test_a_camera_that_looks_across_the_way_or_straight_up_tells_no_turn(
    rpy_deg: tuple[float, float, float],
) -> None:
    """What is driven moves all that it sees to one side, as a turn does, or about its middle."""
    camera = turning_images(0.0, 0.0, 1.0)
    few = camera.selected(np.arange(20))
    assert few.claim is not None
    R = matrix_from_rpy(*np.radians(rpy_deg)) @ R_OPTICAL
    ahead, there = (seen_turns(few, few.claim.model(), each).pair.size for each in (R_OPTICAL, R))
    # In the corners of an image of what is straight above some things are less steep.
    assert there < 0.3 * ahead


@pytest.mark.parametrize(("yaw_deg", "wanted_m"), [(0.0, -0.4), (180.0, 0.4), (90.0, 0.1)])
def test_a_camera_behind_the_axle_that_looks_ahead_turns_less(
    yaw_deg: float, wanted_m: float
) -> None:
    camera = turning_images(0.0, 0.0, 1.0)
    quat_xyzw = xyzw_from_yaw(np.radians([yaw_deg])), np.array([[-0.5, 0.5, -0.5, 0.5]])
    place_m, none_m, at_ns = np.array([[-0.4, 0.1, 0.3]]), np.zeros((1, 3)), np.zeros(1, np.int64)
    edges = (
        TransformEdge("/tf_static", "base_link", "mount", True, at_ns, None, place_m, quat_xyzw[0]),
        TransformEdge("/tf_static", "mount", "camera", True, at_ns, None, none_m, quat_xyzw[1]),
    )
    evidence = RecordingEvidence(replace(turning_recording(camera), transforms=edges))
    T_base_camera = evidence.frames.between(evidence.base, camera.frame_id)
    assert before_the_axle_m(T_base_camera) == pytest.approx(wanted_m)


@pytest.mark.parametrize("delay_s", [0.0, -0.2])
@pytest.mark.parametrize("rows", [1, -1], ids=["mirrored", "upside down"])
def test_images_that_turn_against_the_robot_are_told_as_such(delay_s: float, rows: int) -> None:
    """Their focal length was told as 200 % off."""
    camera = turning_images(delay_s, 0.0, 1.0)
    flipped = replace(camera, thumbnails=camera.thumbnails[:, ::rows, ::-1].copy())
    evidence = RecordingEvidence(turning_recording(flipped))
    found = {one.check: one for one in check_turns(evidence)}
    assert found["camera.turns"].fault == "camera_flipped"
    assert found["camera.time_offset"].verdict == "inconclusive"


@pytest.mark.parametrize("delay_s", [2.2, 2.4])
def test_a_camera_that_is_later_than_is_searched_is_not_told_as_flipped(delay_s: float) -> None:
    """Nearly half a period of how the robot weaves, when it turned the other way."""
    evidence = RecordingEvidence(turning_recording(turning_images(delay_s, 0.0, 1.0)))
    assert {one.verdict for one in check_turns(evidence)} == {"inconclusive"}


def seen_by_frame(camera: CameraSurvey, R_base_camera: FloatArray) -> Finding:
    """What is asked of the axes of the frame in which images are stamped."""
    edge = TransformEdge(
        *("/tf_static", "base_link", "camera", True, np.zeros(1, np.int64), None),
        *(np.array([[0.1, 0.0, 0.3]]), xyzw_from_matrix(R_base_camera)[None]),
    )
    whole = replace(turning_recording(camera), transforms=(edge,))
    (found,) = check_axes(RecordingEvidence(whole))
    return found


def test_images_in_the_frame_of_the_body_of_their_camera_are_told() -> None:
    """By that frame, which has x ahead, it looks up: nothing else could be told of it."""
    camera = turning_images(0.0, 0.0, 1.0)
    assert seen_by_frame(camera, R_OPTICAL).verdict == "ok"
    found = seen_by_frame(camera, np.eye(3))
    assert (found.verdict, found.fault) == ("fault", "camera_mount")


def test_a_camera_that_looks_at_the_ceiling_has_an_optical_frame() -> None:
    camera = turning_images(0.0, 0.0, 1.0)
    rng = np.random.default_rng(4)
    ceiling = zoom(rng.uniform(20.0, 230.0, (40, 40)), 10, order=1)
    columns, rows = np.meshgrid(np.arange(160.0) - 79.5, np.arange(90.0) - 44.5)
    images = []
    for yaw in turned(camera.stamps_ns * 1e-9).tolist():
        cos, sin = np.cos(yaw), np.sin(yaw)
        place = [200.0 + sin * columns + cos * rows, 200.0 + cos * columns - sin * rows]
        images.append(map_coordinates(ceiling, place, order=1))
    above = replace(camera, thumbnails=np.array(images, dtype=np.uint8))
    assert not seen_by_frame(above, np.eye(3)).fault


def stereo_pair(
    disparity_px: float, centres_px: tuple[float, float], toe_in_rad: float = 0.0
) -> Recording:
    """Two topics that show one flat wall; what each claims of where it looks differs."""
    around, stamps_ns = panorama(), np.arange(20) * 100_000_000
    columns, rows = np.meshgrid(np.arange(160.0), np.arange(90.0))
    shown = zip(("left", "right"), (0.0, disparity_px), centres_px, (0.5, -0.5), strict=True)
    cameras = []
    for name, shift_px, centre_px, share in shown:
        model = pinhole(160, 90, 70.0)
        K = model.K.copy()
        K[0, 2] = centre_px
        at = [rows, 3.0 * (columns + shift_px) + 200.0]
        image = map_coordinates(around, at, order=1, mode="grid-wrap").astype(np.uint8)
        camera = survey("grey", stamps_ns, model, thumbnails=np.tile(image, (20, 1, 1)))
        assert camera.claim is not None
        R = matrix_from_rpy(0.0, share * toe_in_rad, 0.0)
        claim = replace(camera.claim, K=K, R=R)
        cameras.append(replace(camera, topic=f"/{name}/image_raw", claim=claim))
    return Recording("pair", "memory", cameras=tuple(cameras))


@pytest.mark.parametrize(
    ("disparity_px", "centres_px", "toe_in_rad", "verdict"),
    [
        (0.7, (79.5, 79.5), 0.0, "ok"),
        (-0.7, (79.5, 79.5), 0.0, "fault"),
        # Lenses that are not alike: 2 px of disparity less 5 by their principal points.
        (-3.0, (77.0, 82.0), 0.0, "ok"),
        (3.0, (82.0, 77.0), 0.0, "fault"),
        # Cameras that look towards each other, as the rectification tells.
        (-1.0, (79.5, 79.5), 0.03, "ok"),
        (1.0, (79.5, 79.5), -0.03, "fault"),
    ],
)
def test_which_image_is_left_follows_from_disparity_beyond_what_lenses_make(
    disparity_px: float, centres_px: tuple[float, float], toe_in_rad: float, verdict: str
) -> None:
    pair = stereo_pair(disparity_px, centres_px, toe_in_rad)
    (found,) = check_stereo(RecordingEvidence(pair))
    assert found.verdict == verdict, found


@pytest.mark.parametrize("is_swapped", [False, True])
def test_colours_are_compared_where_two_topics_show_the_same(is_swapped: bool) -> None:
    rng = np.random.default_rng(3)
    colours = rng.uniform(20.0, 220.0, (30, 6, 8, 1)) + rng.uniform(-20.0, 20.0, (30, 6, 8, 3))
    stamps_ns = np.arange(30) * 100_000_000
    one = survey("colour", stamps_ns, pinhole(40, 30, 70.0), colours=colours)
    noisy = colours + rng.normal(0.0, 1.0, colours.shape)
    other = replace(one, colours=noisy[..., ::-1] if is_swapped else noisy)
    found = likeness(one, other)
    assert found is not None
    assert found[0] * (-1.0 if is_swapped else 1.0) > 0.8
    elsewhere = replace(one, colours=rng.uniform(20.0, 220.0, colours.shape))
    assert likeness(one, elsewhere) is None
