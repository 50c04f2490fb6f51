"""Settings of a stereo depth camera's errors."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from slamsim.config.base import Config


class DepthNoiseConfig(Config):
    """Errors of active stereo depth, by default of an Intel RealSense D435.

    Disparity is focal length times baseline over depth, so an error of disparity is one of depth
    that grows with the square of the depth (A. Grunnet-Jepsen, J. Sweetser, J. Woodfill,
    "Best-Known Methods for Tuning Intel RealSense D400 Depth Cameras for Best Performance").
    """

    baseline_m: float = Field(default=0.05, gt=1e-3, le=10.0)
    """Between the two infrared cameras: D435 0.05 m, D455 0.095 m, D415 0.055 m (data sheet)."""
    disparity_noise_px: float = Field(default=0.065, ge=0.0, le=10.0)
    """Standard deviation of disparity on a well lit wall; Intel gives 0.05 to 0.1 pixels. The
    default meets the curve published for the D435 within 5 % between 2.5 and 3.25 m."""
    disparity_step_px: float = Field(default=1.0 / 32.0, ge=0.0, le=1.0)
    """Disparity is told in such steps: the D4 chip has five bits below the pixel. 0 for any."""
    window_px: int = Field(default=5, ge=1, le=31)
    """Side of the matching window, over which neighbouring pixels have errors in common."""
    fattening_px: int = Field(default=2, ge=0, le=31)
    """By how many pixels what is near grows over what is behind it: half the window."""
    most_disparity_px: float = Field(default=126.0, gt=0.0, le=4096.0)
    """Larger disparities are not looked for, which sets the least distance: 0.18 m of a D435 at
    848 x 480 (126 is what the D4 chip searches)."""
    depth_min_m: float = Field(default=0.0, ge=0.0, le=100.0)
    """Nearer surfaces give no depth, even where the search would find them."""
    depth_max_m: float = Field(default=10.0, gt=0.0, le=65.0)
    """Surfaces farther away give no depth."""
    signal_full: float = Field(default=0.3, gt=0.0, le=1.0)
    """Reflectance times cosine of incidence from which the noise is that of a well lit wall. Below
    it grows with the root of what is missing, as shot noise does, up to three times."""
    signal_least: float = Field(default=0.04, ge=0.0, le=1.0)
    """Where half of the pixels find no match any more: black cloth, grazed floors. 0 for never."""
    shiny_below_roughness: float = Field(default=0.15, ge=0.0, le=1.0)
    """Smoother surfaces throw the pattern away like a mirror: their signal falls with the
    roughness; head-on they dazzle the camera. 0 for no such effect."""
    distortion_table: Path | None = None
    """A measured distortion of depth as Redwood publishes it (S. Choi, Q.-Y. Zhou, V. Koltun,
    "Robust Reconstruction of Indoor Scenes", 2015): a .npy file of 80 x 400 numbers."""
