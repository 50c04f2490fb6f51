"""Any command of the command line, with random but plausible arguments among the paths of a tree.

What a command announces to write, and what it is given to read, is told by its arguments alone.
"""

from __future__ import annotations

import os
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from promise_inputs import SHORT
from promise_tree import OUT_NAMES, Tree

_FAULTS = ("laser_yaw:2", "lidar_late", "gyro_sign", "no_such_fault", "lidar_late:0.02")


@dataclass
class Command:
    """What is typed. Paths are relative to the working folder, as they are typed, or absolute.

    folder: where its results go; under_outputs: to a new folder there, as none was named.
    in_parts: a data set, which may stand there in parts. files: single files that it announces.
    read: what it is given to read. slow: it takes seconds even of tiny inputs.
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

    @property
    def typed(self) -> list[str]:
        return [*self.name.split(), *self.arguments]


class _Drawn:
    """A command on its way; each method adds an argument, or leaves it out."""

    def __init__(self, tree: Tree, name: str) -> None:
        self.tree, self.chance = tree, tree.chance
        self.command = Command(name, overwrite=self.chance.random() < 0.5)

    def some(self, kind: str) -> str:
        """A path of an input of this kind; now and then of another, of any file, or of nothing."""
        others = [*sum(self.tree.inputs.values(), []), *self.tree.made, "nothing", ".", "sub"]
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
        inputs = sum(self.tree.inputs.values(), [])
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
            spelled = f"../work/{path}"
        return f"./{spelled}" if spelled.startswith("-") else spelled


def _simulated(drawn: _Drawn, *more: str) -> None:
    """A world, driven through for a moment."""
    drawn.command.slow = True
    drawn.source("world", bundled="tiny")
    drawn.reads("--config", "config", 0.3)
    drawn.command.arguments += SHORT
    if drawn.chance.random() < 0.3 and (urdfs := drawn.tree.inputs["named"]):
        urdf = drawn.chance.choice([name for name in urdfs if name.endswith(".urdf")] or urdfs)
        drawn.command.read.append(urdf)
        drawn.command.arguments += ["--set", f"robot.urdf_file={urdf}"]
    drawn.maybe("--seed", "3", *more)
    drawn.out()


def _simulate(drawn: _Drawn) -> None:
    _simulated(drawn, "--fault", drawn.chance.choice(_FAULTS))


def _map_world(drawn: _Drawn) -> None:
    _simulated(drawn)


def _map(drawn: _Drawn) -> None:
    drawn.source("recording")
    drawn.reads("--relations", "relations", 0.3)
    drawn.reads("--continue", "run", 0.2)
    drawn.reads("--config", "config", 0.2)
    drawn.out()


def _localise(drawn: _Drawn) -> None:
    drawn.source("recording")
    drawn.reads("--in", "map", 0.95)
    drawn.maybe("--start", "0,0,0")
    drawn.out()


def _world(drawn: _Drawn) -> None:
    drawn.source("world", bundled="tiny")
    drawn.reads("--config", "config", 0.2)
    drawn.out(0.8)


def _config(drawn: _Drawn) -> None:
    drawn.source("world", bundled="tiny")
    drawn.reads("--config", "config", 0.5)


def _evaluate(drawn: _Drawn) -> None:
    drawn.source(drawn.chance.choice(("run", "path")))
    drawn.reads("--truth", "path", 0.5)
    drawn.reads("--relations", "relations", 0.3)


def _check(drawn: _Drawn) -> None:
    drawn.source("recording")
    drawn.maybe("--quick", probability=0.7)
    drawn.out_file("--html", 0.6)
    drawn.overwrite()


def _fix(drawn: _Drawn) -> None:
    drawn.source("recording")
    drawn.out_folder()
    drawn.maybe("--apply", drawn.chance.choice(("none", "all", "nonsense")), probability=0.8)
    drawn.maybe("--lossy")


def _fault(drawn: _Drawn) -> None:
    drawn.source("recording")
    drawn.out_folder()
    if drawn.chance.random() < 0.2:
        drawn.reads("--fault", "fault", 1.0)
    else:
        drawn.maybe("--fault", drawn.chance.choice(_FAULTS), probability=0.9)
    drawn.maybe("--lossy", probability=0.5)
    drawn.maybe("--list", probability=0.05)


def _recover(drawn: _Drawn) -> None:
    drawn.source("recording")
    drawn.out()


def _verify(drawn: _Drawn) -> None:
    drawn.source(drawn.chance.choice(("run", "set", "recording")))


def _view(drawn: _Drawn) -> None:
    drawn.source("run")
    drawn.out_file("--screenshot", 1.0)
    drawn.overwrite()


def _identify(drawn: _Drawn) -> None:
    drawn.source("measurements")
    drawn.out_file("--robot-file", 0.6)
    drawn.out()


def _scenario(drawn: _Drawn) -> None:
    drawn.command.slow = True
    drawn.command.arguments += ["integrator", "--set", "duration_s=0.5", "--jobs", "1"]
    drawn.reads("--config", "config", 0.3)
    drawn.out()


def _demo(drawn: _Drawn) -> None:
    """It takes a minute, but for what it refuses."""
    drawn.command.slow = True
    drawn.out(1.0)
    if drawn.command.folder is not None and drawn.chance.random() < 0.9:
        taken = drawn.chance.choice(["notes.txt", "sub", *drawn.tree.made])
        drawn.command.folder = drawn.command.arguments[1] = taken


def _bench(drawn: _Drawn) -> None:
    drawn.command.arguments.append("matcher")
    drawn.reads("--recording", "recording", 1.0)
    drawn.command.slow = True


def _plan(drawn: _Drawn) -> None:
    drawn.command.slow = True
    drawn.source("recipe")
    drawn.command.arguments += ["-n", "1", "--workers", "1"]


def _preview(drawn: _Drawn) -> None:
    drawn.source("recipe", bundled="tiny")
    drawn.command.arguments += ["-n", "1"]
    drawn.out_file("--out", 0.8)
    if not drawn.command.files:
        drawn.command.files += ["tiny.png", "mine.png"]
    drawn.overwrite()


def _make(drawn: _Drawn) -> None:
    drawn.command.slow = True
    drawn.source("recipe")
    drawn.command.arguments += ["-n", "1", "--workers", "1"]
    own = drawn.chance.random() < 0.3 and drawn.tree.inputs["set"]
    drawn.command.folder = drawn.spelled(drawn.chance.choice(own)) if own else drawn.target()
    drawn.command.arguments += ["--out", drawn.command.folder]
    drawn.command.in_parts, drawn.command.overwrite = True, False


def _set(drawn: _Drawn) -> None:
    drawn.source("set")


COMMANDS: Mapping[str, tuple[Callable[[_Drawn], None], float]] = {
    "check": (_check, 12),
    "fix": (_fix, 14),
    "fault": (_fault, 12),
    "recover": (_recover, 12),
    "verify": (_verify, 6),
    "evaluate": (_evaluate, 6),
    "world": (_world, 12),
    "config": (_config, 3),
    "view": (_view, 3),
    "map": (_map, 5),
    "localise": (_localise, 4),
    "identify": (_identify, 3),
    "dataset preview": (_preview, 5),
    "dataset verify": (_set, 3),
    "dataset stats": (_set, 3),
    "dataset plan": (_plan, 0.5),
    "dataset make": (_make, 2),
    "simulate": (_simulate, 3),
    "map world": (_map_world, 1),
    "scenario": (_scenario, 1),
    "demo": (_demo, 1),
    "bench": (_bench, 0.5),
}
"""Of each its share."""


def draw(tree: Tree) -> Command:
    """One of them."""
    chance: random.Random = tree.chance
    kinds = list(COMMANDS)
    (kind,) = chance.choices(kinds, [share for _, share in COMMANDS.values()])
    drawn = _Drawn(tree, kind.removesuffix(" world") if kind.startswith("map") else kind)
    COMMANDS[kind][0](drawn)
    if kind not in ("config", "view"):
        drawn.maybe("-q", probability=0.6)
    return drawn.command
