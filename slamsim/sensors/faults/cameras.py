"""Faults of cameras: stamps, pixels, what CameraInfo and the transforms claim of them."""

from __future__ import annotations

from abc import ABC
from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import Field

from slamsim.cameras.changes import Flicker, PixelChange, ScaleDepths, SwapRedBlue
from slamsim.cameras.frames import CameraClaim
from slamsim.cameras.pairs import stereo_pairs
from slamsim.cameras.survey import CameraSurvey
from slamsim.core.geometry import matrix_from_rpy, se3_from_parts
from slamsim.core.types import BoolArray, FloatArray, IntArray
from slamsim.recording import Recording
from slamsim.recording.edits.base import CannotEdit, Edit, Edits
from slamsim.recording.edits.cameras import (
    ChangeCameras,
    ExchangeImages,
    repeating,
    shifted,
    telling,
)
from slamsim.recording.edits.frames import TurnFrame
from slamsim.recording.frame_graph import FrameGraph
from slamsim.recording.repairs.base import Repair
from slamsim.recording.repairs.frames import set_height, set_mounting
from slamsim.sensors.faults.base import Fault, some_of, spells

Images = Literal["all", "images", "depth"]
_LACKING = {"all": "camera images", "images": "colour or grey images", "depth": "depth images"}


class CameraFault(Fault, ABC):
    """A fault of cameras, for which their images are looked through."""

    images: Images = "all"
    """Whose: those of all cameras, colour and grey ones alone, or depth alone."""

    def chosen(self, camera: CameraSurvey) -> bool:
        """Whether images of this topic have the fault."""
        return self.images == "all" or (camera.kind == "depth") == (self.images == "depth")

    def changed(self, change: Callable[[CameraSurvey], CameraSurvey]) -> Edit:
        """The edit that changes them."""
        return ChangeCameras(self.chosen, change, _LACKING[self.images])

    def repainted(self, change: PixelChange) -> Edit:
        """The same, of a change of pixels."""
        return self.changed(lambda camera: camera.repainted(change))


class CameraStamps(CameraFault):
    """Stamps of images are late, or early, by the same."""

    kind: Literal["camera_stamps"]
    offset_s: float = Field(ge=-1e4, le=1e4)
    """Stamp less the right one."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        offset_ns = round(1e9 * self.offset_s)
        return self.changed(lambda camera: shifted(camera, offset_ns))


class CameraInfoSize(CameraFault):
    """CameraInfo is that of another mode: image size and camera matrix are scaled."""

    kind: Literal["camera_info_size"]
    factor: float = Field(gt=0.01, le=100.0)
    """Of the width and height that are claimed."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def scaled(claim: CameraClaim) -> CameraClaim:
            K = np.diag([self.factor, self.factor, 1.0]) @ claim.K
            size = (max(round(self.factor * side), 1) for side in (claim.width, claim.height))
            width, height = size
            return replace(claim, K=K, width=width, height=height)

        return self.changed(_claiming(scaled))


class CameraInfoFocal(CameraFault):
    """The focal lengths of CameraInfo are wrong."""

    kind: Literal["camera_info_focal"]
    relative_error: float = Field(gt=-0.9, le=10.0)
    """Claimed over true, less one."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        factor = 1.0 + self.relative_error

        def scaled(claim: CameraClaim) -> CameraClaim:
            K = claim.K.copy()
            K[[0, 1], [0, 1]] *= factor
            return replace(claim, K=K)

        return self.changed(_claiming(scaled))


class CameraInfoFolds(CameraFault):
    """The first coefficient of CameraInfo's distortion is off, so that it folds in the image."""

    kind: Literal["camera_info_folds"]
    by: float = Field(ge=-100.0, le=100.0)
    """What is added to it."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def folded(claim: CameraClaim) -> CameraClaim:
            coefficients = np.array(claim.coefficients if claim.coefficients.size else np.zeros(5))
            coefficients[0] += self.by
            return replace(claim, coefficients=coefficients)

        return self.changed(_claiming(folded))


class CameraReadout(CameraFault):
    """The recording tells another shutter than the camera has."""

    kind: Literal["camera_readout"]
    error_s: float = Field(ge=-1.0, le=1.0)
    """What is told of the time from the first row to the last, less what it is; no less than 0, a
    global shutter, is told."""
    images: Images = "images"

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        cameras = [each for each in recording.cameras if self.chosen(each) and each.claim]
        told_s = [each.claim.readout_s or 0.0 for each in cameras if each.claim]
        if all(max(one + self.error_s, 0.0) == one for one in told_s):
            raise CannotEdit(f"{recording.name} tells of no camera that its shutter rolls")
        return self.changed(telling(lambda one_s: max(one_s + self.error_s, 0.0)))


class DepthScale(CameraFault):
    """All depths are too long, or too short."""

    kind: Literal["depth_scale"]
    relative_error: float = Field(gt=-0.9, le=10.0)
    """Of each depth."""
    images: Images = "depth"

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return self.repainted(ScaleDepths(1.0 + self.relative_error))


class DepthUnit(CameraFault):
    """Metres where millimetres belong, or the other way round."""

    kind: Literal["depth_unit"]
    images: Images = "depth"

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def in_another(camera: CameraSurvey) -> CameraSurvey:
            return camera.repainted(ScaleDepths(1e3 if camera.is_metric else 1e-3))

        return self.changed(in_another)


class CameraFrozen(CameraFault):
    """Images stand still for a while."""

    kind: Literal["camera_frozen"]
    frozen_s: float = Field(gt=0.0, le=1e4)
    """Length of each spell."""
    spells: int = Field(default=3, ge=1, le=1000)
    """How many, evenly spread over the recording."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def stuck(camera: CameraSurvey) -> BoolArray:
            return spells(camera.stamps_ns, self.spells, self.frozen_s)

        return self.changed(lambda camera: repeating(camera, _before(stuck(camera))))


class CameraDuplicates(CameraFault):
    """Some images are the one before again."""

    kind: Literal["camera_duplicates"]
    share: float = Field(gt=0.0, le=0.9)
    """Of the images; evenly spread: 0.5 is every second one."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def again(camera: CameraSurvey) -> BoolArray:
            return np.asarray(np.diff(np.floor(np.arange(len(camera) + 1) * self.share)) > 0)

        return self.changed(lambda camera: repeating(camera, _before(again(camera))))


class CameraDamaged(CameraFault):
    """Some images are cut off, as where a bus or a disk loses the rest of a message."""

    kind: Literal["camera_damaged"]
    share: float = Field(gt=0.0, le=0.9)
    """Of the images, at random."""
    kept: float = Field(default=0.6, ge=0.0, lt=1.0)
    """Share of its bytes that is left of each."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        def cut(camera: CameraSurvey) -> CameraSurvey:
            rows = np.flatnonzero(some_of(len(camera), self.share, rng))
            return camera.cut_short(rows, self.kept)

        return self.changed(cut)


class CameraFlicker(CameraFault):
    """The brightness of images follows the light of lamps at the mains."""

    kind: Literal["camera_flicker"]
    depth: float = Field(gt=0.0, le=1.0)
    """Of the brightness, which swings by so much of itself."""
    images: Images = "images"

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return self.repainted(Flicker(self.depth))


class StereoSwapped(CameraFault):
    """The images of the left and the right camera of each pair are exchanged."""

    kind: Literal["stereo_swapped"]

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        pairs = list(stereo_pairs(recording.cameras))
        if not pairs:
            raise CannotEdit(f"{recording.name} has no stereo pair")
        return Edits(tuple(ExchangeImages(left.topic, right.topic) for left, right in pairs))


class ColoursSwapped(CameraFault):
    """Red and blue of the first colour topic are exchanged, as where BGR is published as RGB."""

    kind: Literal["colours_swapped"]
    images: Images = "images"

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        topics = [each.topic for each in recording.cameras if each.kind == "colour"]
        swap = SwapRedBlue()
        return ChangeCameras(
            lambda camera: camera.topic in topics[:1],
            lambda camera: camera.repainted(swap),
            "colour images",
        )


class CameraTurned(CameraFault):
    """Cameras are turned about the vertical, their frames are not."""

    kind: Literal["camera_turned"]
    angle_deg: float = Field(ge=-180.0, le=180.0)
    """How far they are turned to the left of what their frames say."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        return _mounted(recording, np.zeros(2), -np.radians(self.angle_deg))


class CameraTilted(CameraFault):
    """Cameras are tilted, their frames are not."""

    kind: Literal["camera_tilted"]
    angle_deg: float = Field(ge=-45.0, le=45.0)
    """How far they look further up than their frames say, or lean to the right."""
    axis: Literal["pitch", "roll"] = "pitch"

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        turn = np.zeros(3)
        turn[0 if self.axis == "pitch" else 2] = -np.radians(self.angle_deg)
        frames, _ = _placed(recording)
        edits = [TurnFrame(frame, matrix_from_rpy(*turn)) for frame in frames]
        return Edits(tuple(edits))


class CameraMoved(CameraFault):
    """Cameras sit elsewhere than their frames say."""

    kind: Literal["camera_moved"]
    by_m: float = Field(ge=-10.0, le=10.0)
    """How much further along the axis."""
    axis: Literal["x", "y", "z"] = "x"
    """Of the base."""

    def edit(self, recording: Recording, rng: np.random.Generator) -> Edit:
        if self.axis == "z":
            return _lowered(recording, self.by_m)
        by_m = -self.by_m * np.eye(2)["xy".index(self.axis)]
        return _mounted(recording, by_m, 0.0)


def _claiming(
    change: Callable[[CameraClaim], CameraClaim],
) -> Callable[[CameraSurvey], CameraSurvey]:
    def changed(camera: CameraSurvey) -> CameraSurvey:
        return camera if camera.claim is None else replace(camera, claim=change(camera.claim))

    return changed


def _before(is_again: BoolArray) -> IntArray:
    """(n,) which image is shown in the place of each, where some are an earlier one again."""
    own = np.arange(is_again.size)
    return np.maximum.accumulate(np.where(is_again & (own > 0), 0, own))


def _mounted(recording: Recording, by_m: FloatArray, turn_rad: float) -> Edit:
    """Each camera's frame declared elsewhere: by (2,) m along the base's axes and a turn about its
    own place."""
    frames, base = _placed(recording)
    edits = []
    for frame, T_base_camera in frames.items():
        turned = se3_from_parts(matrix_from_rpy(0.0, 0.0, turn_rad), np.zeros(3)) @ T_base_camera
        x_m, y_m = (T_base_camera[:2, 3] + by_m).tolist()
        yaw_rad = float(np.arctan2(turned[1, 0], turned[0, 0]))
        place: dict[str, float | str] = {"parent": base, "x_m": x_m, "y_m": y_m}
        repair = Repair("set_mounting", frame, {**place, "yaw_rad": yaw_rad})
        edits.append(set_mounting(recording, repair))
    return Edits(tuple(edits))


def _lowered(recording: Recording, by_m: float) -> Edit:
    """Each camera's frame declared so much lower."""
    frames, base = _placed(recording)
    edits = []
    for frame, T_base_camera in frames.items():
        z_m = float(T_base_camera[2, 3]) - by_m
        edits.append(
            set_height(recording, Repair("set_height", frame, {"parent": base, "z_m": z_m}))
        )
    return Edits(tuple(edits))


def _placed(recording: Recording) -> tuple[dict[str, FloatArray], str]:
    """The frames of cameras that have a place, each with T_base_camera (4, 4), and the base. Raises
    CannotEdit where there are none."""
    graph = FrameGraph(recording.transforms)
    base = graph.base(recording.base_frames)
    found = {}
    for frame in sorted({camera.frame_id for camera in recording.cameras}):
        T_base_camera = graph.between(base, frame)
        if T_base_camera is not None and frame in graph and frame != base:
            found[frame] = T_base_camera
    if not found:
        raise CannotEdit(f"{recording.name} has no fixed transform to a camera")
    return found, base
