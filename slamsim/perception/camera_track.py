"""The images of one camera as SLAM without a lidar takes them: key frames, motions, tags, loops."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slamsim.cameras.frames import CameraFrame
from slamsim.cameras.lens import CameraModel
from slamsim.core.spatial import CameraTrack, SpatialEdge, TagSeen
from slamsim.core.types import Float32Array, FloatArray
from slamsim.perception.places import Places
from slamsim.perception.recorded import grey_of, light_of
from slamsim.perception.rgbd_odometry import RgbdOdometry, RgbdStep
from slamsim.perception.tags import TagDetector, TagSighting
from slamsim.perception.twist import about_camera, exponential, logarithm

PLACE_M, PLACE_RAD = 0.15, 0.15
"""From place to place: nearer, key frames show the same."""
APART_NS = 500_000_000
"""Without depth, an image without tags is a key frame this long after the last."""
TAG_SIGMA_M, TAG_SIGMA_RAD = 0.01, 0.02
"""What neighbouring images have in common of where a tag is seen: in ``gallery`` 8 mm of what a
rolling shutter and the way of the robot during an exposure do."""

Seen = tuple[CameraFrame, CameraFrame | None]


class CameraTracker:
    """Takes images one by one. detector: of the tags that are landmarks, None for none."""

    def __init__(self, model: CameraModel, detector: TagDetector | None) -> None:
        self._model, self._detector = model, detector
        self._odometry, self._places = RgbdOdometry(model), Places(model)
        self._stamps: list[int] = []
        self._since: list[FloatArray] = []
        self._of: list[int] = []
        self._keyframes: list[int] = []
        self._edges: list[SpatialEdge] = []
        self._tags: list[tuple[int, TagSighting, FloatArray]] = []
        self._lost = 0
        self._step: RgbdStep | None = None
        self._at_place: FloatArray | None = None

    def add(self, picture: CameraFrame, depth: CameraFrame | None) -> None:
        """One picture; one that is no later than the last is left out. Raises as ``step``."""
        if self._stamps and picture.stamp_ns <= self._stamps[-1]:
            return
        grey = grey_of(picture)
        self._stamps.append(picture.stamp_ns)
        if depth is not None:
            self._with_depth(self._odometry.step(picture.stamp_ns, grey, depth.pixels))
        detector = self._detector
        tags = detector.detect(grey, light_of(picture)) if detector is not None else ()
        if depth is None:
            self._without_depth(bool(tags))
        number = len(self._keyframes) - 1
        if self._keyframes[-1] == len(self._stamps) - 1:
            self._tags += [(number, tag, self._odometry.swept) for tag in tags]
            if depth is not None:
                self._look_back(number, grey, depth.pixels)

    def track(self) -> CameraTrack:
        """All of it; the last image is a key frame, whatever it shows."""
        if self._step is not None and not self._step.starts:
            self._edges.append(_edge(self._step))
            self._keyframes.append(len(self._stamps) - 1)
            self._since[-1], self._of[-1] = np.eye(4), len(self._keyframes) - 1
            self._step = None
        return CameraTrack(
            np.array(self._stamps, dtype=np.int64),
            np.array(self._since).reshape(-1, 4, 4),
            np.array(self._of, dtype=np.int64),
            np.array(self._keyframes, dtype=np.int64),
            tuple(self._edges),
            tuple(self._seen(*each) for each in self._tags),
            self._lost,
            self._places.refused,
        )

    def _with_depth(self, step: RgbdStep) -> None:
        self._step = step
        self._lost += step.status == "lost"
        if step.starts:
            if step.status != "started":
                self._edges.append(_edge(step))
            self._keyframes.append(len(self._stamps) - 1)
            self._since.append(np.eye(4))
        else:
            self._since.append(step.T_keyframe_camera)
        self._of.append(len(self._keyframes) - 1)

    def _without_depth(self, has_tags: bool) -> None:
        last = self._stamps[self._keyframes[-1]] if self._keyframes else None
        if last is None or has_tags or self._stamps[-1] - last >= APART_NS:
            self._keyframes.append(len(self._stamps) - 1)
        self._since.append(np.eye(4))
        self._of.append(len(self._keyframes) - 1)

    def _look_back(self, number: int, grey: NDArray[np.uint8], depth_m: Float32Array) -> None:
        T_odom_camera = self._odometry.keyframe.T_odom_camera
        if self._at_place is not None:
            moved = logarithm(np.linalg.inv(self._at_place) @ T_odom_camera)
            near = np.linalg.norm(moved[:3]) < PLACE_M and np.linalg.norm(moved[3:]) < PLACE_RAD
            if near:
                return
        self._at_place = T_odom_camera
        for earlier, fitted in self._places.add(number, self._lost, grey, depth_m):
            T = np.asarray(np.linalg.inv(fitted.T_now_keyframe))
            covariance = about_camera(fitted.T_now_keyframe, fitted.covariance)
            self._edges.append(SpatialEdge(earlier, number, T, covariance, "closure"))

    def _seen(self, keyframe: int, sighting: TagSighting, swept: FloatArray) -> TagSeen:
        """As the first row saw it; an ambiguous one tells where it is, and hardly which way it
        faces. swept: (6,) how points moved in the camera while the image was read out."""
        assert self._detector is not None
        one = self._detector.settled(sighting)
        least = np.diag(np.repeat(np.square([TAG_SIGMA_M, TAG_SIGMA_RAD]), 3))
        late = float(one.corners_px[:, 1].mean()) / max(self._model.height - 1, 1)
        T, covariance = one.pose.in_own_frame()
        return TagSeen(keyframe, one.number, exponential(-late * swept) @ T, covariance + least)


def _edge(step: RgbdStep) -> SpatialEdge:
    """To the key frame that this image becomes; a guess where it is lost."""
    T, ends = step.T_keyframe_camera, (step.keyframe, step.keyframe + 1)
    if step.covariance is None:
        return SpatialEdge(*ends, T, np.eye(6), "guess")
    covariance = about_camera(np.asarray(np.linalg.inv(T)), step.covariance)
    return SpatialEdge(*ends, T, covariance, "camera")
