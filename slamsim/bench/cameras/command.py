"""``slamsim bench cameras``: each part gives its figures; a further part is a line in ``PARTS``."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from slamsim.bench.cameras.flow import measure_flow
from slamsim.bench.cameras.hall import measure_tags
from slamsim.bench.cameras.odometry import measure_odometry
from slamsim.bench.cameras.speed import measure_speed
from slamsim.bench.cameras.tags import measure_tag_nees
from slamsim.config.run import RunConfig
from slamsim.console.reporter import Reporter

Figures = dict[str, object]

CAMERA_SECONDS = 10.0
"""Of the drive in which speed is measured, where nothing else is asked for."""

PARTS: Mapping[str, Callable[[RunConfig, Reporter], Figures]] = {
    "speed": measure_speed,
    "flow": measure_flow,
    "tags": measure_tags,
    "tag errors": measure_tag_nees,
    "odometry": measure_odometry,
}
"""By name. What they are given: the world in which cameras drive, and where progress is told."""


def measure_cameras(config: RunConfig, reporter: Reporter) -> Figures:
    """All figures of all parts."""
    figures: Figures = {"world": config.world.name}
    for measure in PARTS.values():
        figures.update(measure(config, reporter))
    return figures
