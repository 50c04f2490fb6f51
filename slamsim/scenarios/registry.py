"""The nine scenarios by name; each is imported on first use."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

from slamsim.guard.errors import NotFound, did_you_mean, shown

if TYPE_CHECKING:
    from slamsim.config.base import Config
    from slamsim.scenarios.base import Scenario

ALL = "all"


@dataclass(frozen=True, slots=True)
class Entry:
    """name: as it is typed. asks: what the scenario asks, in one line. settings: its model,
    below ``slamsim.config.scenarios``.
    """

    name: str
    asks: str
    settings: str

    @property
    def key(self) -> str:
        """The name as it stands in keys, modules and files."""
        return self.name.replace("-", "_")

    @property
    def module(self) -> str:
        """Where its ``SCENARIO`` stands, below this package."""
        apart = self.name in ("umbmark", "slam")
        return f"{self.key}.scenario" if apart else f"physics.{self.key}"

    def config_type(self) -> type[Config]:
        """The model of its parameters."""
        module, model = self.settings.split(".")
        found: type[Config] = getattr(import_module(f"slamsim.config.scenarios.{module}"), model)
        return found

    def scenario(self) -> Scenario[Any]:
        """The scenario itself, with the libraries that it needs."""
        found: Scenario[Any] = import_module(f"slamsim.scenarios.{self.module}").SCENARIO
        return found


ENTRIES = (
    Entry(
        "stacking",
        "how many boxes stand on one another at which time step",
        "bodies.StackingConfig",
    ),
    Entry("collision", "how deep bodies sink into each other", "bodies.CollisionConfig"),
    Entry("integrator", "how far a free fall is from theory", "bodies.IntegratorConfig"),
    Entry("mu-split", "one wheel on a slippery floor", "robots.MuSplitConfig"),
    Entry("ramp", "up a slope, until wheels slip or the robot tips over", "robots.RampConfig"),
    Entry("friction-turn", "a heavy box at 20° turns the robot", "robots.FrictionTurnConfig"),
    Entry("basic-drive", "forth and back, and where it stops", "robots.BasicDriveConfig"),
    Entry(
        "umbmark",
        "squares in both directions: odometry judged and corrected",
        "robots.UmbmarkConfig",
    ),
    Entry(
        "slam", "a labyrinth mapped, with what went wrong in the study", "slam_case.SlamCaseConfig"
    ),
)


def find_entries(name: str) -> tuple[Entry, ...]:
    """The scenario of that name, or all of them. Raises NotFound naming the nearest."""
    if name == ALL:
        return ENTRIES
    wanted = name.replace("_", "-")
    for entry in ENTRIES:
        if entry.name == wanted:
            return (entry,)
    names = [*(entry.name for entry in ENTRIES), ALL]
    meant = did_you_mean(wanted, names)
    raise NotFound(f"there is no scenario {shown(name)}{meant} ({', '.join(names)})")
