"""A rotating planar lidar: its beams, its noise, what it does at edges."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from slamsim.config.base import Config
from slamsim.config.streams import StreamConfig


class RangeNoiseConfig(Config):
    """Normal noise on each range; the three parts add as variances."""

    constant_m: float = Field(default=0.008, ge=0.0, le=1.0)
    """Standard deviation that every return has."""
    proportional: float = Field(default=0.0006, ge=0.0, le=0.5)
    """Standard deviation as a share of the range."""
    spot_mrad: float = Field(default=0.5, ge=0.0, le=50.0)
    """Spread of the light within the beam (a quarter of its width if the spot is round): on a
    slanted wall it gives a standard deviation of range x this x tan(incidence)."""


class DropoutConfig(Config):
    """Chance that a beam on a surface gives no return: the three parts add up, at most 1."""

    probability: float = Field(default=0.001, ge=0.0, le=1.0)
    """For every beam."""
    at_max_range: float = Field(default=0.02, ge=0.0, le=1.0)
    """More with distance: this x (range / maximum range) squared."""
    at_grazing: float = Field(default=0.02, ge=0.0, le=1.0)
    """More with slant: this x (1 - cos(incidence))."""


class MixedReturnsConfig(Config):
    """Beams that straddle an edge and see two surfaces (mixed pixels)."""

    divergence_mrad: float = Field(default=2.0, ge=0.0, le=50.0)
    """Full width of the beam in the scan plane; 0 makes beams infinitely thin: no mixing."""
    probability: float = Field(default=0.5, ge=0.0, le=1.0)
    """Share of straddling beams that report a mixture; the others report the stronger surface."""
    min_gap_m: float = Field(default=0.05, gt=0.0, le=10.0)
    """Surfaces closer together along the beam than this are one."""
    max_gap_m: float = Field(default=1.5, gt=0.0, le=1000.0)
    """Surfaces further apart than this never mix: half the length of the light pulse."""


class LidarConfig(StreamConfig):
    """A rotating 2-D lidar; its beams fire one after the other, counter-clockwise from above."""

    rate_hz: float = Field(default=40.0, gt=0.01, le=1000.0)
    """Turns and scans per second."""
    rolling: bool = True
    """False fires all beams of a scan at once, at its stamp."""
    angle_min_deg: float = Field(default=-135.0, ge=-360.0, le=360.0)
    """Direction of beam 0 in the laser frame."""
    angle_step_deg: float = Field(default=0.25, gt=0.001, le=90.0)
    """From each beam to the next; with rate_hz it gives the time between them."""
    beam_count: int = Field(default=1081, ge=1, le=100_000)
    """Beams in a scan."""
    range_min_m: float = Field(default=0.1, ge=0.0, le=10.0)
    """Closer readings are invalid (nan)."""
    range_max_m: float = Field(default=30.0, gt=0.0, le=1000.0)
    """Further readings are no return (inf)."""
    resolution_m: float = Field(default=0.001, ge=0.0, le=1.0)
    """Readings are whole multiples of this; 0 leaves them as they are."""
    max_incidence_deg: float = Field(default=88.0, gt=0.0, le=90.0)
    """Surfaces that slant away further than this from facing the beam give no return."""
    noise: RangeNoiseConfig = RangeNoiseConfig()
    """Noise of the ranges."""
    dropout: DropoutConfig = DropoutConfig()
    """Returns that get lost."""
    mixed: MixedReturnsConfig = MixedReturnsConfig()
    """What happens at edges."""
    meets_panes: bool = False
    """Glass of ``world.looks.panes`` lets beams through and mirrors throw them back, as they do to
    real lidars; without, both are as the wall behind them."""
    intensities: bool = False
    """Record the strength of each return: cos(incidence) / max(range, 1 m) squared."""

    @property
    def beam_dt_ns(self) -> int:
        """Time from each beam to the next: the share of a turn between them."""
        turn_ns = 1e9 / self.rate_hz
        return round(turn_ns * self.angle_step_deg / 360.0) if self.rolling else 0

    @model_validator(mode="after")
    def _fits_into_a_turn(self) -> Self:
        if self.range_max_m <= self.range_min_m:
            raise ValueError(
                f"range_max_m ({self.range_max_m:g}) must exceed range_min_m ({self.range_min_m:g})"
            )
        swept = self.beam_count * self.angle_step_deg
        if swept > 360.0 + 1e-6 * self.angle_step_deg:
            raise ValueError(
                f"{self.beam_count} beams of {self.angle_step_deg:g} deg sweep {swept:g} deg, "
                f"but a turn has 360: at most {int(360.0 / self.angle_step_deg + 1e-6)} beams fit"
            )
        return self
