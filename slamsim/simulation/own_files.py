"""Copies the configuration and the files that it names into the folder of a run.

A file may come from anyone, so each goes through the loader of its kind first, which says what
else it names; nothing is copied before all have passed, and nothing to a place outside.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TypeVar

from slamsim.config.base import Config
from slamsim.config.bundled import Kind, bundled_folder, find_input
from slamsim.config.drive import RouteConfig
from slamsim.config.dump import dump_commented_yaml
from slamsim.config.faults import FaultChoice
from slamsim.config.layout import ImageLayout, MeshLayout
from slamsim.config.loading import load_model
from slamsim.config.robot import RobotConfig
from slamsim.config.run import RunConfig
from slamsim.guard.errors import InputRefused
from slamsim.guard.files import leads_outside, read_input
from slamsim.guard.mesh_file import check_mesh_file
from slamsim.guard.output import write_atomic
from slamsim.guard.urdf import read_urdf
from slamsim.sensors.faults.registry import load_fault
from slamsim.sim.drive.route_file import read_route
from slamsim.world.looks.build import build_looks
from slamsim.world.looks.tags import tags_yaml
from slamsim.world.map_server import read_cells
from slamsim.world.model import World

WORLD, CONFIG, FILES, TAGS = "world.yaml", "config.yaml", "files", "tags.yaml"
_Model = TypeVar("_Model", bound=Config)


def write_config(folder: Path, config: RunConfig) -> None:
    """``config.yaml``: every setting, so that the run can be had again; ``files/`` for it."""
    _write_yaml(folder / CONFIG, config)


def write_world(folder: Path, config: RunConfig, world: World) -> None:
    """``world.yaml``: this very world, whatever the seed of the next run; ``files/`` for it.
    ``tags.yaml``, if tags hang in it: where."""
    _write_yaml(folder / WORLD, config.world.model_copy(update={"seed": world.seed}))
    if config.world.looks.tags.count:
        tags = build_looks(world, config.world.looks).tags
        write_atomic(folder / TAGS, tags_yaml(tags))


def _write_yaml(path: Path, config: Config) -> None:
    own = with_own_files(path.parent, config)
    write_atomic(path, dump_commented_yaml(own).encode())


def with_own_files(folder: Path, config: _Model) -> _Model:
    """Copy every file that the configuration names into ``files/`` of the folder.

    Returns the configuration that names the copies, for a file in that folder. Raises
    SlamsimError, before anything is copied, for a file that is gone or that its loader refuses.
    """
    copies = _Copies(folder)
    own = copies.renamed("", FILES, config)
    for target, read in copies.planned.items():
        write_atomic(target, read())
    return own


@dataclass(frozen=True, slots=True)
class _Copies:
    """What is to be written below a folder, and how its bytes are had."""

    folder: Path
    planned: dict[Path, Callable[[], bytes]] = field(default_factory=dict)

    def renamed(self, base: str, at: str, model: _Model) -> _Model:
        """The model with the names of the copies, which start at ``base`` and lie in ``at``."""
        changed: dict[str, object] = {}
        for name in type(model).model_fields:
            value = getattr(model, name)
            if isinstance(value, Config):
                changed[name] = self.renamed(base, f"{FILES}/{name}", value)
            elif isinstance(value, str) and name.split("_")[-1] == "file":
                changed[name] = self._files(base, at, Path(value), _named_by(model, Path(value)))
            elif name == "faults":
                changed[name] = tuple(
                    self._fault(base, f"{FILES}/{name}/{number}", choice)
                    for number, choice in enumerate(value)
                )
            elif name == "beside":
                changed[name] = tuple(
                    self._robot(f"{FILES}/{name}/{number}", robot)
                    for number, robot in enumerate(value)
                )
        return model.model_copy(update=changed)

    def _files(self, base: str, at: str, source: Path, beside: dict[str, str]) -> str:
        for name, limit in beside.items():
            origin = source.parent / name
            self._plan(f"{base}{at}/{name}", partial(read_input, origin, limit), origin)
        return f"{at}/{source.name}"

    def _fault(self, base: str, at: str, choice: FaultChoice) -> FaultChoice:
        path = _own(choice.name, "configs/faults")
        if path is None:
            return choice
        load_fault(str(path))
        copy = self._files(base, at, path, {path.name: "yaml_bytes"})
        return choice.model_copy(update={"name": copy})

    def _robot(self, at: str, robot: str) -> str:
        path = _own(robot, "configs/robots")
        if path is None:
            return robot
        config = self.renamed(f"{at}/", FILES, load_model(RobotConfig, path))
        text = dump_commented_yaml(config).encode()
        self._plan(f"{at}/{path.name}", lambda: text, path)
        return f"{at}/{path.name}"

    def _plan(self, name: str, read: Callable[[], bytes], origin: Path) -> None:
        if leads_outside(self.folder, name):
            raise InputRefused(origin, f"would be copied to {name}, outside of {self.folder}")
        self.planned[self.folder / name] = read


def _named_by(model: Config, file: Path) -> dict[str, str]:
    """The file that a section names and what that names in turn, each with its limit of bytes.

    Names are relative to the folder of the file. Raises what the loader of its kind raises.
    """
    if isinstance(model, ImageLayout):
        described, *_ = read_cells(file)
        return {file.name: "yaml_bytes", described.image: "image_file_bytes"}
    if isinstance(model, MeshLayout):
        check_mesh_file(file)
        return {file.name: "mesh_file_bytes"}
    if isinstance(model, RobotConfig):
        _, meshes = read_urdf(file)
        return {file.name: "urdf_bytes", **dict.fromkeys(meshes, "mesh_file_bytes")}
    if isinstance(model, RouteConfig):
        read_route(file)
        return {file.name: "text_total_bytes" if file.suffix.lower() == ".csv" else "yaml_bytes"}
    raise TypeError(f"no loader is known for the file of a {type(model).__name__}")


def _own(name: str, kind: Kind) -> Path | None:
    """The file of that name, nothing for a bundled one."""
    path = find_input(kind, name)
    return None if path.parent == bundled_folder(kind) else path
