"""A random tree of user files around and inside a working folder, from a seed."""

from __future__ import annotations

import os
import random
import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from promise_inputs import KINDS

OUT_NAMES = (
    *(
        "lab",
        "poetry",
        "out",
        "lab.old",
        "my lab",
        "\u00fcn\u00efcode \u2603",
        "a.b.c",
        "deep/er/out",
    ),
    *("-dash", "x" * 120, "new\nline", "page.html", "map.png", "robot_new.yaml", ".hidden"),
    *("outputs/tiny", "outputs/foreign", "sub/out", "to_outside/out", "../outside/out"),
)
_ODD = (*OUT_NAMES[:12], "notes.txt", "poetry.lock", "tiny.png", "SHA256SUMS", "mine.png")
_SUFFIXES = (
    *(".lock", ".partial", ".old", ".tmp", "~", ".bak"),
    *(".slamsim-lock", ".slamsim-0123456789abcdef"),
)


@dataclass
class Tree:
    """work: the working folder, beside it in root: outside, home, tmp.

    inputs: for each kind of ``KINDS``, paths of such; relative to work, as are all others.
    """

    root: Path
    chance: random.Random
    inputs: dict[str, list[str]] = field(default_factory=dict)
    made: list[str] = field(default_factory=list)

    @property
    def work(self) -> Path:
        return self.root / "work"

    @property
    def all_inputs(self) -> list[str]:
        return [path for paths in self.inputs.values() for path in paths]


def build(root: Path, masters: Path, chance: random.Random) -> Tree:
    """In a folder that is empty."""
    tree = Tree(root, chance)
    for name in ("work/sub/a", "work/outputs", "outside/theirs", "home/.config", "tmp"):
        (root / name).mkdir(parents=True)
    (root / "home" / ".config" / "mine").write_text("set\n")
    (root / "outside" / "theirs" / "notes.txt").write_text("outside\n")
    (tree.work / "notes.txt").write_text("inside\n")
    (tree.work / "to_outside").symlink_to("../outside")
    (tree.work / "to_sub").symlink_to("sub")
    _place_inputs(tree, masters)
    for _ in range(chance.randint(4, 16)):
        with suppress(OSError):  # two of one name, or a name that is too long
            chance.choice(_USER_FILES)(tree)
    return tree


def _place_inputs(tree: Tree, masters: Path) -> None:
    """Some of each kind, somewhere; what names others beside it has them there."""
    chance = tree.chance
    there = sorted(path.name for path in masters.iterdir())
    place = chance.choice(("", "", "sub/", "../outside/"))
    for name in KINDS["named"]:
        _copy(masters / name, tree.work / place / name)
    for kind, names in KINDS.items():
        found = tree.inputs.setdefault(kind, [])
        known = [name for name in names if name in there]
        for name in chance.sample(known, min(len(known), chance.randint(1, 3))):
            keeps = place if kind in ("config", "world", "map", "named") else ""
            folder = keeps or chance.choice(("", "", "", "sub/", "../outside/", "outputs/"))
            called = name
            if kind in ("recording", "run", "set") and chance.random() < 0.2:
                called = f"{chance.choice(('my ', '-', 'x.', 'é'))}{name}"
            path = f"{folder}{called}"
            if not os.path.lexists(tree.work / path):
                _copy(masters / name, tree.work / path)
            if path not in found:
                found.append(path)


def _copy(source: Path, final: Path) -> None:
    if source.is_dir():
        shutil.copytree(source, final, symlinks=True)
    else:
        shutil.copyfile(source, final)


def _some_input(tree: Tree) -> Path:
    return tree.work / tree.chance.choice(tree.all_inputs)


def _some_name(tree: Tree) -> Path:
    place = tree.chance.choice(("", "", "", "sub", "outputs", "../outside"))
    return tree.work / place / tree.chance.choice(_ODD)


def _beside(tree: Tree) -> Path:
    """A name that a careless program would take for itself, beside an output or an input."""
    chance = tree.chance
    near = tree.work / chance.choice(OUT_NAMES) if chance.random() < 0.6 else _some_input(tree)
    dot = chance.choice(("", "", "."))
    return near.with_name(f"{dot}{near.name}{chance.choice(_SUFFIXES)}")


def _write(tree: Tree, path: Path, text: str = "") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("x") as file:
        file.write(text or f"mine {tree.chance.random()}\n")
    path.chmod(tree.chance.choice((0o644, 0o644, 0o600, 0o444)))
    tree.made.append(os.path.relpath(path, tree.work))
    return path


def _note(tree: Tree) -> None:
    _write(tree, _some_name(tree))


def _sibling(tree: Tree) -> None:
    _write(tree, _beside(tree))


def _sibling_folder(tree: Tree) -> None:
    _write(tree, _beside(tree) / tree.chance.choice(("kept.txt", "new/kept.txt", "old/kept.txt")))


def _empty_folder(tree: Tree) -> None:
    (folder := _some_name(tree)).mkdir()
    tree.made.append(os.path.relpath(folder, tree.work))


def _like_a_set(tree: Tree) -> None:
    """It looks like what an older version left of a data set, and is not."""
    folder = _some_name(tree)
    _write(tree, folder / ".partial" / "kept.txt")
    _write(tree, folder / "logs" / "00000.log")


def _note_inside(tree: Tree) -> None:
    """In a folder that slamsim wrote."""
    runs = [*tree.inputs["run"], *tree.inputs["set"]]
    inner = tree.chance.choice(("notes.txt", "sub/notes.txt", "log/mine.txt", "logs/mine.log"))
    _write(tree, tree.work / tree.chance.choice(runs) / inner)


def _link(tree: Tree) -> None:
    """To a file, a folder, an input, outside, nothing, or itself."""
    chance, path = tree.chance, _some_name(tree)
    targets = (
        *("notes.txt", "sub", "../outside/theirs", "../outside/theirs/notes.txt", "nothing"),
        *(path.name, "../outside/not_there/yet", str(_some_input(tree))),
    )
    path.symlink_to(chance.choice(targets))
    tree.made.append(os.path.relpath(path, tree.work))


def _input_link(tree: Tree) -> None:
    """A second name of an input, by which it is given to a command."""
    kind = tree.chance.choice(("recording", "run", "set", "world"))
    target = tree.chance.choice(tree.inputs[kind])
    path = tree.work / f"link_{tree.chance.randint(0, 9)}{Path(target).suffix}"
    path.symlink_to(tree.work / target)
    tree.inputs[kind].append(path.name)


def _hard_link(tree: Tree) -> None:
    source = _some_input(tree)
    if source.is_file():
        path = _some_name(tree)
        os.link(source, path)
        tree.made.append(os.path.relpath(path, tree.work))


def _pipe(tree: Tree) -> None:
    os.mkfifo(path := _some_name(tree))
    tree.made.append(os.path.relpath(path, tree.work))


def _earlier_page(tree: Tree) -> None:
    """A file that the user lets be overwritten."""
    name = tree.chance.choice(("page.html", "map.png", "robot_new.yaml", "tiny.png"))
    _write(tree, tree.work / name, "earlier\n")


_USER_FILES: tuple[Callable[[Tree], None], ...] = (
    *(_note, _sibling, _sibling, _sibling_folder, _sibling_folder, _empty_folder, _like_a_set),
    *(_note_inside, _link, _link, _input_link, _hard_link, _pipe, _earlier_page),
)
