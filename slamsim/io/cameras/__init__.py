"""Opens the camera images of recordings and folders: ``open_cameras``."""

from __future__ import annotations

from pathlib import Path

from slamsim.guard.errors import InputRefused, NotFound
from slamsim.io.cameras.base import Cameras, FolderCameras, ImageList
from slamsim.io.cameras.layouts import (
    asl_lists,
    asl_root,
    open3d_lists,
    plain_lists,
    tum_lists,
)
from slamsim.io.formats import Truth
from slamsim.io.formats.ros import is_ros
from slamsim.io.open import recording_at


def open_cameras(path: Path, truth: Truth = "without") -> Cameras:
    """The camera images at a path, to be used as a context manager.

    path: a ROS 1 or ROS 2 recording or a run's folder with one; a folder of TUM RGB-D, EuRoC (with
    or without ``mav0``) or Open3D's examples. truth: whether topics of the truth are shown, or
    they alone; folders hold none. A recording without a camera gives no topics. Raises NotFound
    or InputRefused.
    """
    if not path.exists():
        raise NotFound(f"{path}: there is no such file or folder")
    lists = _image_lists(path) if path.is_dir() else []
    if lists:
        return FolderCameras(path, lists)
    recording = recording_at(path)
    if not is_ros(recording):
        raise InputRefused(
            recording,
            "holds no camera images; those of ROS recordings are read, and folders of TUM RGB-D "
            "(rgb.txt), EuRoC (mav0/cam0) and Open3D (color/ and depth/)",
        )
    from slamsim.io.cameras.recording import RecordedCameras

    return RecordedCameras(recording, truth)


def open_pictures(path: Path) -> Cameras:
    """As ``open_cameras``, and pictures in a folder without any layout, or in folders in it."""
    known = not path.is_dir() or _image_lists(path)
    lists = [] if known or (path / "metadata.yaml").exists() else plain_lists(path)
    return FolderCameras(path, lists) if lists else open_cameras(path)


def is_image_folder(folder: Path) -> bool:
    """Whether a folder has a layout whose images ``open_cameras`` reads; raises InputRefused for
    one with wrong lists."""
    return bool(_image_lists(folder))


def _image_lists(folder: Path) -> list[ImageList]:
    root = asl_root(folder)
    return tum_lists(folder) or (asl_lists(root) if root is not None else open3d_lists(folder))
