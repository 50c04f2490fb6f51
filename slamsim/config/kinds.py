"""Lists of entries whose ``type`` selects a model defined by a plug-in module.

A kind more is a module in the package that is named here, or in an installed distribution that
names one in the entry-point group of that name.
"""

from __future__ import annotations

from functools import reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from slamsim.config.streams import SensorEntry, SinkEntry
from slamsim.guard.plugins import kinds_in, left_out

SENSOR_KINDS, SINK_KINDS = "slamsim.sensors.kinds", "slamsim.simulation.sinks"

if TYPE_CHECKING:
    AdditionalSensors = tuple[SensorEntry, ...]
    Sinks = tuple[SinkEntry, ...]
else:

    def _list_of(package: str, parent: type[Any]) -> Any:
        """A tuple of entries, each validated by the model of its own ``type``."""
        kinds = tuple(dict.fromkeys(kinds_in(package, parent, "type").values()))
        if len(kinds) == 1:
            return tuple[kinds[0], ...]
        return tuple[Annotated[reduce(or_, kinds), Field(discriminator="type")], ...]

    AdditionalSensors = _list_of(SENSOR_KINDS, SensorEntry)
    Sinks = _list_of(SINK_KINDS, SinkEntry)


def missing_kinds() -> str:
    """Which modules of distributions add no kind although they should; "" for none."""
    return left_out(SENSOR_KINDS, SINK_KINDS)
