"""Light, for cameras."""

from __future__ import annotations

from pydantic import Field

from slamsim.config.base import Config


class LampsConfig(Config):
    """Lamps above free floor, and the light that comes from everywhere."""

    spacing_m: float = Field(default=3.5, ge=0.5, le=100.0)
    """Smallest distance between two lamps, in metres; there are as many as then find room."""
    height_m: float = Field(default=2.6, ge=0.2, le=50.0)
    """Height above the floor, in metres."""
    reach_m: float = Field(default=6.0, ge=0.5, le=200.0)
    """From here on a lamp gives no light, in metres; it fades smoothly until there."""
    brightness: float = Field(default=0.8, ge=0.0, le=100.0)
    """Light of one lamp on the floor right below it; 1 makes a white surface as bright as 1."""
    ambient: float = Field(default=0.25, ge=0.0, le=100.0)
    """Light from everywhere, in the same unit: what shadows are lit by."""
    shadowing: int = Field(default=4, ge=1, le=16)
    """Each point is lit by so many lamps at most, those that light it best."""
