"""How the occupancy grid is drawn from the scans and the trajectory."""

from __future__ import annotations

from pydantic import Field

from slamsim.config.base import Config


class MappingConfig(Config):
    """Log-odds occupancy grid (Moravec & Elfes 1985; Thrun, Burgard & Fox 2005, chapter 9)."""

    resolution_m: float = Field(0.05, gt=0.0, le=10.0)
    """Side of a cell."""

    max_range_m: float = Field(30.0, gt=0.0, le=1e6)
    """Returns farther than this only clear, up to this range."""

    clear_without_return_m: float = Field(8.0, ge=0.0, le=1e6)
    """A beam without return clears up to this range; 0 leaves such beams out."""

    min_travel_m: float = Field(0.06, ge=0.0, le=1e6)
    """A scan is used once the robot has travelled this far since the last one used ..."""

    min_turn_deg: float = Field(4.0, ge=0.0, le=180.0)
    """... or has turned by this much. Both 0: every scan is used."""

    hit_probability: float = Field(0.64, gt=0.5, lt=1.0)
    """Probability that a cell is occupied, given one return from it: by default one alone is not
    enough to be drawn as a wall."""

    miss_probability: float = Field(0.43, gt=0.0, lt=0.5)
    """Probability that a cell is occupied, given one beam through it."""

    min_probability: float = Field(0.02, gt=0.0, lt=0.5)
    """No cell becomes surer to be free than this."""

    max_probability: float = Field(0.98, gt=0.5, lt=1.0)
    """No cell becomes surer to be occupied than this."""

    max_cells: int = Field(200_000_000, gt=0)
    """A map that would need more cells than this is refused."""
