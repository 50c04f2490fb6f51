"""Settings of a camera, its frames, and where its imagers sit.

The mount is that of the body frame (x forward); images are in ``NAME_IMAGER_optical_frame`` (z
forward, x right, y down, REP 103), topics below ``/NAME/IMAGER``, the truth below
``/ground_truth/NAME/IMAGER``.
"""

from __future__ import annotations

from typing import Annotated, Self

import numpy as np
from pydantic import Field, StringConstraints, model_validator

from slamsim.cameras.presets import PRESETS, PresetName, with_preset
from slamsim.cameras.settings import ImagerConfig, OffsetConfig, ProjectorConfig
from slamsim.config.streams import SensorEntry
from slamsim.core.geometry import StaticTransform, mount_transform, se3_from_parts
from slamsim.core.types import FloatArray

R_CAMERA_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""From an optical frame to a frame that looks along x."""
T_CAMERA_OPTICAL = se3_from_parts(R_CAMERA_OPTICAL, np.zeros(3))

ImagerName = Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9_]{0,40}$")]


class CameraSettings(SensorEntry):
    """A camera: one clock, and imagers that are exposed at the same instants."""

    preset: PresetName | None = None
    """Settings of a camera that there is; what else is said here counts before them."""
    rate_hz: float = Field(default=30.0, gt=0.01, le=1000.0)
    """Images per second."""
    imagers: Annotated[dict[ImagerName, ImagerConfig], Field(min_length=1, max_length=8)] = Field(
        default={"color": ImagerConfig()}
    )
    """Each under its name, which is part of its topics."""
    projector: ProjectorConfig | None = None
    """Infrared dots, which imagers of kind ``infrared`` see; without it, none."""
    mount_error: OffsetConfig = OffsetConfig()
    """How the camera truly sits in the place that ``mount`` claims: the transform tree and
    CameraInfo know nothing of it."""

    @model_validator(mode="before")
    @classmethod
    def _preset_below(cls, data: object) -> object:
        preset = data.get("preset") if isinstance(data, dict) else None
        known = isinstance(preset, str) and preset in PRESETS
        return with_preset(data) if isinstance(data, dict) and known else data

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not self.enabled_imagers:
            raise ValueError("all imagers are switched off; switch the camera off by 'enabled'")
        for name, config in self.enabled_imagers.items():
            other = config.depth.aligned_to
            if other and (other not in self.enabled_imagers or not config.is_depth):
                known = ", ".join(self.enabled_imagers)
                raise ValueError(
                    f"the depth of {name!r} cannot be aligned to {other!r}; imagers are {known}"
                )
            if f"aligned_depth_to_{other}" in self.enabled_imagers:
                raise ValueError(
                    f"'aligned_depth_to_{other}' is where the depth of {name!r} goes; rename it"
                )
            if config.stereo_left and config.stereo_left not in self.enabled_imagers:
                known = ", ".join(self.enabled_imagers)
                raise ValueError(
                    f"{name!r} cannot be a pair with {config.stereo_left!r}; imagers are {known}"
                )
            if config.readout_s >= 1.0 / self.rate_hz:
                raise ValueError(
                    f"readout_s {config.readout_s} of {name!r} must be shorter than a period"
                )
        return self

    @property
    def enabled_imagers(self) -> dict[str, ImagerConfig]:
        """Those that are switched on."""
        return {name: config for name, config in self.imagers.items() if config.enabled}

    def right_of_m(self, imager: str, is_claimed: bool) -> float:
        """How far an imager is to the right of the left one of its pair; 0 without one."""
        config = self.imagers[imager]
        if not config.stereo_left:
            return 0.0
        pair = self.imagers[config.stereo_left], config
        left, right = ((c.claimed_offset if is_claimed else None) or c.offset for c in pair)
        return left.y_m - right.y_m

    def optical_frame(self, imager: str) -> str:
        """The frame of an imager's images."""
        return f"{self.name}_{imager}_optical_frame"

    def T_base_imager(self, config: ImagerConfig) -> FloatArray:  # noqa: N802
        """(4, 4) of the optical frame, as it truly is."""
        return self._true_place(config.offset)

    @property
    def T_base_projector(self) -> FloatArray:  # noqa: N802
        """(4, 4) of the projector's optical frame, as it truly is; of none the camera's."""
        return self._true_place((self.projector or ProjectorConfig()).offset)

    def _true_place(self, offset: OffsetConfig) -> FloatArray:
        T_base_camera = mount_transform(self.mount) @ mount_transform(self.mount_error)
        return np.asarray(T_base_camera @ mount_transform(offset) @ T_CAMERA_OPTICAL)

    @property
    def frames(self) -> tuple[StaticTransform, ...]:
        return tuple(
            StaticTransform(
                self.frame,
                self.optical_frame(name),
                mount_transform(config.claimed_offset or config.offset) @ T_CAMERA_OPTICAL,
            )
            for name, config in self.enabled_imagers.items()
        )
