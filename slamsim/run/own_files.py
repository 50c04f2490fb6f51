"""What a configuration names, copied beside it: a run's folder needs nothing from elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

from defusedxml.ElementTree import fromstring

from slamsim.config.base import Config
from slamsim.config.bundled import Kind, bundled_folder, find_input
from slamsim.config.dump import dump_commented_yaml
from slamsim.config.faults import FaultChoice
from slamsim.config.layout import ImageLayout
from slamsim.config.loading import load_model
from slamsim.config.robot import RobotConfig
from slamsim.safe.output import write_atomic
from slamsim.world.map_server import MapServerMap

FILES = "files"
_Model = TypeVar("_Model", bound=Config)


def with_own_files(folder: Path, config: _Model) -> _Model:
    """Copy every file that the configuration names into ``files/`` of the folder.

    Returns the configuration that names the copies, for a file in that folder. Raises
    SlamsimError for a file that is gone meanwhile.
    """
    return _kept(folder, FILES, config)


def _kept(folder: Path, at: str, model: _Model) -> _Model:
    changed: dict[str, object] = {}
    for name in type(model).model_fields:
        value = getattr(model, name)
        if isinstance(value, Config):
            changed[name] = _kept(folder, f"{FILES}/{name}", value)
        elif isinstance(value, str) and name.split("_")[-1] == "file":
            changed[name] = _copied(folder, at, Path(value), *_needed(model, Path(value)))
        elif name == "faults":
            changed[name] = tuple(
                _kept_fault(folder, f"{FILES}/{name}/{number}", choice)
                for number, choice in enumerate(value)
            )
        elif name == "beside":
            changed[name] = tuple(
                _kept_robot(folder, f"{FILES}/{name}/{number}", robot)
                for number, robot in enumerate(value)
            )
    return model.model_copy(update=changed)


def _needed(model: Config, file: Path) -> list[str]:
    """What the file that a section names has beside it."""
    if isinstance(model, ImageLayout):
        return [load_model(MapServerMap, file).image]
    if isinstance(model, RobotConfig):
        return [mesh.attrib["filename"] for mesh in fromstring(file.read_bytes()).iter("mesh")]
    return []


def _copied(folder: Path, at: str, source: Path, *beside: str) -> str:
    for name in (source.name, *beside):
        write_atomic(folder / at / name, (source.parent / name).read_bytes())
    return f"{at}/{source.name}"


def _kept_fault(folder: Path, at: str, choice: FaultChoice) -> FaultChoice:
    path = _own(choice.name, "configs/faults")
    return choice if path is None else choice.model_copy(update={"name": _copied(folder, at, path)})


def _kept_robot(folder: Path, at: str, robot: str) -> str:
    path = _own(robot, "configs/robots")
    if path is None:
        return robot
    config = with_own_files(folder / at, load_model(RobotConfig, path))
    write_atomic(folder / at / path.name, dump_commented_yaml(config).encode())
    return f"{at}/{path.name}"


def _own(name: str, kind: Kind) -> Path | None:
    """The file of that name, nothing for a bundled one."""
    path = find_input(kind, name)
    return None if path.parent == bundled_folder(kind) else path
