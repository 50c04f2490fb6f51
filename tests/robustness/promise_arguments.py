"""A command of the command line on its way: arguments are added among the paths of a tree."""

from __future__ import annotations

import os
from dataclasses import dataclass, field

from promise_tree import OUT_NAMES, Tree


@dataclass
class Command:
    """What is typed. Paths are relative to the working folder, as they are typed, or absolute.

    folder: where its results go; under_outputs: to a new folder there, as none was named.
    in_parts: a data set, which may stand there in parts. files: single files that it announces.
    read: what it is given to read. slow: it takes seconds even of tiny inputs;
    endless: minutes, and is only begun.
    """

    name: str
    arguments: list[str] = field(default_factory=list)
    folder: str | None = None
    under_outputs: bool = False
    in_parts: bool = False
    files: list[str] = field(default_factory=list)
    read: list[str] = field(default_factory=list)
    overwrite: bool = False
    slow: bool = False
    endless: bool = False

    @property
    def typed(self) -> list[str]:
        return [*self.name.split(), *self.arguments]


class Drawn:
    """A command on its way; each method adds an argument, or leaves it out."""

    def __init__(self, tree: Tree, name: str) -> None:
        self.tree, self.chance = tree, tree.chance
        self.command = Command(name, overwrite=self.chance.random() < 0.5)

    def some(self, kind: str) -> str:
        """A path of an input of this kind; now and then of another, of any file, or of nothing."""
        others = [*self.tree.all_inputs, *self.tree.made, "nothing", ".", "sub"]
        if self.chance.random() < 0.85:
            others = self.tree.inputs[kind] or others
        return self.spelled(self.chance.choice(others))

    def source(self, kind: str, *, bundled: str = "") -> None:
        """A positional argument that is read."""
        if bundled and self.chance.random() < 0.3:
            self.command.arguments.append(bundled)
            return
        path = self.some(kind)
        self.command.read.append(path)
        self.command.arguments.append(path)

    def reads(self, option: str, kind: str, probability: float) -> None:
        if self.chance.random() < probability:
            path = self.some(kind)
            self.command.read.append(path)
            self.command.arguments += [option, path]

    def target(self) -> str:
        """A name for an output: new, taken by a user's file, or an input's."""
        drawn = self.chance.random()
        if drawn < 0.55 or not self.tree.made:
            return self.spelled(self.chance.choice(OUT_NAMES))
        if drawn < 0.75:
            return self.spelled(self.chance.choice(self.tree.made))
        inputs = self.tree.all_inputs
        near = self.chance.choice([*inputs, *self.command.read])
        inner = self.chance.choice(("", "", "/log", "/new", "/.."))
        return self.spelled(f"{near}{inner}")

    def out(self, probability: float = 0.75) -> None:
        """The option ``--out`` for a folder."""
        if self.chance.random() < probability:
            self.command.folder = self.target()
            self.command.arguments += ["--out", self.command.folder]
        else:
            self.command.under_outputs = True
        self.overwrite()

    def out_folder(self) -> None:
        """A positional argument."""
        self.command.folder = self.target()
        self.command.arguments.append(self.command.folder)
        self.overwrite()

    def out_file(self, option: str, probability: float) -> None:
        if self.chance.random() < probability:
            self.command.files.append(self.target())
            self.command.arguments += [option, self.command.files[-1]]

    def overwrite(self) -> None:
        if self.command.overwrite:
            self.command.arguments.append("--overwrite")

    def maybe(self, *arguments: str, probability: float = 0.3) -> None:
        if self.chance.random() < probability:
            self.command.arguments += arguments

    def spelled(self, path: str) -> str:
        """The same place, spelled in some way; in other case only where that is another place."""
        work, drawn = self.tree.work, self.chance.random()
        if drawn < 0.6:
            spelled = path
        elif drawn < 0.7:
            spelled = str(work / path)
        elif drawn < 0.75:
            spelled = f"sub/../{path}"
        elif drawn < 0.8 and path.startswith("sub/"):
            spelled = f"to_{path}"
        elif drawn < 0.85:
            spelled = os.path.relpath(os.path.realpath(work / path), os.path.realpath(work))
        elif drawn < 0.9:
            spelled = f"{path}/"
        elif drawn < 0.93:
            spelled = path.swapcase()
        else:
            spelled = f"../{work.name}/{path}"
        return f"./{spelled}" if spelled.startswith("-") else spelled
