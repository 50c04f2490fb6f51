"""Cameras as ``slamsim calibrate`` found them, and when each row of an image was exposed."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from slamsim.cameras.lens import CameraModel
from slamsim.config.robot import MountConfig
from slamsim.core.geometry import mount_transform, se3_from_parts
from slamsim.core.landmarks import AS_CLAIMED, CameraErrors
from slamsim.core.types import FloatArray, IntArray
from slamsim.guard.errors import InputRefused
from slamsim.guard.files import require_inside
from slamsim.guard.numbers import BadNumbers
from slamsim.guard.yaml import load_yaml
from slamsim.io.cameras.layouts import ros_calibration
from slamsim.io.input_errors import as_input_errors
from slamsim.io.ros.images import without_transport

_log = logging.getLogger(__name__)
R_BODY_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""REP 103: a body frame looks along x, an optical frame along z."""
MOUNT = ("x_m", "y_m", "z_m", "roll_deg", "pitch_deg", "yaw_deg")
_TOLD = ("x", "y", "roll", "pitch", "yaw")
"""Without a survey no drive in the plane tells z; the claimed one then stands in the file."""
LATE, READOUT = "stamps late by", "readout"
LEAST_SIGMA = 1e-6
"""Of what was not fitted but given: a global shutter, or a readout by --readout-ms."""
LONGEST_S = 10.0
"""No clock of a camera is later, and no shutter slower."""


@dataclass(frozen=True, slots=True)
class CameraClock:
    """late_s: the stamp of an image less when its topmost row was exposed (the middle of that), on
    the clock of the path. readout_s: from the topmost row to the lowest; below 0 where a driver
    turns the images of a camera that hangs upside down."""

    late_s: float = 0.0
    readout_s: float = 0.0

    def at_row(self, stamp_ns: int, share: float) -> int:
        """When a row was exposed: share 0 of the image's height is the topmost, 1 the lowest."""
        return stamp_ns + round(1e9 * (self.readout_s * share - self.late_s))

    def of_rows(self, stamp_ns: int, rows: int) -> IntArray:
        """(rows,) the same of each row, (1,) of a global shutter."""
        shares = np.linspace(0.0, 1.0, rows) if self.readout_s else np.zeros(1)
        since_s = self.readout_s * shares - self.late_s
        return np.asarray(stamp_ns + np.rint(1e9 * since_s).astype(np.int64))


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedCamera:
    """What was found of one; None for what was not. T_base_camera: (4, 4) of the optical frame in
    base_frame. errors: how sure all of that is."""

    frame: str = ""
    base_frame: str = ""
    T_base_camera: FloatArray | None = None
    model: CameraModel | None = None
    clock: CameraClock = CameraClock()
    errors: CameraErrors = AS_CLAIMED


NOT_CALIBRATED = CalibratedCamera()


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedCameras:
    """cameras: by the topic of their images."""

    cameras: Mapping[str, CalibratedCamera] = field(default_factory=dict)

    def of(self, topic: str, frame: str) -> CalibratedCamera:
        """That of a topic, packed or not, or of its frame: what hangs there has its place and
        clock, and a lens of its own. It is told where none of them is that camera."""
        for name, each in self.cameras.items():
            if without_transport(name) == without_transport(topic):
                return each
        same = [each for each in self.cameras.values() if frame and each.frame == frame]
        if not same:
            if self.cameras:
                _log.warning("%s is none of the calibrated cameras and counts as recorded", topic)
            return NOT_CALIBRATED
        errors = replace(same[0].errors, scale=AS_CLAIMED.scale)
        return replace(same[0], frame=frame, model=None, errors=errors)


NO_CALIBRATION = CalibratedCameras()


def read_calibration(file: str) -> CalibratedCameras:
    """A ``calibration.yaml`` with the lenses beside it; none for an empty name.

    What was inconclusive is left out, and that is told. Raises NotFound or InputRefused.
    """
    if not file:
        return NO_CALIBRATION
    path = Path(file)
    data: Any = load_yaml(path).data
    with as_input_errors(path, "calibration of cameras"):
        found = {str(topic): dict(entry) for topic, entry in dict(data["cameras"]).items()}
        if not found:
            raise ValueError("there is no camera in it")
    return CalibratedCameras({topic: _camera(path, topic, entry) for topic, entry in found.items()})


def _camera(path: Path, topic: str, entry: Mapping[str, Any]) -> CalibratedCamera:
    lens = entry.get("camera_info")
    model = None if lens is None else _lens(path, topic, str(lens))
    with as_input_errors(path, f"camera {topic}"):
        frame, verdicts = str(entry["frame"]), dict(entry.get("verdicts", {}))
        if "mount" not in entry:
            return CalibratedCamera(frame, model=model)
        untold = {n for n in (*_TOLD, LATE, READOUT) if verdicts.get(n) == "inconclusive"}
        if untold:
            names = ", ".join(name for name in (*_TOLD, LATE, READOUT) if name in untold)
            _log.warning("%s: %s of %s is inconclusive", path, names, topic)
        placed, timed = not untold & set(_TOLD), not untold & {LATE, READOUT}
        late_s, readout_s = _seconds(entry, "stamps_late_s"), _seconds(entry, "readout_s")
        errors = _errors(entry, model, placed=placed, timed=timed)
        return CalibratedCamera(
            frame,
            str(entry["base_frame"]),
            _mount(dict(entry["mount"])) if placed else None,
            model,
            CameraClock(late_s, readout_s) if timed else CameraClock(),
            errors,
        )


def _errors(
    entry: Mapping[str, Any], model: CameraModel | None, *, placed: bool, timed: bool
) -> CameraErrors:
    """As sure as the file says of what counts as calibrated; an earlier version told less."""
    sigma = {str(name): float(value) for name, value in dict(entry.get("sigma", {})).items()}
    if not all(0.0 <= value < math.inf for value in sigma.values()):
        raise ValueError(f"sigma has numbers that are no standard deviations: {sigma}")
    told: dict[str, Any] = {
        name: sigma[name] for name in ("late_s", "readout_s") if timed and name in sigma
    }
    if placed and {"x_m", "y_m", "yaw_deg"} <= sigma.keys():
        told["place_m"] = max(sigma["x_m"], sigma["y_m"])
        told["yaw_rad"] = math.radians(sigma["yaw_deg"])
    if model is not None and "focal_px" in sigma:
        told["scale"] = sigma["focal_px"] / float(model.focal_px.mean())
    return replace(AS_CLAIMED, **{name: max(value, LEAST_SIGMA) for name, value in told.items()})


def _mount(told: Mapping[str, Any]) -> FloatArray:
    numbers = {name: float(told[name]) for name in MOUNT}
    if not all(map(math.isfinite, numbers.values())):
        raise ValueError(f"mount has numbers that are not finite: {numbers}")
    # Of any robot, which may be larger than those that are simulated.
    mount = MountConfig.model_construct(None, **numbers)
    return np.asarray(mount_transform(mount) @ se3_from_parts(R_BODY_OPTICAL, np.zeros(3)))


def _seconds(entry: Mapping[str, Any], key: str) -> float:
    value = float(entry[key])
    if not abs(value) <= LONGEST_S:
        raise ValueError(f"{key} is {value:g}; it is at most {LONGEST_S:g} s")
    return value


def _lens(path: Path, topic: str, name: str) -> CameraModel:
    file = require_inside(path.parent, name, path, f"camera {topic}")
    try:
        return ros_calibration(file, topic).model()
    except BadNumbers as error:
        raise InputRefused(file, str(error)) from None
