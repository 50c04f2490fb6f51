"""Writes camera images as TUM RGB-D and EuRoC (ASL) folders, which ``open_cameras`` reads again.

Images go to disk as they come. A JPEG or PNG stays as it was packed; what was raw becomes PNG.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from slamsim.cameras.codecs.pictures import encode_png
from slamsim.cameras.frames import EncodedFrame
from slamsim.cameras.lens import CameraModel
from slamsim.core.geometry import matrix_from_xyzw, xyzw_from_matrix
from slamsim.core.types import FloatArray, IntArray, Trajectory
from slamsim.guard.pictures import JPEG_MAGIC
from slamsim.io.cameras.layouts import TUM_UNIT_M
from slamsim.io.staged_writer import StagedWriter
from slamsim.io.text.tum import decimal_from_stamp_ns, write_tum

GROUND_TRUTH = "groundtruth.txt"
_ASL_NAMES = {"plumb_bob": "radial-tangential", "equidistant": "equidistant"}
_ASL_COEFFICIENTS = 4


class TumRgbdFolder(StagedWriter):
    """rgb/ and depth/ with their lists, rgb.yaml and depth.yaml as ROS calibration files.

    Depth is in 5000 units a metre, exact for millimetres; from 13.107 m on there is none.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._folder = folder
        self._lines: dict[str, list[str]] = {}

    def camera(self, name: str, model: CameraModel) -> None:
        """The camera of ``rgb`` or ``depth``."""
        (self._folder / f"{name}.yaml").write_text(calibration_yaml(name, model), encoding="ascii")

    def add(self, name: str, frame: EncodedFrame) -> None:
        """The next image of ``rgb`` or ``depth``.

        Raises InputRefused for one that cannot be decoded, FileExistsError for one of the same
        stamp as an earlier one; nothing is written then.
        """
        data, suffix = _tum_depth(frame) if name == "depth" else picture_file(frame)
        (self._folder / name).mkdir(exist_ok=True)
        seconds = decimal_from_stamp_ns(frame.stamp_ns)
        file = f"{name}/{seconds}{suffix}"
        with (self._folder / file).open("xb") as opened:
            opened.write(data)
        self._lines.setdefault(name, []).append(f"{seconds} {file}\n")

    def truth(self, T_map_camera: Trajectory) -> None:
        """The true path of the optical frame of ``rgb``."""
        write_tum(self._folder / GROUND_TRUTH, T_map_camera)

    def _finish(self) -> None:
        for name, lines in self._lines.items():
            text = "".join(["# images\n", "# timestamp filename\n", *sorted(lines)])
            (self._folder / f"{name}.txt").write_text(text, encoding="ascii")


class EurocFolder(StagedWriter):
    """mav0/cam0, cam1 and so on, imu0 and state_groundtruth_estimate0, with a sensor.yaml each."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._root = folder / "mav0"
        self._lines: dict[str, list[str]] = {}

    def camera(
        self, name: str, model: CameraModel, T_body_camera: FloatArray, rate_hz: float
    ) -> None:
        """A pinhole; T_body_camera: (4, 4). Raises ValueError for a distortion EuRoC cannot say."""
        told = _ASL_NAMES.get(model.distortion_model)
        values = np.zeros(8)
        values[: len(model.coefficients)] = model.coefficients
        if told is None or values[_ASL_COEFFICIENTS:].any():
            known = " or ".join(_ASL_NAMES)
            raise ValueError(f"four coefficients of {known} fit into a sensor.yaml of EuRoC")
        coefficients, numbers = values[:_ASL_COEFFICIENTS].tolist(), [*model.focal_px]
        about = [
            f"resolution: [{model.width}, {model.height}]",
            "camera_model: pinhole",
            f"intrinsics: {_listed([*numbers, *model.centre_px])}",
            f"distortion_model: {told}",
            f"distortion_coefficients: {_listed(coefficients)}",
        ]
        self._sensor(name, "camera", T_body_camera, [f"rate_hz: {rate_hz:.6g}", *about])

    def add(self, name: str, frame: EncodedFrame) -> None:
        """The next image of cam0 or another; raises as ``TumRgbdFolder.add``."""
        data, suffix = picture_file(frame)
        place = self._root / name / "data"
        place.mkdir(parents=True, exist_ok=True)
        with (place / f"{frame.stamp_ns}{suffix}").open("xb") as opened:
            opened.write(data)
        self._lines.setdefault(name, []).append(f"{frame.stamp_ns},{frame.stamp_ns}{suffix}\n")

    def imu(self, stamps_ns: IntArray, rates_rad_s: FloatArray, accelerations: FloatArray) -> None:
        """(n,) stamps, (n, 3) angular velocity and (n, 3) specific force in m/s^2, in the body."""
        head = "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
        head += "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n"
        self._rows("imu0", head, stamps_ns, np.hstack([rates_rad_s, accelerations]))
        self._sensor("imu0", "imu", np.eye(4), [])

    def truth(self, T_map_body: Trajectory) -> None:
        """The true path of the body."""
        name = "state_groundtruth_estimate0"
        head = "#timestamp,p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],"
        head += "q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []\n"
        quats_wxyz = T_map_body.quats_xyzw[:, [3, 0, 1, 2]]
        values = np.hstack([T_map_body.positions_m, quats_wxyz])
        self._rows(name, head, T_map_body.stamps_ns, values)

    def _rows(self, name: str, head: str, stamps_ns: IntArray, values: FloatArray) -> None:
        place = self._root / name
        place.mkdir(parents=True, exist_ok=True)
        with (place / "data.csv").open("x", encoding="ascii") as file:
            file.write(head)
            for stamp_ns, row in zip(stamps_ns.tolist(), values.tolist(), strict=True):
                file.write(f"{stamp_ns},{','.join(f'{value:.9g}' for value in row)}\n")

    def _sensor(self, name: str, kind: str, T_body: FloatArray, about: list[str]) -> None:
        data = _listed(T_body.ravel().tolist())
        lines = [f"sensor_type: {kind}", "T_BS:", "  cols: 4", "  rows: 4", f"  data: {data}"]
        place = self._root / name
        place.mkdir(parents=True, exist_ok=True)
        text = "".join(f"{line}\n" for line in [*lines, *about])
        (place / "sensor.yaml").write_text(text, encoding="ascii")

    def _finish(self) -> None:
        for name, lines in self._lines.items():
            text = "".join(
                [
                    "#timestamp [ns],filename\n",
                    *sorted(lines, key=lambda line: int(line.partition(",")[0])),
                ]
            )
            (self._root / name / "data.csv").write_text(text, encoding="ascii")


def picture_file(frame: EncodedFrame) -> tuple[bytes, str]:
    """(content, suffix) of an image file; raises InputRefused for what cannot be decoded."""
    _, pixels = frame.stored()
    packed = frame.packed()
    if packed:
        return packed, ".jpg" if packed.startswith(JPEG_MAGIC) else ".png"
    return encode_png(pixels), ".png"


def in_frame(T_map_base: Trajectory, T_base_frame: FloatArray) -> Trajectory:
    """The path of a frame that is fixed to the base.

    Products are summed term by term: the last bits of BLAS depend on where arrays lie in memory,
    and data sets must have the same bytes each time. T_base_frame: (4, 4).
    """
    rotations = matrix_from_xyzw(T_map_base.quats_xyzw)
    positions_m = T_map_base.positions_m + (rotations * T_base_frame[:3, 3]).sum(axis=2)
    turned = (rotations[:, :, :, None] * T_base_frame[:3, :3]).sum(axis=2)
    return replace(T_map_base, positions_m=positions_m, quats_xyzw=xyzw_from_matrix(turned))


def _tum_depth(frame: EncodedFrame) -> tuple[bytes, str]:
    depth_m = frame.decoded().pixels
    units = np.nan_to_num(np.rint(depth_m.astype(np.float64) / TUM_UNIT_M))
    return encode_png(np.where(units <= 65535, units, 0.0).astype(np.uint16)), ".png"


def calibration_yaml(name: str, model: CameraModel) -> str:
    """As ROS's camera_calibration_parsers write it."""
    P = np.hstack([model.K, np.zeros((3, 1))])
    matrices = {"camera": model.K, "rectification": np.eye(3), "projection": P}
    blocks = [
        f"{kind}_matrix:\n  rows: 3\n  cols: {matrix.shape[1]}\n"
        f"  data: {_listed(matrix.ravel().tolist())}\n"
        for kind, matrix in matrices.items()
    ]
    coefficients = model.coefficients.tolist()
    blocks.insert(
        1,
        f"distortion_model: {model.distortion_model}\ndistortion_coefficients:\n  rows: 1\n"
        f"  cols: {len(coefficients)}\n  data: {_listed(coefficients)}\n",
    )
    size = f"image_width: {model.width}\nimage_height: {model.height}\ncamera_name: {name}\n"
    return size + "".join(blocks)


def _listed(values: list[float]) -> str:
    return f"[{', '.join(repr(float(value)) for value in values)}]"
