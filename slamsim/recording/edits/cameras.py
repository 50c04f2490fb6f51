"""Edits of camera images and of what is claimed of cameras; pixels change as a copy is written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from slamsim.cameras.survey import CameraSurvey
from slamsim.core.types import BoolArray, IntArray
from slamsim.recording import Recording
from slamsim.recording.edits.base import CannotEdit, Edit


@dataclass(frozen=True, slots=True)
class ChangeCameras(Edit):
    """Some topics of images changed.

    chosen: which of them. change: to the images in their place. lacking: what to call them where
    there are none.
    """

    chosen: Callable[[CameraSurvey], bool]
    change: Callable[[CameraSurvey], CameraSurvey]
    lacking: str = "camera images"

    def apply(self, recording: Recording) -> Recording:
        cameras = recording.cameras
        if not any(len(camera) and self.chosen(camera) for camera in cameras):
            raise CannotEdit(f"{recording.name} has no {self.lacking}")
        changed = (self.change(each) if self.chosen(each) else each for each in cameras)
        return replace(recording, cameras=tuple(changed))


@dataclass(frozen=True, slots=True)
class ExchangeImages(Edit):
    """The images of two topics exchanged, with all that they show; their CameraInfo stays."""

    one: str
    other: str

    def apply(self, recording: Recording) -> Recording:
        by_topic = {camera.topic: camera for camera in recording.cameras}
        if not {self.one, self.other} <= by_topic.keys():
            raise CannotEdit(f"{recording.name} has no images on {self.one} or {self.other}")
        places = {self.one: by_topic[self.other], self.other: by_topic[self.one]}

        def exchanged(camera: CameraSurvey) -> CameraSurvey:
            if camera.topic not in places:
                return camera
            seen = places[camera.topic]
            return replace(seen, topic=camera.topic, frame_id=camera.frame_id, claim=camera.claim)

        return replace(recording, cameras=tuple(map(exchanged, recording.cameras)))


def shifted(camera: CameraSurvey, offset_ns: int) -> CameraSurvey:
    """With all stamps later."""
    return replace(camera, stamps_ns=camera.stamps_ns + offset_ns)


def telling(readout_s: Callable[[float], float]) -> Callable[[CameraSurvey], CameraSurvey]:
    """A change of what is told of the shutter: readout_s, from what is told so far (0 where nothing
    is), in seconds."""

    def told(camera: CameraSurvey) -> CameraSurvey:
        claim = camera.claim
        if claim is None:
            return camera
        return replace(camera, claim=replace(claim, readout_s=readout_s(claim.readout_s or 0.0)))

    return told


def repeating(camera: CameraSurvey, shown: IntArray) -> CameraSurvey:
    """Images (n,) of these numbers in the place of its own, at the times of its own."""
    stamps_ns, received_ns = camera.stamps_ns, camera.received_ns
    return replace(camera.selected(shown), stamps_ns=stamps_ns, received_ns=received_ns)


def kept(camera: CameraSurvey, which: BoolArray) -> CameraSurvey:
    """Those (n,) images alone."""
    return camera.selected(np.flatnonzero(which))
