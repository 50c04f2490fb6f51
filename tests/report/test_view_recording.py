"""The recording: what is in it, what a viewer says of it, and what it looks like."""

from __future__ import annotations

import signal
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from urllib.request import urlopen

import cv2
import numpy as np
import pytest
from limited_child import running
from view_example import BOXES_M, GEOMETRY, T_BASE_LASER, Scans, example_run, walls_mesh
from waiting import TIMEOUT_S, wait_for

from slamsim.core.geometry import compose, matrix_from_rpy, se3_from_parts
from slamsim.core.result import PoseGraph, SlamResult
from slamsim.core.types import Grid, PlanarTrajectory, Scan
from slamsim.evaluate.score import Scores
from slamsim.guard.errors import InputRefused, NotFound, SlamsimError
from slamsim.report.run_view import RunView, thinned, wall_outline
from slamsim.report.viewer.process import headless_viewer
from slamsim.report.viewer.run import write_recording
from slamsim.report.viewer.scene import occupancy_bytes
from slamsim.report.viewer.series import plots, wheel_speeds, yaw_rate
from slamsim.report.viewer.show import check_recording, render_screenshot, view_run
from slamsim.report.viewer.stage import MAX_SCANS, laser_frame, on_floor, scan_points
from slamsim.report.viewer.unmapped import unmapped

MAP = "Map: estimate blue, odometry orange, truth green"


@cache
def why_no_viewer() -> str:
    """Empty if the headless viewer starts here, else what it says."""
    try:
        with headless_viewer(Path("/dev/null"), 100, 100) as client:
            client.take_screenshot(max_size=64)
            return ""
    except SlamsimError as error:
        return str(error)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "run.rrd"
    write_recording(path, example_run())
    return path


def test_a_recording_is_shown_without_a_map(tmp_path: Path) -> None:
    """Its scans where odometry has them, no estimate and no match that was never made."""
    view = unmapped(replace(example_run().log, name="raw"))
    assert not view.mapped and len(view.result.trajectory) > 1
    odometry, shown = example_run().log.odometry, view.result.trajectory
    assert odometry is not None
    assert np.array_equal(shown.poses, odometry.at(shown.stamps_ns))
    assert {panel.key for panel in plots(view)} <= {"wheels", "turn"}
    write_recording(tmp_path / "raw.rrd", view)
    still = unmapped(replace(example_run().log, odometry=None))
    assert not still.result.trajectory.poses.any()
    if not why_no_viewer():
        assert check_recording(tmp_path / "raw.rrd").errors == ()


@pytest.mark.long
def test_a_viewer_opens_it_without_an_error_and_with_a_whole_transform_tree(
    recording: Path,
) -> None:
    if reason := why_no_viewer():
        pytest.skip(reason)
    check = check_recording(recording)
    assert check.errors == ()
    assert check.parents == {
        "odom": "map",
        "base_footprint": "odom",
        "laser_link": "base_footprint",
        "truth": "map",
    }
    assert MAP in check.views
    assert {"Space", "Position error [m]", "Wheel speed [m/s]"} <= set(check.views)
    assert check.duration_s == pytest.approx(39.9)


@pytest.fixture(scope="module")
def screenshot(
    recording: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, list[Path]]:
    """Of the map, which takes a viewer some ten seconds to draw; and what it left at home and among
    temporary files."""
    if reason := why_no_viewer():
        pytest.skip(reason)
    place = tmp_path_factory.mktemp("screenshot")
    home, temporary = place / "home", place / "tmp"
    home.mkdir()
    temporary.mkdir()
    with pytest.MonkeyPatch.context() as monkeypatch:
        for name in ("XDG_CONFIG_HOME", "XDG_DATA_HOME"):
            monkeypatch.delenv(name, raising=False)
        monkeypatch.setenv("XDG_CACHE_HOME", str(place / "cache"))  # of graphics drivers
        monkeypatch.setenv("HOME", str(home))
        monkeypatch.setenv("TMPDIR", str(temporary))
        monkeypatch.setattr("tempfile.tempdir", None)
        render_screenshot(recording, place / "map.png", MAP)
    return place / "map.png", [*home.rglob("*"), *temporary.rglob("*")]


@pytest.mark.long
def test_a_screenshot_leaves_nothing_at_home_nor_among_temporary_files(
    screenshot: tuple[Path, list[Path]],
) -> None:
    assert screenshot[1] == []


@pytest.mark.long
def test_the_map_looks_like_the_map(screenshot: tuple[Path, list[Path]]) -> None:
    picture, _ = screenshot
    image = np.asarray(cv2.imread(str(picture)), dtype=int)
    light = image.min(axis=2) > 225
    blue = (image[:, :, 0] > 150) & (image[:, :, 2] < 80)
    orange = (image[:, :, 2] > 190) & (image[:, :, 0] < 60)

    # Mapped free space is 8 m x 8 m less the block of 4 m x 4 m and is drawn to fill the view.
    assert 0.15 < light.mean() < 0.5
    assert blue.sum() > 500
    assert orange.sum() > 500
    # The block in the middle is no free space, and free space surrounds it on all sides.
    rows, columns = np.nonzero(light)
    middle_row, middle_column = int(rows.mean()), int(columns.mean())
    middle = (
        slice(middle_row - 40, middle_row + 40),
        slice(middle_column - 40, middle_column + 40),
    )
    assert light[middle].mean() < 0.05
    assert light[middle_row].any()
    assert light[:middle_row, middle_column].any()
    assert light[middle_row:, middle_column].any()


@pytest.mark.slow
def test_without_truth_it_opens_as_well(tmp_path: Path) -> None:
    if reason := why_no_viewer():
        pytest.skip(reason)
    path = tmp_path / "run.rrd"
    write_recording(path, example_run(duration_s=5.0, with_truth=False))
    check = check_recording(path)
    assert check.errors == ()
    assert "Position error [m]" not in check.views


def nothing() -> RunView:
    """A run in which no scan could be used."""
    full = example_run(duration_s=2.0, with_truth=False)
    none = PlanarTrajectory(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
    graph = PoseGraph(none, np.zeros((0, 3, 3)), ())
    empty = np.zeros(0)
    result = SlamResult(none, none, graph, empty, empty.astype(np.bool_), 0, 0)
    log = replace(full.log, scans=Scans(()), odometry=None, imu=None, encoders=None)
    cells = np.full((1, 1), np.nan, dtype=np.float32)
    return RunView(log=log, result=result, grid=Grid(cells, 0.05, (0.0, 0.0)), scores=Scores())


def test_a_run_of_nothing_is_recorded_too(tmp_path: Path) -> None:
    write_recording(tmp_path / "run.rrd", nothing())
    assert (tmp_path / "run.rrd").stat().st_size > 0
    assert [path.name for path in tmp_path.iterdir()] == ["run.rrd"]


def test_long_runs_are_thinned(tmp_path: Path) -> None:
    short = example_run(duration_s=2.0, with_truth=False)
    count, beams = 30_000, 1081
    stamps_ns = np.arange(count, dtype=np.int64) * 25_000_000
    poses = np.column_stack([np.linspace(0, 400, count), np.zeros((count, 2))])
    path = PlanarTrajectory(stamps_ns, poses)
    geometry = replace(GEOMETRY, beam_count=beams)
    ranges = np.random.default_rng(0).uniform(1.0, 5.0, beams).astype(np.float32)
    scans = Scans(tuple(Scan(int(stamp), ranges, geometry) for stamp in stamps_ns))
    result = replace(
        short.result,
        trajectory=path,
        odometry=path,
        match_quality=np.ones(count),
        degenerate=np.zeros(count, dtype=np.bool_),
    )
    target = tmp_path / "run.rrd"
    write_recording(target, replace(short, log=replace(short.log, scans=scans), result=result))
    assert target.stat().st_size < 40e6


def test_scans_are_drawn_where_the_transforms_put_them() -> None:
    run = example_run(duration_s=2.0)
    scan = next(iter(run.log.scans))
    points = on_floor(T_BASE_LASER, scan_points(scan)).astype(float)
    base = points @ T_BASE_LASER[:3, :3].T + T_BASE_LASER[:3, 3]
    assert run.truth is not None
    pose = run.truth.planar().poses[0]
    world = np.array([compose(pose, np.array([x, y, 0.0]))[:2] for x, y, _ in base])
    boxes = np.array(BOXES_M)
    outside = np.maximum(boxes[:, None, :2] - world, world - boxes[:, None, 2:]).max(axis=2)
    assert np.abs(outside).min(axis=0).max() < 0.06  # six times the noise of the ranges
    np.testing.assert_allclose(base[:, 2], 0.04, atol=1e-6)


def test_a_tilted_laser_is_projected_straight_down() -> None:
    T_base_laser = se3_from_parts(matrix_from_rpy(0.2, -0.1, 2.0), np.array([0.1, 0.2, 0.5]))
    points = np.random.default_rng(0).normal(0, 3, (50, 3)) * [1, 1, 0]
    moved = on_floor(T_base_laser, points).astype(float)
    before = points @ T_base_laser[:3, :3].T + T_base_laser[:3, 3]
    after = moved @ T_base_laser[:3, :3].T + T_base_laser[:3, 3]
    np.testing.assert_allclose(after[:, :2], before[:, :2], atol=1e-5)
    np.testing.assert_allclose(after[:, 2], 0.04, atol=1e-5)


@pytest.mark.parametrize("taken", ["map", "odom", "base_footprint", "truth", "", "tf#/x"])
def test_a_laser_frame_that_would_break_the_tree_is_renamed(taken: str) -> None:
    run = example_run(duration_s=1.0, with_truth=False)
    scan = next(iter(run.log.scans))
    renamed = replace(scan, geometry=replace(scan.geometry, frame_id=taken))
    run = replace(run, log=replace(run.log, scans=Scans((renamed,))))
    assert laser_frame(run) == "laser"


def test_cells_are_ros_values_with_the_top_row_first() -> None:
    cells = np.array([[0.0, 1.0, np.nan], [0.5, 0.25, 0.0]], dtype=np.float32)
    values = np.frombuffer(occupancy_bytes(Grid(cells, 0.1, (0.0, 0.0))), dtype=np.uint8)
    assert values.reshape(2, 3).tolist() == [[50, 25, 0], [0, 100, 255]]


def test_the_outline_of_the_walls_is_their_cut() -> None:
    segments = wall_outline(walls_mesh(), 0.4)
    length_m = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum()
    around = sum(2 * (x1 - x0 + y1 - y0) for x0, y0, x1, y1 in BOXES_M)
    assert length_m == pytest.approx(around)
    assert len(wall_outline(walls_mesh(), 1.5)) == 0


def test_thinning_keeps_both_ends_and_never_grows() -> None:
    for count, at_most in ((0, 10), (1, 10), (10, 10), (1000, 10), (1001, 3)):
        pick = thinned(count, at_most)
        assert len(pick) == min(count, at_most)
        assert count == 0 or (pick[0] == 0 and pick[-1] == count - 1)
    assert MAX_SCANS > 100


def test_wheel_speeds_and_turn_rate_are_those_driven() -> None:
    run = example_run(duration_s=20.0)
    assert run.log.encoders is not None
    assert run.log.imu is not None
    assert run.log.odometry is not None
    _, speeds = wheel_speeds(run.log.encoders, 50)
    steps = np.diff(run.log.odometry.poses[:, :2], axis=0)
    path_m = np.linalg.norm(steps, axis=1).sum()
    assert speeds.mean() * 19.9 == pytest.approx(path_m, rel=0.02)
    assert speeds[:, 1].mean() > speeds[:, 0].mean()  # it turns to the left
    _, whole = yaw_rate(run.log.imu, run.log.T_base_imu, 1000)
    _, coarse = yaw_rate(run.log.imu, run.log.T_base_imu, 20)
    assert coarse.size == 20
    upside_down = np.diag([1.0, -1.0, -1.0, 1.0])
    _, turned = yaw_rate(run.log.imu, upside_down, 1000)
    np.testing.assert_allclose(turned, -whole)


def test_speeds_are_sane_where_stamps_lie_microseconds_apart() -> None:
    run = example_run(duration_s=20.0, with_truth=False)
    assert run.log.odometry is not None
    stamps_ns = run.log.odometry.stamps_ns.copy()
    stamps_ns[1::2] = stamps_ns[0:-1:2] + 1000
    crowded = replace(
        run.log, encoders=None, odometry=replace(run.log.odometry, stamps_ns=stamps_ns)
    )
    made = {plot.key: plot for plot in plots(replace(run, log=crowded), at_most=60)}
    assert np.abs(made["wheels"].curves[0].values).max() < 10.0


def test_every_plot_is_there_and_thinned() -> None:
    made = {plot.key: plot for plot in plots(example_run(), at_most=100)}
    assert set(made) == {"error_m", "error_deg", "match", "wheels", "turn"}
    assert all(curve.values.size <= 100 for plot in made.values() for curve in plot.curves)


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    with pytest.raises(NotFound, match=r"run\.rrd"):
        view_run(tmp_path)
    (tmp_path / "run.rrd").write_bytes(b"something else")
    with pytest.raises(InputRefused, match="not a Rerun recording"):
        view_run(tmp_path, screenshot=tmp_path / "shot.png")
    assert not (tmp_path / "shot.png").exists()


def test_without_a_screen_the_user_is_told_what_to_do(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    with pytest.raises(SlamsimError, match="--screenshot"):
        view_run(recording)


def test_without_a_driver_the_user_is_told_which_package_to_install(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("VK_ICD_FILENAMES", "VK_DRIVER_FILES"):
        monkeypatch.setenv(name, "/dev/null")
    with pytest.raises(SlamsimError, match="mesa-vulkan-drivers"):
        view_run(recording, screenshot=tmp_path / "shot.png")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.long
def test_a_browser_is_given_a_page_of_this_machine_until_ctrl_c(recording: Path) -> None:
    code = (
        "import pathlib, sys; from slamsim.report.viewer.show import view_run;"
        "view_run(pathlib.Path(sys.argv[1]), web=True)"
    )
    with running(code, str(recording)) as process:
        assert process.stderr is not None
        line = process.stderr.readline()
        address = line.split()[1]
        page = fetched(address.split("?")[0])
        process.send_signal(signal.SIGINT)
        assert process.wait(TIMEOUT_S) != 0
    assert address.startswith("http://127.0.0.1:")
    assert "<html" in page.lower()
    with pytest.raises(OSError, match="refused"):
        urlopen(address, timeout=TIMEOUT_S)


def fetched(address: str) -> str:
    def answered() -> str:
        with suppress(OSError), urlopen(address, timeout=TIMEOUT_S) as answer:
            return str(answer.read(2000).decode())
        return ""

    return wait_for(answered)
