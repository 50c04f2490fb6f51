"""Loads and validates a configuration from files, bundled names and ``--set``.

A section may be a mapping, or the name or path of a file that holds one; a mapping may start
from such a file with ``preset: name`` and change single keys. A relative name, or one under a
key that is ``file`` or ends in ``_file``, starts at the folder of the file that says so, and may
not leave it: names on the command line may. Whatever is wrong is told with the file, line and key
path where it was written, and with what would be right.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from pydantic import ValidationError

from slamsim.config.base import Config
from slamsim.config.bundled import Kind, bundled_folder, find_input
from slamsim.config.explain import refusal
from slamsim.config.faults import as_choice
from slamsim.config.merging import Place, Tree, mount, parse_override
from slamsim.guard.errors import InputRefused, OverrideRefused, shown
from slamsim.guard.files import own_file
from slamsim.guard.yaml import KeyPath, YamlDocument, load_yaml

if TYPE_CHECKING:
    from slamsim.config.run import RunConfig
    from slamsim.config.world import WorldConfig

Model = TypeVar("Model", bound=Config)

SECTIONS: dict[KeyPath, Kind] = {
    ("world",): "worlds",
    ("robot",): "configs/robots",
    ("drive",): "configs/drives",
    ("sensors",): "configs/sensors",
    ("sensors", "lidar"): "configs/sensors",
    ("sensors", "imu"): "configs/sensors",
    ("sensors", "encoders"): "configs/sensors",
    ("slam",): "configs/slam",
}
_LISTS: dict[str, Kind] = {"faults": "configs/faults", "beside": "configs/robots"}
"""Keys of lists of names; a fault may have its size behind a colon, or under a key of its own."""
_IMAGES = frozenset((".pgm", ".png"))
_MESHES = frozenset((".stl", ".obj", ".ply", ".glb"))
_MAX_PRESETS = 8


def load_model(model_type: type[Model], path: Path, overrides: Sequence[str] = ()) -> Model:
    """One model from one YAML file; ``overrides`` are ``key.path=value``.

    Raises NotFound, InputRefused for what the file says, OverrideRefused for the overrides.
    """
    tree = mount(load_yaml(path))
    for text in overrides:
        parts, value, place = parse_override(text)
        tree = tree.overlaid(tree.with_indices(parts, place), value, place)
    return validated(model_type, tree)


def load_run_config(
    world: str | None,
    config: str | None = None,
    overrides: Sequence[str] = (),
    seed: int | None = None,
) -> RunConfig:
    """Everything a run needs, complete.

    world: name or path of a world file, of a map_server map (its YAML, or the image beside it)
    or of a mesh, or of a whole run configuration; None leaves it to ``config``. config: name or
    path of a run configuration. What comes later wins: defaults, config, world, overrides in their
    order, seed. Raises as ``load_model`` does.
    """
    from slamsim.config.run import RunConfig

    tree = Tree()
    if config is not None:
        tree = with_presets(mount(load_yaml(find_input("configs", config))))
    if world is not None:
        tree = _with_world(tree, find_input("worlds", world), config)
    for text in overrides:
        tree = overridden(tree, text, SECTIONS)
    if seed is not None:
        tree = tree.overlaid(("seed",), seed, Place(None, option=f"--seed {seed}"))
    return validated(RunConfig, tree)


def with_drive_seed(config: RunConfig, seed: int) -> RunConfig:
    """The same world with another drive: its noise follows from this seed alone, and its route,
    which leads to random goals, since there is one shortest tour. A route from a file stays.
    """
    own = config.seed if config.world.seed is None else config.world.seed
    route = config.drive.route.model_copy(update={"seed": seed, "kind": "random_goals"})
    return config.model_copy(
        update={
            "seed": seed,
            "world": config.world.model_copy(update={"seed": own}),
            "drive": config.drive.model_copy(update={"route": route}),
        }
    )


def _with_world(tree: Tree, path: Path, config: str | None) -> Tree:
    """With the world of this file, or all of it where it is a run configuration, as
    ``slamsim config`` prints one: its world is a section among others.

    Raises OverrideRefused for two run configurations.
    """
    document = load_yaml(path) if path.suffix.lower() in (".yaml", ".yml") else None
    if document is None or not isinstance(document.data, dict) or "world" not in document.data:
        return tree.replaced(("world",), _world_tree(path, ("world",)))
    if config is not None:
        reason = f"{path} is a run configuration, too; name a world, or leave one of them out"
        raise OverrideRefused(f"--config {shown(config)}", reason)
    return with_presets(mount(document))


def load_simulated_config(path: Path) -> RunConfig:
    """How a recording was simulated, from the ``config.yaml`` beside it.

    What SLAM and mapping were set to at that time is not looked at, since their settings change
    from version to version; they are the defaults here. Raises as ``load_model`` does.
    """
    from slamsim.config.run import RunConfig

    tree = mount(load_yaml(path))
    for later in ("slam", "mapping"):
        tree = tree.section((), leaving_out=later)
    return validated(RunConfig, tree)


def load_world_config(world: str) -> WorldConfig:
    """A world alone, by name or path as in ``load_run_config``."""
    from slamsim.config.world import WorldConfig

    return validated(WorldConfig, _world_tree(find_input("worlds", world), ()))


def validated(model_type: type[Model], tree: Tree) -> Model:
    """The model that the data make; what is refused is told with its place."""
    try:
        return model_type.model_validate(located(tree).data)
    except ValidationError as error:
        raise refusal(model_type, tree, error) from None


def overridden(tree: Tree, text: str, sections: Mapping[KeyPath, Kind]) -> Tree:
    """With one ``key.path=value`` set; raises OverrideRefused."""
    parts, value, place = parse_override(text)
    path = tree.with_indices(parts, place)
    if path[-1:] == ("preset",) and path[:-1] in sections:
        path = path[:-1]  # a preset chosen here takes the place of the one in the file
    tree = tree.overlaid(path, value, place)
    return with_presets(tree, sections)


def with_presets(tree: Tree, sections: Mapping[KeyPath, Kind] = SECTIONS) -> Tree:
    """With every one of these sections that is, or starts from, a file's name filled in."""
    for at, kind in sections.items():
        for _ in range(_MAX_PRESETS):
            is_name = isinstance(tree.get(at), str)
            name_at = at if is_name else (*at, "preset")
            name, place = tree.get(name_at), tree.place_of(name_at)
            if name is None and name_at not in tree.places:
                break
            if not isinstance(name, str):
                raise place.refusal(name_at, f"must be the name or path of a file, not {name!r}")
            preset = section_tree(kind, name, place, at)
            tree = tree.replaced(
                at, preset if is_name else preset.merged(tree.section(at, "preset"))
            )
        else:
            raise place.refusal(name_at, f"the presets start from one another ({name!r} again)")
    return tree


def section_tree(kind: Kind, name: str, place: Place, at: KeyPath) -> Tree:
    """What a section at ``at`` becomes that names a file; place: where it names it."""
    place.require_own(at, name)
    path = find_input(kind, name, None if place.path is None else place.folder)
    if kind == "worlds":
        return _world_tree(path, at)
    document = load_yaml(path)
    if len(at) > 1 and isinstance(document.data, dict) and at[-1] in document.data:
        return mount(document, at[:-1]).section(at)  # one sensor out of a file of sensors
    return mount(document, at)


def _world_tree(path: Path, at: KeyPath) -> Tree:
    """The keys of a world file, or of the world that a map or a mesh stands for."""
    suffix = path.suffix.lower()
    if suffix in _MESHES:
        return _layout_tree("mesh", path, at)
    if suffix in _IMAGES:
        beside = path.with_suffix(".yaml")
        if not beside.is_file():
            reason = f"has no size in metres; describe it in {beside.name} (image, resolution)"
            raise InputRefused(path, f"{reason} as ROS map_server does")
        return _layout_tree("image", own_file(path.parent, beside.name), at)
    document = load_yaml(path)
    if _is_map_server(document):
        return _layout_tree("image", path, at)
    return mount(document, at)


def _is_map_server(document: YamlDocument) -> bool:
    data = document.data
    return isinstance(data, dict) and "resolution" in data and isinstance(data.get("image"), str)


def _layout_tree(layout: str, path: Path, at: KeyPath) -> Tree:
    file = path.resolve()
    place, data = Place(file, 1, mount=at), {"name": path.stem, layout: {"file": file.name}}
    return Tree().overlaid(at, data, place) if at else Tree(dict(data), {(): place})


def located(tree: Tree) -> Tree:
    """With absolute file names, which mean the same wherever they are used.

    Raises if a file names what lies outside of its folder, NotFound for a name in a list that
    neither a file nor a bundled one has.
    """

    def placed(at: KeyPath, value: object) -> object:
        if isinstance(value, dict):
            return {key: placed((*at, key), inner) for key, inner in value.items()}
        if isinstance(value, list):
            return [placed((*at, index), inner) for index, inner in enumerate(value)]
        return _located_text(value, at, tree.place_of(at)) if isinstance(value, str) else value

    return replace(tree, data={key: placed((key,), value) for key, value in tree.data.items()})


def _located_text(text: str, at: KeyPath, place: Place) -> str:
    if text and str(at[-1]).split("_")[-1] == "file":
        place.require_own(at, text)
        try:
            return str((place.folder / text).resolve())
        except (OSError, ValueError, RuntimeError) as error:
            raise place.refusal(at, f"{shown(text)} is not a file name: {error}") from None
    kind = _LISTS.get(_list_key(at))
    return text if kind is None else _located_name(kind, text, at, place)


def _list_key(path: KeyPath) -> str:
    """``faults`` for ``faults[2]`` and ``faults[2].name``, nothing for what is in no list."""
    inner = path[:-1] if path[-1:] == ("name",) else path
    return str(inner[-2]) if len(inner) > 1 and isinstance(inner[-1], int) else ""


def _located_name(kind: Kind, text: str, path: KeyPath, place: Place) -> str:
    choice = as_choice(text) if kind == "configs/faults" else None
    name = str(choice["name"]) if isinstance(choice, dict) else text
    place.require_own(path, name)
    file = find_input(kind, name, place.folder)
    is_bundled = file.parent == bundled_folder(kind)
    return text if is_bundled else f"{file.resolve()}{text[len(name) :]}"
