"""``slamsim map --places``: places that a depth camera sees again, for the lidar to confirm."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from slamsim.core.geometry import se2_from_se3
from slamsim.core.places import SeenAgain
from slamsim.core.progress import Progress, silent
from slamsim.core.types import FloatArray
from slamsim.io.cameras import open_cameras
from slamsim.io.cameras.base import pairs_of
from slamsim.models.wheel_gyro import PARAMETERS
from slamsim.perception.calibrated import NO_CALIBRATION, CalibratedCameras
from slamsim.perception.camera_track import APART_NS, PLACE_M, PLACE_RAD
from slamsim.perception.places import WORST_SIGMA_M, Places
from slamsim.perception.recorded import grey_of, mount_of
from slamsim.recording import Recording
from slamsim.run.cameras.odometry import WITHIN_NS, registered
from slamsim.slam.frontend.motion import Odometry

MOST_TILT_RAD = 0.1
"""A robot that is back on the floor stands as it stood, to within a few degrees."""


def places_seen_again(
    path: Path,
    recording: Recording,
    odometry: Odometry | None,
    calibrated: CalibratedCameras = NO_CALIBRATION,
    progress: Progress = silent,
) -> tuple[SeenAgain, ...]:
    """All pairs of images of the recording at path that show one scene, of the camera with the most
    depth images that are registered to pictures.

    odometry: tells which images are worth a look, those between which the robot moved; without it
    two a second are looked at. Raises SlamsimError where no depth is registered, InputRefused where
    the camera's place is unknown or an image cannot be read, NotFound without CameraInfo.
    """
    with open_cameras(path) as cameras:
        pair = registered(cameras)
        total = cameras.topics[pair.picture].messages
        frame = cameras.topics[pair.depth].frame_id
        known = calibrated.of(pair.picture, frame)
        T_base_camera = mount_of(path, pair.depth, frame, recording, known)
        places, moved, stamps_ns = Places(known.model or pair.model), _Moved(odometry), list[int]()
        found = []
        images = pairs_of(cameras.encoded({pair.depth, pair.picture}), pair.depth, WITHIN_NS)
        for number, (depth, picture) in enumerate(images, 1):
            progress(number, total)
            stamp_ns = known.clock.at_row(picture.stamp_ns, 0.5)
            if not moved.since_last(stamp_ns):
                continue
            grey, depth_m = grey_of(picture.decoded()), depth.decoded().pixels
            for earlier, fitted in places.add(len(stamps_ns), 0, grey, depth_m):
                T = _on_floor(fitted.T_now_keyframe, T_base_camera)
                if T is not None:
                    found.append(SeenAgain(stamps_ns[earlier], stamp_ns, T))
            stamps_ns.append(stamp_ns)
    return tuple(found)


class _Moved:
    """Whether the robot moved since the last image that was worth a look."""

    def __init__(self, odometry: Odometry | None) -> None:
        self._odometry = odometry
        self._last_ns: int | None = None

    def since_last(self, stamp_ns: int) -> bool:
        """Remembers the instant if so."""
        if self._last_ns is None or self._far(self._last_ns, stamp_ns):
            self._last_ns = stamp_ns
            return True
        return False

    def _far(self, last_ns: int, now_ns: int) -> bool:
        if self._odometry is None or not self._odometry.covers(last_ns, now_ns):
            return now_ns - last_ns >= APART_NS
        x_m, y_m, yaw_rad = self._odometry.step(last_ns, now_ns, np.zeros(PARAMETERS)).T_first_last
        return bool(np.hypot(x_m, y_m) >= PLACE_M or abs(yaw_rad) >= PLACE_RAD)


def _on_floor(T_now_earlier: FloatArray, T_base_camera: FloatArray) -> FloatArray | None:
    """(3,) T_earlier_now of the base, of (4, 4) between optical frames; None of one that no robot
    on a floor makes."""
    T = T_base_camera @ np.linalg.inv(T_now_earlier) @ np.linalg.inv(T_base_camera)
    if abs(T[2, 3]) > WORST_SIGMA_M or T[2, 2] < np.cos(MOST_TILT_RAD):
        return None
    return se2_from_se3(T)
