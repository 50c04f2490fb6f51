"""How a world looks to cameras: materials, posters, tags, panes and lamps.

Lidars measure the same whatever is said here: only cameras look at it.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from slamsim.config.base import Config
from slamsim.config.layout import Share
from slamsim.config.looks.lamps import LampsConfig
from slamsim.config.looks.walls import PanesConfig, PostersConfig, TagsConfig

Family = Literal["mixed", "office", "workshop", "bricks", "home"]
Split = Literal["train", "test"]


class LooksConfig(Config):
    """How the world looks to cameras."""

    family: Family = "mixed"
    """Materials of walls, floor and clutter: office (paint, plaster, linoleum), workshop
    (concrete), bricks (masonry, tiles), home (wood, fabric), or mixed: each surface of any."""
    split: Split = "train"
    """train or test: no texture, colour or poster of the one is ever in the other."""
    texture: Share = 1.0
    """From 0 (all is painted in one colour, and no poster hangs) to 1 (full contrast)."""
    seed: int | None = Field(default=None, ge=0, lt=2**63)
    """Seed of the looks alone; without one, the seed of the world."""
    posters: PostersConfig = PostersConfig()
    """Printed sheets on walls."""
    tags: TagsConfig = TagsConfig()
    """Marks on walls that cameras recognise."""
    panes: PanesConfig = PanesConfig()
    """Glass and mirrors."""
    lamps: LampsConfig = LampsConfig()
    """Light."""
