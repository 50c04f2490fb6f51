"""The layout of the KITTI odometry benchmark (Geiger et al. 2012) for any lidar.

``sequences/00/velodyne/000000.bin`` and on: float32 x, y, z, intensity of each return, in the
laser frame; ``sequences/00/times.txt``: seconds of each cloud since the first;
``sequences/00/calib.txt``: ``Tr`` takes the laser to a camera that stands at the same place, with
z forward, x right and y down; ``poses/00.txt``: rows of the 3 x 4 matrix that takes this camera to
where it first was.
As in KITTI, the clouds are free of motion: all points of one are as seen at its time.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from slamsim.core.types import Float32Array, FloatArray, IntArray
from slamsim.io.staged_writer import StagedWriter

SEQUENCE = "00"
CAMERA_FROM_LASER: FloatArray = np.array(
    [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""KITTI gives poses of its left camera: z ahead, x to the right, y down."""


class KittiFolder(StagedWriter):
    """A sequence being written into a new folder; a context manager."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._folder = folder
        self._clouds = folder / "sequences" / SEQUENCE / "velodyne"
        self._clouds.mkdir(parents=True)
        self._stamps_ns: list[int] = []
        self._poses: list[FloatArray] = []

    def add(self, stamp_ns: int, T_map_laser: FloatArray, points: Float32Array) -> None:
        """The next cloud: (n, 4) x, y, z in metres in the laser frame at the stamp, intensity."""
        path = self._clouds / f"{len(self._stamps_ns):06d}.bin"
        path.write_bytes(np.ascontiguousarray(points, dtype="<f4").tobytes())
        self._stamps_ns.append(stamp_ns)
        self._poses.append(T_map_laser)

    def _finish(self) -> None:
        stamps_ns: IntArray = np.array(self._stamps_ns, dtype=np.int64)
        times = "".join(f"{ns * 1e-9:.9f}\n" for ns in (stamps_ns - stamps_ns[:1]).tolist())
        still = np.eye(4)[:3]
        calibration = {f"P{number}": still for number in range(4)} | {"Tr": CAMERA_FROM_LASER[:3]}
        lines = "".join(f"{name}: {_row(matrix)}\n" for name, matrix in calibration.items())
        (self._clouds.parent / "times.txt").write_text(times, encoding="ascii")
        (self._clouds.parent / "calib.txt").write_text(lines, encoding="ascii")
        poses = self._folder / "poses"
        poses.mkdir()
        text = "".join(f"{_row(pose)}\n" for pose in _camera_poses(self._poses))
        (poses / f"{SEQUENCE}.txt").write_text(text, encoding="ascii")


def _camera_poses(T_map_lasers: list[FloatArray]) -> list[FloatArray]:
    """(3, 4) of the camera in where it first was."""
    if not T_map_lasers:
        return []
    back = np.linalg.inv(CAMERA_FROM_LASER)
    first = CAMERA_FROM_LASER @ np.linalg.inv(T_map_lasers[0])
    return [(first @ T_map_laser @ back)[:3] for T_map_laser in T_map_lasers]


def _row(matrix: FloatArray) -> str:
    return " ".join(f"{value:.9e}" for value in matrix.ravel().tolist())
