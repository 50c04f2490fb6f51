"""Optical flow beside an oracle: points of planes, followed by the homography that a plane makes.

A box stands about the camera, which drives and turns by a formula. The oracle knows the formula and
the planes, and nothing of rays, meshes or interpolated motion.
"""

from __future__ import annotations

import numpy as np

from slamsim.cameras.lens import CameraModel, pinhole
from slamsim.cameras.poses import optical_flow
from slamsim.config.run import RunConfig
from slamsim.console.reporter import Reporter
from slamsim.core.geometry import matrix_from_rpy, se3_from_parts, xyzw_from_yaw
from slamsim.core.types import Drive, FloatArray, TriangleMesh
from slamsim.sensors.cameras.entry import R_CAMERA_OPTICAL
from slamsim.sensors.cameras.sight import View
from slamsim.sensors.motion import Motion
from slamsim.sensors.scene import Scene

Figures = dict[str, object]

_HALF_M, _HIGH_M = 3.0, 12.0
_SPEED_M_S, _TURN_RAD_S = 0.5, 0.8
_MOUNT_M = np.array([0.1, 0.0, 0.4])
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
