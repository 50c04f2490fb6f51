"""Files that ``slamsim calibrate`` writes: for other programs, and a page for people."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml

from slamsim.core.geometry import xyzw_from_matrix
from slamsim.guard.numbers import as_json
from slamsim.guard.output import write_atomic
from slamsim.io.cameras.writers import calibration_yaml
from slamsim.perception.calibrated import LATE, MOUNT, READOUT
from slamsim.perception.calibration.sightings import CornerMisfits
from slamsim.report.pages.cameras import CalibratedView, Misfits, write_calibration_report
from slamsim.run.cameras.calibration_report import (
    Calibrated,
    CameraResult,
    mount_numbers,
    pair_rows,
    quantity_row,
)

REPORT, PAGE, CALIBRATION = "report.json", "report.html", "calibration.yaml"


def write_calibration(folder: Path, found: Calibrated) -> None:
    """Write ``calibration.yaml``, a ROS calibration file of each lens, ``report.json`` and
    ``report.html``."""
    for each in found.cameras:
        if each.model is not None:
            write_atomic(folder / f"{each.name}.yaml", camera_info(each).encode())
    text = calibration_file(found.cameras, found.pairs)
    write_atomic(folder / CALIBRATION, text.encode())
    write_atomic(folder / REPORT, as_json(REPORT, found.as_dict()))
    pairs = {f"{pair['first']} and {pair['second']}": pair_rows(pair) for pair in found.pairs}
    views = [_view(each) for each in found.cameras]
    write_calibration_report(folder / PAGE, views, pairs, found.notes)


def camera_info(result: CameraResult) -> str:
    """As ROS' camera_info_manager reads it. Raises ValueError without a lens."""
    if result.model is None:
        raise ValueError(f"the lens of {result.topic} is not known")
    return calibration_yaml(result.name, result.model)


def calibration_file(results: Sequence[CameraResult], pairs: Sequence[dict[str, object]]) -> str:
    """calibration.yaml: all cameras, their mounts and clocks with standard deviations."""
    cameras = {each.topic: _entry(each) for each in results}
    whole = {"cameras": cameras, **({"pairs": list(pairs)} if pairs else {})}
    head = (
        "# By slamsim calibrate. mount: of the imager as a body that looks along x, as mounts of\n"
        "# sensors.additional are; sigma: standard deviations in the same units.\n"
    )
    return head + yaml.safe_dump(whole, sort_keys=False, width=100)


def _entry(result: CameraResult) -> dict[str, object]:
    found: dict[str, object] = {"frame": result.frame}
    if result.model is not None:
        found["camera_info"] = f"{result.name}.yaml"
    if result.mount is not None:
        found["base_frame"] = result.base_frame
        numbers = mount_numbers(result.mount.T_base_camera).tolist()
        found["mount"] = {n: round(v, 6) for n, v in zip(MOUNT, numbers, strict=True)}
        sigmas = {each.name: each.sigma for each in result.quantities}
        told = {name: sigmas[name.split("_")[0]] for name in MOUNT}
        told |= {"late_s": sigmas[LATE], "readout_s": sigmas.get(READOUT, 0.0)}
        if "fx" in sigmas:
            told["focal_px"] = sigmas["fx"]
        found["sigma"] = {name: float(f"{value:.3g}") for name, value in told.items()}
        found["stamps_late_s"] = round(result.mount.late_s, 7)
        found["readout_s"] = round(result.mount.readout_s, 7)
        found["static_transform"] = static_transform(result)
    found["verdicts"] = {each.name: each.verdict for each in result.quantities}
    return found


def static_transform(result: CameraResult) -> str:
    """The line that publishes the optical frame in ROS 2."""
    assert result.mount is not None
    T = result.mount.T_base_camera
    words = zip(("x", "y", "z"), T[:3, 3].tolist(), strict=True)
    quat = zip(("qx", "qy", "qz", "qw"), xyzw_from_matrix(T[:3, :3]).tolist(), strict=True)
    told = " ".join(f"--{name} {value:.6f}" for name, value in (*words, *quat))
    frames = f"--frame-id {result.base_frame} --child-frame-id {result.frame}"
    return f"ros2 run tf2_ros static_transform_publisher {told} {frames}"


def _view(result: CameraResult) -> CalibratedView:
    """As the page shows it."""
    found = {
        "board": (result.lens, "image"),
        "tags": (None if result.mount is None else result.mount.misfits, "time [s]"),
    }
    misfits = {
        name: shown
        for name, (told, axis) in found.items()
        if told is not None and (shown := _misfits(result.size, told, axis)) is not None
    }
    rows = [quantity_row(each) for each in result.quantities]
    return CalibratedView(result.topic, result.facts, rows, misfits)


def _misfits(size: tuple[int, int], told: CornerMisfits, axis: str) -> Misfits | None:
    """Those of corners that the fit has in sight: others are off by a number that stands for all
    that is too far. None if there is none."""
    near = (np.abs(told.off_px) < size[0]).all(axis=1)
    if not near.any():
        return None
    return Misfits(size, told.corners_px[near], told.off_px[near], told.at[near], axis)
