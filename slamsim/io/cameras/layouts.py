"""Folders of the TUM RGB-D benchmark, of EuRoC (ASL), and of Open3D's examples."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from slamsim.cameras.frames import CameraClaim
from slamsim.core.types import FloatArray
from slamsim.guard.errors import InputRefused, shown
from slamsim.guard.files import own_file, read_input, require_inside
from slamsim.guard.unpacking import open_lines
from slamsim.guard.yaml import load_yaml
from slamsim.io.cameras.base import ImageList
from slamsim.io.input_errors import as_input_errors
from slamsim.io.text.tum import stamp_ns_from_decimal

TUM_UNIT_M = 1.0 / 5000.0
"""Of depths in TUM RGB-D (Sturm et al. 2012): 5000 in an image is 1 m."""
TUM_LISTS = ("rgb", "depth")
_FREIBURG: Mapping[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "freiburg1": (
        (517.306408, 516.469215, 318.643040, 255.313989),
        (0.262383, -0.953104, -0.005358, 0.002628, 1.163314),
    ),
    "freiburg2": (
        (520.908620, 521.007327, 325.141442, 249.701764),
        (0.231222, -0.784899, -0.003257, -0.000105, 0.917205),
    ),
    "freiburg3": ((535.4, 539.2, 320.1, 247.6), (0.0,) * 5),
}
"""Intrinsics of the colour cameras, by a part of the folder's name, from the benchmark's page on
its file formats; depth is registered to colour there."""
_COLOUR_FOLDERS = ("color", "image", "rgb", "colour")
_SUFFIXES = (".png", ".jpg", ".jpeg")
_FRAME_NS = 33_333_333
"""Between frames of a folder without stamps: 30 a second, as its cameras take."""
_ASL_MODELS = {
    "radial-tangential": "plumb_bob",
    "radtan": "plumb_bob",
    "equidistant": "equidistant",
}


def tum_lists(folder: Path) -> list[ImageList]:
    """rgb.txt and depth.txt, or none of them; raises InputRefused naming file and line."""
    return [
        _tum_list(folder, name) for name in TUM_LISTS if own_file(folder, f"{name}.txt").is_file()
    ]


def _tum_list(folder: Path, name: str) -> ImageList:
    path, stamps_ns, files = folder / f"{name}.txt", list[int](), list[Path]()
    for number, line in open_lines(path):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            if len(words) != 2:
                raise ValueError(f"{len(words)} words")
            stamps_ns.append(stamp_ns_from_decimal(words[0]))
        except ValueError as error:
            reason = f"a line is 'time file' ({error})"
            raise InputRefused(path, reason, f"line {number}") from None
        files.append(require_inside(folder, words[1], path, f"line {number}"))
    return ImageList(name, *_in_order(stamps_ns, files), _tum_claim(folder, name), TUM_UNIT_M)


def _in_order(stamps_ns: list[int], files: list[Path]) -> tuple[list[int], list[Path]]:
    order = sorted(range(len(files)), key=lambda k: stamps_ns[k])
    return [stamps_ns[k] for k in order], [files[k] for k in order]


def _tum_claim(folder: Path, name: str) -> CameraClaim | None:
    """That of a calibration in the form of ROS's camera_calibration beside the list, else what the
    benchmark publishes of its own sequences."""
    calibration = own_file(folder, f"{name}.yaml")
    if calibration.is_file():
        return ros_calibration(calibration, name)
    known = next((each for part, each in _FREIBURG.items() if part in folder.resolve().name), None)
    if known is None:
        return None
    K, source = _matrix(*known[0]), f"the page of the TUM RGB-D benchmark on {folder.name}"
    return CameraClaim(source, name, 640, 480, "plumb_bob", np.array(known[1]), K)


def ros_calibration(path: Path, frame: str) -> CameraClaim:
    """A camera in the YAML of ROS's camera_calibration_parsers; raises InputRefused."""
    data: Any = load_yaml(path).data
    with as_input_errors(path, "camera calibration"):
        matrices = {
            name: np.array(data[f"{name}_matrix"]["data"], np.float64).reshape(shape)
            for name, shape in (("camera", (3, 3)), ("rectification", (3, 3)))
        }
        return CameraClaim(
            path.name,
            frame,
            int(data["image_width"]),
            int(data["image_height"]),
            str(data["distortion_model"]),
            np.array(data["distortion_coefficients"]["data"], np.float64),
            matrices["camera"],
            matrices["rectification"],
            np.array(data["projection_matrix"]["data"], np.float64).reshape(3, 4),
        )


def asl_root(folder: Path) -> Path | None:
    """Where the folders of the sensors are, in a folder of EuRoC; None if it is none."""
    roots = (folder / "mav0", folder)
    return next((each for each in roots if (each / "cam0" / "data.csv").is_file()), None)


def asl_lists(root: Path) -> list[ImageList]:
    """cam0, cam1 and so on; raises InputRefused naming file and line."""
    found = sorted(each for each in root.iterdir() if (each / "data.csv").is_file())
    return [_asl_list(root, each.name) for each in found if each.name.startswith(("cam", "depth"))]


def _asl_list(root: Path, name: str) -> ImageList:
    folder = own_file(root, name)
    path, stamps_ns, files = folder / "data.csv", list[int](), list[Path]()
    for number, line in open_lines(path):
        words = [word.strip() for word in line.split(",")]
        if not words[0] or words[0].startswith("#"):
            continue
        if len(words) != 2 or not words[0].isdecimal() or len(words[0]) > 19:
            raise InputRefused(path, "a line is 'nanoseconds,file'", f"line {number}")
        stamps_ns.append(int(words[0]))
        file = require_inside(folder / "data", words[1], path, f"line {number}")
        files.append(file)
    claim = asl_camera(folder / "sensor.yaml", name) if (folder / "sensor.yaml").is_file() else None
    return ImageList(name, *_in_order(stamps_ns, files), claim)


def asl_camera(path: Path, frame: str) -> CameraClaim:
    """A camera of a sensor.yaml; raises InputRefused for what is none."""
    data: Any = load_yaml(path).data
    with as_input_errors(path, "camera"):
        told = str(data.get("distortion_model", "radial-tangential"))
        if str(data["camera_model"]) != "pinhole":
            reason = f"a pinhole is needed, not {shown(str(data['camera_model']))}"
            raise InputRefused(path, reason, "camera_model")
        if told not in _ASL_MODELS:
            reason = f"is {shown(told)}; known are {', '.join(_ASL_MODELS)}"
            raise InputRefused(path, reason, "distortion_model")
        for key, names in (("intrinsics", "fx, fy, cx, cy"), ("resolution", "width, height")):
            if len(data[key]) != len(names.split()):
                raise InputRefused(path, f"holds {len(data[key])} numbers, not {names}", key)
        width, height = (int(side) for side in data["resolution"])
        T_body_camera = np.array(data["T_BS"]["data"], np.float64).reshape(4, 4)
        coefficients = np.array(data.get("distortion_coefficients") or (), np.float64)
        K = _matrix(*(float(value) for value in data["intrinsics"]))
        return CameraClaim(
            f"{frame}/{path.name}",
            frame,
            width,
            height,
            _ASL_MODELS[told],
            coefficients,
            K,
            T_body_camera=T_body_camera,
        )


def open3d_lists(folder: Path) -> list[ImageList]:
    """Numbered files in depth/ and color/ (or image/, rgb/), as Open3D's examples have them.

    They have no stamps: 30 a second are assumed, by the number in the name. Empty for a folder that
    is none. Files of a list that have no number are refused.
    """
    colour = next((name for name in _COLOUR_FOLDERS if (folder / name).is_dir()), "")
    if not colour or not (folder / "depth").is_dir():
        return []
    claim = _open3d_claim(folder)
    return [_numbered(folder, name, claim) for name in (colour, "depth")]


def plain_lists(folder: Path) -> list[ImageList]:
    """Pictures in a folder, or in folders in it such as left/ and right/, each a camera.

    In the order of their names, 30 a second, so that the first ones are of the same instant.
    """
    places = [folder, *sorted(each for each in folder.iterdir() if each.is_dir())]
    found = []
    for place in places:
        files = [each for each in sorted(place.iterdir()) if each.suffix.lower() in _SUFFIXES]
        files = [own_file(folder, str(each.relative_to(folder))) for each in files]
        stamps_ns = [number * _FRAME_NS for number in range(len(files))]
        found.append(ImageList(place.name, stamps_ns, files))
    return [each for each in found if each.files]


def _numbered(folder: Path, name: str, claim: CameraClaim | None) -> ImageList:
    place = own_file(folder, name)
    files = [each for each in sorted(place.iterdir()) if each.suffix.lower() in _SUFFIXES]
    stamps_ns = list[int]()
    for file in files:
        digits = "".join(c for c in file.stem if c in "0123456789")
        if not digits or len(digits) > 10:
            raise InputRefused(file, "a number in the name must say which frame it is")
        stamps_ns.append(int(digits) * _FRAME_NS)
        own_file(place, file.name)
    return ImageList(name, *_in_order(stamps_ns, files), claim)


def _open3d_claim(folder: Path) -> CameraClaim | None:
    """Of a PinholeCameraIntrinsic written as JSON, its matrix column by column."""
    names = ("camera_intrinsic.json", "intrinsic.json", "camera.json")
    path = next((folder / name for name in names if own_file(folder, name).is_file()), None)
    if path is None:
        return None
    with as_input_errors(path, "camera"):
        data: Any = json.loads(read_input(path, "yaml_bytes"))
        K = np.array(data["intrinsic_matrix"], np.float64).reshape(3, 3).T
        size = int(data["width"]), int(data["height"])
        return CameraClaim(path.name, "", *size, "plumb_bob", np.zeros(0), K)


def _matrix(fx: float, fy: float, cx: float, cy: float) -> FloatArray:
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
