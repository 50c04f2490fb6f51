"""``slamsim bench cameras``: each part gives its figures; a further part is a line in ``PARTS``.

Speed is processor time, not wall time: what other programs do beside does not count. One thread
casts; that of packing images in threads beside is left out of the depth, whose images are not
packed.

Optical flow is held beside an oracle: points of planes, followed by the homography that a plane
makes. A box stands about the camera, which drives and turns by a formula. The oracle knows the
formula and the planes, and nothing of rays, meshes or interpolated motion.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from slamsim.bench import Figures
from slamsim.bench.cameras.halls import measure_tags
from slamsim.bench.cameras.tags import measure_tag_nees
from slamsim.bench.speed import processor_s
from slamsim.cameras.lens import CameraModel, pinhole
from slamsim.cameras.poses import optical_flow
from slamsim.config.loading import load_run_config
from slamsim.config.run import RunConfig
from slamsim.config.sensors import SensorsConfig
from slamsim.console.reporter import Reporter
from slamsim.core.geometry import matrix_from_rpy, se3_from_parts, xyzw_from_yaw
from slamsim.core.types import Drive, Float32Array, FloatArray, TriangleMesh
from slamsim.guard.errors import SlamsimError
from slamsim.io import LOG
from slamsim.run.cameras.odometry import camera_odometry
from slamsim.run.recording import record
from slamsim.run.stages import Stages
from slamsim.sensors.base import Site
from slamsim.sensors.cameras.entry import R_CAMERA_OPTICAL
from slamsim.sensors.cameras.sight import View
from slamsim.sensors.kinds.camera import CameraEntry
from slamsim.sensors.motion import Motion
from slamsim.sensors.scene import Scene
from slamsim.sim.drive.route import plan_route
from slamsim.sim.drive.run import DriveRun
from slamsim.sim.robot.model import build_robot
from slamsim.simulation.simulate import appearance_of, in_pieces
from slamsim.world.build import build_world
from slamsim.world.model import World

CORES = 2
"""For which ``rgbd_realtime_factor`` is told, all work being shared among them evenly."""
_ROUNDS = 3
"""Of each measurement, of which the least counts: other work only adds."""
_VGA = {"width": 640, "height": 480, "horizontal_fov_deg": 75.0}
_SMALL = {"width": 424, "height": 240, "horizontal_fov_deg": 69.0}
"""Sizes and fields of view of depth and colour of a RealSense D435."""
_MOUNT = {"x_m": 0.1, "z_m": 0.4}
"""In front on a small robot, at the height of its upper plate."""
_CAST_FRAMES = 10


def measure_speed(config: RunConfig, reporter: Reporter) -> Figures:
    """Real-time factors, and the time of a depth image beside that of its rays alone."""
    world, robot = build_world(config.world, config.seed), build_robot(config.robot)
    route = plan_route(world, robot, config.drive)
    windows = list(DriveRun(world, robot, route, config.drive))
    depth = {"kind": "depth", "encoding": "raw", "lens": _VGA}
    exact = {**depth, "depth": {"is_exact": True}}
    rgbd = {
        "color": {"lens": _SMALL},
        "depth": {"kind": "depth", "encoding": "png", "lens": _SMALL},
        "infra": {"kind": "infrared", "lens": _SMALL},
    }
    with reporter.stage("cameras", "measurements") as progress:
        noisy_s = _cpu_per_second(config, world, windows, 30.0, {"depth": depth})
        progress(1, 4)
        exact_s = _cpu_per_second(config, world, windows, 30.0, {"depth": exact})
        progress(2, 4)
        rgbd_s = _cpu_per_second(config, world, windows, 15.0, rgbd)
        progress(3, 4)
        over_bare = _time_over_bare_cast(world, windows)
        progress(4, 4)
    return {
        "depth_realtime_factor": 1.0 / noisy_s,
        "exact_depth_realtime_factor": 1.0 / exact_s,
        "rgbd_realtime_factor": CORES / rgbd_s,
        "rgbd_cpu_s_per_s": rgbd_s,
        "time_over_bare_cast": over_bare,
    }


def _cpu_per_second(
    config: RunConfig, world: World, windows: list[Drive], rate_hz: float, imagers: Any
) -> float:
    """Seconds of processor time for a second of the drive, messages included."""
    entry = {"type": "camera", "name": "camera", "rate_hz": rate_hz, "mount": _MOUNT}
    sensors = SensorsConfig.model_validate({"additional": [{**entry, "imagers": imagers}]})
    site_of = appearance_of(world, config.world.looks)
    start_ns = int(windows[0].stamps_ns[0])
    seconds = (int(windows[-1].stamps_ns[-1]) - start_ns) * 1e-9
    motions = [Motion(piece) for window in windows for piece in in_pieces(window, sensors)]

    def sense_all() -> None:
        camera = sensors.additional[0].build(
            Site(world.mesh, config.seed, start_ns, appearance=site_of)
        )
        for motion in motions:
            camera.sense(motion).streams()

    return min(processor_s(sense_all) for _ in range(_ROUNDS)) / seconds


def _time_over_bare_cast(world: World, windows: list[Drive]) -> float:
    """True depth images, from poses to metres, beside the caster on rays that are there."""
    sensors = SensorsConfig.model_validate(
        {"additional": [{"type": "camera", "name": "camera", "mount": _MOUNT}]}
    )
    entry = sensors.additional[0]
    assert isinstance(entry, CameraEntry)
    imager = entry.imagers["color"]
    scene = Scene(world.mesh, floor_reach_m=30.0)
    view = View(scene, imager.lens.model(), entry.T_base_imager(imager), 0.0)
    motion = Motion(windows[-1])
    every = motion.drive.stamps_ns
    instants = every[np.linspace(0, every.size - 1, _CAST_FRAMES).astype(np.int64)]
    rays = [view.aimed(view.poses(motion, int(at), 0)) for at in instants]

    def whole() -> list[Float32Array]:
        return [view.sight(view.poses(motion, int(at), 0)).depths_m for at in instants]

    bare_s = min(processor_s(lambda: [scene.answer(each) for each in rays]) for _ in range(_ROUNDS))
    return min(processor_s(whole) for _ in range(_ROUNDS)) / bare_s


_HALF_M, _HIGH_M = 3.0, 12.0
"""A box of 6 m by 6 m, so high that no pixel sees over its walls."""
_SPEED_M_S, _TURN_RAD_S = 0.5, 0.8
"""Of a robot on a circle of 0.6 m: fast for an indoor drive."""
_MOUNT_M = np.array([0.1, 0.0, 0.4])
"""As _MOUNT."""
_RATE_HZ, _SECONDS = 240, 2
_PAIRS, _PERIOD_NS = 12, 66_666_667


def measure_flow(config: RunConfig, reporter: Reporter) -> Figures:
    """The largest error of any pixel, in pixels, over some pairs of images of 320 x 240."""
    return {"flow_error_px": flow_error_px()}


def flow_error_px() -> float:
    """The same, of whatever world."""
    camera, motion = pinhole(320, 240, 70.0), Motion(_drive())
    T_base_view = se3_from_parts(R_CAMERA_OPTICAL, _MOUNT_M)
    view, worst = View(Scene(_box(), floor_reach_m=1.0), camera, T_base_view, 0.0), 0.0
    for pair in range(_PAIRS):
        first_ns = (pair + 1) * _PERIOD_NS
        first, second = (view.poses(motion, at, 0) for at in (first_ns, first_ns + _PERIOD_NS))
        sight = view.sight(first)
        flow_px = optical_flow(sight.surface.points_m, sight.hit, camera, second)
        expected_px = _by_homographies(camera, first_ns, first_ns + _PERIOD_NS)
        worst = max(worst, float(np.abs(flow_px - expected_px).max()))
    return worst


def _by_homographies(camera: CameraModel, first_ns: int, second_ns: int) -> FloatArray:
    """(n, 2) for each pixel that of the plane which its ray meets first: H = K (R - t n' / d) K^-1
    (Hartley and Zisserman, "Multiple View Geometry", 13.1)."""
    (R_first, at_first), (R_second, at_second) = map(_optical_pose, (first_ns, second_ns))
    R, t = R_second.T @ R_first, R_second.T @ (at_first - at_second)
    rows, columns = np.divmod(np.arange(camera.width * camera.height), camera.width)
    pixels = np.column_stack([columns, rows, np.ones(rows.size)])
    rays = pixels @ np.linalg.inv(camera.K).T
    nearest, flow_px = np.full(rows.size, np.inf), np.empty((rows.size, 2))
    for normal, offset_m in _planes():
        inward, away_m = R_first.T @ normal, offset_m - normal @ at_first
        with np.errstate(divide="ignore"):
            along = away_m / (rays @ inward)
        H = camera.K @ (R + np.outer(t, inward) / away_m) @ np.linalg.inv(camera.K)
        moved = pixels @ H.T
        met = (along > 0.0) & (along < nearest)
        nearest[met] = along[met]
        flow_px[met] = (moved[:, :2] / moved[:, 2:] - pixels[:, :2])[met]
    return flow_px


def _planes() -> list[tuple[FloatArray, float]]:
    """(normal, offset): the floor and four walls."""
    x, y, z = np.eye(3)
    return [(z, 0.0), *((n * sign, _HALF_M) for n in (x, y) for sign in (1.0, -1.0))]


def _box() -> TriangleMesh:
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * _HALF_M
    vertices = np.vstack([np.column_stack([corners, np.full(4, h)]) for h in (0.0, _HIGH_M)])
    walls = [[i, (i + 1) % 4, 4 + (i + 1) % 4, 4 + i] for i in range(4)]
    triangles = [corner for a, b, c, d in walls for corner in ([a, b, c], [a, c, d])]
    return TriangleMesh(vertices, np.array(triangles, dtype=np.int32))


def _base_pose(seconds: float) -> tuple[float, FloatArray]:
    """Heading and place on a circle through the middle of the box."""
    yaw = _TURN_RAD_S * seconds
    radius_m = _SPEED_M_S / _TURN_RAD_S
    return yaw, np.array([radius_m * np.sin(yaw), radius_m * (1.0 - np.cos(yaw)), 0.0])


def _optical_pose(at_ns: int) -> tuple[FloatArray, FloatArray]:
    """Axes and place of the camera, by the formula."""
    yaw, place_m = _base_pose(at_ns * 1e-9)
    R_map_base = matrix_from_rpy(0.0, 0.0, yaw)
    return R_map_base @ R_CAMERA_OPTICAL, place_m + R_map_base @ _MOUNT_M


def _drive() -> Drive:
    stamps_ns = np.arange(_SECONDS * _RATE_HZ + 1) * (1_000_000_000 // _RATE_HZ)
    count = stamps_ns.size
    poses = [_base_pose(at * 1e-9) for at in stamps_ns.tolist()]
    yaws = np.array([yaw for yaw, _ in poses])
    return Drive(
        stamps_ns=stamps_ns,
        positions_m=np.array([place_m for _, place_m in poses]),
        quats_xyzw=xyzw_from_yaw(yaws),
        linear_velocity_m_s=np.zeros((count, 3)),
        angular_velocity_rad_s=np.zeros((count, 3)),
        wheel_angles_rad=np.zeros((count, 2)),
        wheel_speeds_rad_s=np.zeros((count, 2)),
        commands=np.zeros((count, 2)),
        wall_contact=np.zeros(count, dtype=np.bool_),
    )


WORLD, CAMERA = "gallery", "realsense_d435"
"""Textures as they are by default."""
SECONDS = 25.0
"""Some 10 m with turns."""


def measure_odometry(config: RunConfig, reporter: Reporter) -> Figures:
    """What the path is off at its end, in percent of its length, and how many images were lost.

    Raises SlamsimError for a drive without truth.
    """
    length = f"drive.route.max_duration_s={SECONDS}"
    driven = load_run_config(WORLD, CAMERA, (length,), config.seed)
    with TemporaryDirectory() as folder:
        record(driven, Path(folder), Stages(reporter))
        path = camera_odometry(Path(folder) / LOG, Path(folder) / "odometry", reporter)
    if path.errors is None:
        raise SlamsimError(f"the drive through {WORLD} has no truth")
    return {
        "odometry_drift_percent": path.errors.drift_percent,
        "odometry_ate_m": path.errors.ate_rmse_m,
        "odometry_lost_images": path.lost_frames,
    }


CAMERA_SECONDS = 10.0
"""Of the drive in which speed is measured, where nothing else is asked for."""

PARTS: Mapping[str, Callable[[RunConfig, Reporter], Figures]] = {
    "speed": measure_speed,
    "flow": measure_flow,
    "tags": measure_tags,
    "tag errors": measure_tag_nees,
    "odometry": measure_odometry,
}
"""By name. What they are given: the world in which cameras drive, and where progress is told."""


def measure_cameras(config: RunConfig, reporter: Reporter) -> Figures:
    """All figures of all parts."""
    figures: Figures = {"world": config.world.name}
    for measure in PARTS.values():
        figures.update(measure(config, reporter))
    return figures
