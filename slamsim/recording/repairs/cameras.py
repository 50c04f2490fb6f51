"""Repairs of cameras: stamps, pixels, CameraInfo."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from slamsim.cameras.changes import ScaleDepths
from slamsim.cameras.survey import CameraSurvey
from slamsim.recording import Recording
from slamsim.recording.edits.base import Edit
from slamsim.recording.edits.cameras import ChangeCameras, ExchangeImages, kept, telling
from slamsim.recording.repairs.base import Repair


def scale_depths(recording: Recording, repair: Repair) -> Edit:
    """Multiply all depths of a topic by factor."""
    change = ScaleDepths(repair.number("factor"))
    return ChangeCameras(_subject(repair), lambda camera: camera.repainted(change))


def scale_focal(recording: Recording, repair: Repair) -> Edit:
    """Multiply the focal lengths of a topic's CameraInfo by factor."""
    factor = repair.number("factor")

    def scaled(camera: CameraSurvey) -> CameraSurvey:
        if camera.claim is None:
            return camera
        K = camera.claim.K.copy()
        K[[0, 1], [0, 1]] *= factor
        return replace(camera, claim=replace(camera.claim, K=K))

    return ChangeCameras(_subject(repair), scaled)


def set_readout(recording: Recording, repair: Repair) -> Edit:
    """Tell that a topic's images are exposed within readout_s, from the first row to the last."""
    return ChangeCameras(_subject(repair), telling(lambda _: repair.number("readout_s")))


def set_camera_size(recording: Recording, repair: Repair) -> Edit:
    """Scale a topic's CameraInfo to the size that its images have."""

    def resized(camera: CameraSurvey) -> CameraSurvey:
        claim = camera.claim
        if claim is None or claim.image_size == camera.size:
            return camera
        factor = camera.size[0] / claim.image_size[0]
        K = np.diag([factor, factor, 1.0]) @ claim.K
        P = np.diag([factor, factor, 1.0]) @ claim.P
        width, height = (round(factor * side) for side in (claim.width, claim.height))
        return replace(camera, claim=replace(claim, K=K, P=P, width=width, height=height))

    return ChangeCameras(_subject(repair), resized)


def drop_repeated_images(recording: Recording, repair: Repair) -> Edit:
    """Leave images out that are the one before again."""

    def once(camera: CameraSurvey) -> CameraSurvey:
        again = np.diff(camera.digests.astype(np.int64)) == 0
        return kept(camera, np.concatenate([[True], ~again]))

    return ChangeCameras(_subject(repair), once)


def drop_damaged_images(recording: Recording, repair: Repair) -> Edit:
    """Leave images out that cannot be decoded."""

    def whole(camera: CameraSurvey) -> CameraSurvey:
        return kept(camera, ~np.isin(np.arange(len(camera)), camera.damaged))

    return ChangeCameras(_subject(repair), whole)


def exchange_images(recording: Recording, repair: Repair) -> Edit:
    """Exchange the images of a topic with those of the topic other."""
    return ExchangeImages(repair.subject, str(repair.parameters["other"]))


def _subject(repair: Repair) -> Callable[[CameraSurvey], bool]:
    return lambda camera: camera.topic == repair.subject
