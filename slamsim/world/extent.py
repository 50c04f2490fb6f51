"""Whether an imported world has a size that a robot of this size may drive in: the wrong unit of
length is the usual mistake, and a mesh does not say in which it is."""

from __future__ import annotations

import logging

from slamsim.config.layout import ImageLayout, MeshLayout
from slamsim.guard.errors import InputRefused
from slamsim.world.model import Bounds
from slamsim.world.reachable_space import coarsest_m

_log = logging.getLogger(__name__)

USUAL_WIDTHS = 400
"""Buildings of well-known 2-D SLAM recordings are 30 m (Intel lab) to 250 m (MIT Killian Court)
across, for robots that need ways of about 0.6 m: so many of these widths."""

USUAL_HEIGHT_M = 20.0
"""As high as the walls of our own worlds may be: ``walls.height_m``."""


def check_extent(
    layout: ImageLayout | MeshLayout, bounds_m: Bounds, height_m: float, clearance_m: float
) -> None:
    """Warn of a world that is far larger than buildings are, for a robot of this clearance.

    Raises InputRefused for one so large that ways of this clearance cannot be found in it.
    """
    x_m, y_m = bounds_m[2] - bounds_m[0], bounds_m[3] - bounds_m[1]
    told = f"is {x_m:.4g} x {y_m:.4g} m large and {height_m:.4g} m high"
    if coarsest_m(bounds_m) > 0.5 * clearance_m:
        reason = f"{told}: too large to find ways of clearance_m {clearance_m:g} in it"
        raise InputRefused(layout.file, f"{reason}; {_remedy(layout)}")
    if max(x_m, y_m) > USUAL_WIDTHS * clearance_m or height_m > USUAL_HEIGHT_M:
        _log.warning("%s %s, far larger than buildings are; %s", layout.file, told, _remedy(layout))


def _remedy(layout: ImageLayout | MeshLayout) -> str:
    if isinstance(layout, ImageLayout):
        return "check its resolution, which is in metres per pixel"
    return f"if its numbers are millimetres, --set world.mesh.scale={0.001 * layout.scale:g}"
