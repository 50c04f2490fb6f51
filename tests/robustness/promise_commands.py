"""Any command of the command line, with random but plausible arguments among the paths of a tree.

What a command announces to write, and what it is given to read, is told by its arguments alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from promise_arguments import Command, Drawn
from promise_inputs import SHORT
from promise_tree import Tree

_FAULTS = ("laser_yaw:2", "lidar_late", "gyro_sign", "no_such_fault", "lidar_late:0.02")


def _simulated(drawn: Drawn, *more: str) -> None:
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


def _simulate(drawn: Drawn) -> None:
    _simulated(drawn, "--fault", drawn.chance.choice(_FAULTS))


def _map_world(drawn: Drawn) -> None:
    _simulated(drawn)


def _map(drawn: Drawn) -> None:
    drawn.source("recording")
    drawn.command.arguments += SHORT  # it may be a world
    drawn.reads("--relations", "relations", 0.3)
    drawn.reads("--continue", "run", 0.2)
    drawn.reads("--config", "config", 0.2)
    drawn.out()


def _calibrate(drawn: Drawn) -> None:
    drawn.source("recording")
    drawn.maybe("--board", "chessboard:7x5:0.03", probability=0.7)
    drawn.maybe("--tags", "apriltag_36h11:0.16", probability=0.5)
    drawn.reads("--trajectory", "path", 0.2)
    drawn.out()


def _localise(drawn: Drawn) -> None:
    drawn.source("recording")
    drawn.reads("--in", "map", 0.95)
    drawn.maybe("--start", "0,0,0")
    drawn.out()


def _world(drawn: Drawn) -> None:
    drawn.source("world", bundled="tiny")
    drawn.reads("--config", "config", 0.2)
    drawn.out(0.8)


def _config(drawn: Drawn) -> None:
    drawn.source("world", bundled="tiny")
    drawn.reads("--config", "config", 0.5)


def _evaluate(drawn: Drawn) -> None:
    drawn.source(drawn.chance.choice(("run", "path")))
    drawn.reads("--truth", "path", 0.5)
    drawn.reads("--relations", "relations", 0.3)


def _check(drawn: Drawn) -> None:
    drawn.source("recording")
    drawn.maybe("--quick", probability=0.7)
    drawn.out_file("--html", 0.6)
    drawn.overwrite()


def _info(drawn: Drawn) -> None:
    drawn.source("recording")
    drawn.out_file("--out", 0.6)
    drawn.maybe("--odom-topic", "/nothing", probability=0.1)
    drawn.overwrite()


def _fix(drawn: Drawn) -> None:
    drawn.source("recording")
    drawn.out_folder()
    drawn.maybe("--apply", drawn.chance.choice(("none", "all", "nonsense")), probability=0.8)
    drawn.maybe("--lossy")


def _fault(drawn: Drawn) -> None:
    drawn.source("recording")
    drawn.out_folder()
    if drawn.chance.random() < 0.2:
        drawn.reads("--fault", "fault", 1.0)
    else:
        drawn.maybe("--fault", drawn.chance.choice(_FAULTS), probability=0.9)
    drawn.maybe("--lossy", probability=0.5)
    drawn.maybe("--list", probability=0.05)


def _recover(drawn: Drawn) -> None:
    drawn.source("recording")
    drawn.out()


def _verify(drawn: Drawn) -> None:
    drawn.source(drawn.chance.choice(("run", "set", "recording")))


def _view(drawn: Drawn) -> None:
    drawn.source("run")
    drawn.out_file("--screenshot", 1.0)
    drawn.overwrite()


def _identify(drawn: Drawn) -> None:
    drawn.command.slow = drawn.command.endless = True
    drawn.source("measurements")
    drawn.out_file("--robot-file", 0.6)
    drawn.out()


def _scenario(drawn: Drawn) -> None:
    drawn.command.slow = True
    drawn.command.arguments += ["integrator", "--set", "duration_s=0.5", "--jobs", "1"]
    drawn.reads("--config", "config", 0.3)
    drawn.out()


def _demo(drawn: Drawn) -> None:
    drawn.command.slow = drawn.command.endless = True
    drawn.out()


def _bench(drawn: Drawn) -> None:
    drawn.command.arguments.append("matcher")
    drawn.reads("--recording", "recording", 1.0)
    drawn.command.slow = True


def _plan(drawn: Drawn) -> None:
    drawn.command.slow = True
    drawn.source("recipe")
    drawn.command.arguments += ["-n", "1", "--workers", "1"]


def _preview(drawn: Drawn) -> None:
    drawn.source("recipe", bundled="tiny")
    drawn.command.arguments += ["-n", "1"]
    drawn.out_file("--out", 0.8)
    if not drawn.command.files:
        drawn.command.files += ["tiny.png", "mine.png"]
    drawn.overwrite()


def _make(drawn: Drawn) -> None:
    drawn.command.slow = True
    drawn.source("recipe")
    drawn.command.arguments += ["-n", "1", "--workers", "1"]
    own = drawn.chance.random() < 0.3 and drawn.tree.inputs["set"]
    drawn.command.folder = drawn.spelled(drawn.chance.choice(own)) if own else drawn.target()
    drawn.command.arguments += ["--out", drawn.command.folder]
    drawn.command.in_parts, drawn.command.overwrite = True, False


def _set(drawn: Drawn) -> None:
    drawn.source("set")


COMMANDS: Mapping[str, tuple[Callable[[Drawn], None], float]] = {
    "check": (_check, 12),
    "info": (_info, 8),
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
    "calibrate": (_calibrate, 3),
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
    chance = tree.chance
    kinds = list(COMMANDS)
    (kind,) = chance.choices(kinds, [share for _, share in COMMANDS.values()])
    drawn = Drawn(tree, kind.removesuffix(" world") if kind.startswith("map") else kind)
    COMMANDS[kind][0](drawn)
    if kind not in ("config", "view"):
        drawn.maybe("-q", probability=0.6)
    return drawn.command
