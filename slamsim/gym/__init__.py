"""``import slamsim.gym`` registers ``slamsim/Labyrinth-v0`` with gymnasium (extra ``gym``)."""

from __future__ import annotations

from gymnasium.envs.registration import register, registry

LABYRINTH = "slamsim/Labyrinth-v0"


def register_environments() -> None:
    """What gymnasium calls of each installed package that has environments, and the import."""
    if LABYRINTH not in registry:
        register(LABYRINTH, entry_point="slamsim.gym.labyrinth:LabyrinthEnv")


register_environments()
