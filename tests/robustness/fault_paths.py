"""A scene for files that point out of their folder, and who watches what is opened there.

``python fault_paths.py FOLDER`` acts out every attempt of ``fault_path_list`` in a scene
of its own below FOLDER and prints a line of JSON for each: what was opened, written and told.
"""

from __future__ import annotations

import ctypes
import json
import os
import struct
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import support_path  # noqa: F401

Action = Callable[[], object]
Attempt = Callable[["Scene"], Action]

ATTEMPTS: dict[str, Attempt] = {}
"""By what each of them tries, in words."""

_OPENED = 0x20 | 0x01 | 0x02 | 0x100 | 0x40 | 0x80 | 0x200  # also read, changed, made, moved, gone
_FILE_EVENTS = frozenset(("open", "os.listdir", "os.scandir", "os.rename", "os.remove", "os.mkdir"))


def written(path: Path, text: str) -> str:
    """The path of a file that holds this text now."""
    path.write_text(text)
    return str(path)


@dataclass(frozen=True, slots=True)
class Scene:
    """Folders side by side: what came from somebody, what is none of their business, ours.

    inputs: theirs, hostile. outside: must be neither read nor written because of them. out:
    where results may go.
    """

    root: Path

    @property
    def inputs(self) -> Path:
        return self.root / "inputs"

    @property
    def outside(self) -> Path:
        return self.root / "outside"

    @property
    def out(self) -> Path:
        return self.root / "out"

    @classmethod
    def made(cls, root: Path) -> Scene:
        scene = cls(root)
        for folder in (scene.inputs, scene.outside, scene.out, root / "cwd"):
            folder.mkdir(parents=True)
        return scene


@dataclass(slots=True)
class Told:
    """What came of an attempt.

    crossed: what happened outside, as the kernel saw it. opened: every place that Python opened.
    changed: what is not as it was among inputs and outside. error: type and words, if any.
    """

    attempt: str
    crossed: list[str] = field(default_factory=list)
    opened: list[str] = field(default_factory=list)
    changed: list[str] = field(default_factory=list)
    error: str = ""
    words: str = ""


def attempt(words: str) -> Callable[[Attempt], Attempt]:
    """Put an attempt on the list."""

    def put(made: Attempt) -> Attempt:
        assert words not in ATTEMPTS, words
        ATTEMPTS[words] = made
        return made

    return put


Reference = Callable[[Scene, str], str]
"""How a file of inputs names one of outside."""
WayAttempt = Callable[[Scene, Reference], Action]


def relative(scene: Scene, name: str) -> str:
    return f"../outside/{name}"


def absolute(scene: Scene, name: str) -> str:
    return str(scene.outside / name)


def winding(scene: Scene, name: str) -> str:
    (scene.inputs / "maps").mkdir(exist_ok=True)
    return f"maps/.././../outside/{name}"


def linked(scene: Scene, name: str) -> str:
    link = scene.inputs / f"link-{name}"
    link.symlink_to(scene.outside / name)
    return link.name


def linked_folder(scene: Scene, name: str) -> str:
    (scene.inputs / "here").symlink_to(scene.outside, target_is_directory=True)
    return f"here/{name}"


def as_url(scene: Scene, name: str) -> str:
    return f"file://{scene.outside / name}"


WAYS: dict[str, Reference] = {
    "relative": relative,
    "absolute": absolute,
    "winding": winding,
    "link": linked,
    "linked folder": linked_folder,
    "URL": as_url,
}


def _the_other_way_round(made: WayAttempt, way: Reference, scene: Scene) -> Action:
    return made(scene, way)


def ways(words: str, *names: str) -> Callable[[WayAttempt], None]:
    """One attempt for each of these ways."""

    def put(made: WayAttempt) -> None:
        for name in names:
            attempt(f"{words}: {name}")(partial(_the_other_way_round, made, WAYS[name]))

    return put


def acted(words: str, root: Path) -> Told:
    """Set the scene, act, and tell."""
    from slamsim.guard.errors import SlamsimError

    scene = Scene.made(root)
    action = ATTEMPTS[words](scene)
    told, before = Told(words), _tree(scene)
    os.chdir(root / "cwd")
    with _watched(scene.outside, told), _listening(told):
        try:
            action()
        except SlamsimError as error:
            told.error, told.words = type(error).__name__, str(error)
        except Exception as error:
            told.error, told.words = f"odd {type(error).__name__}", str(error)
    after = _tree(scene)
    told.changed = sorted(path for path in {*before, *after} if before.get(path) != after.get(path))
    return told


def _tree(scene: Scene) -> dict[str, bytes]:
    """Every file, link and folder of inputs and outside, with its contents."""
    found: dict[str, bytes] = {}
    for top in (scene.inputs, scene.outside):
        for path in sorted(top.rglob("*")):
            name = str(path.relative_to(scene.root))
            if path.is_symlink():
                found[name] = os.fsencode(path.readlink())
            else:
                found[name] = path.read_bytes() if path.is_file() else b""
    return found


@contextmanager
def _watched(folder: Path, told: Told) -> Iterator[None]:
    """inotify sees what native libraries open, too. Linux only."""
    libc = ctypes.CDLL(None, use_errno=True)
    descriptor = libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
    names = {}
    for each in (folder, *(path for path in folder.rglob("*") if path.is_dir())):
        number = libc.inotify_add_watch(descriptor, os.fsencode(each), _OPENED)
        assert number >= 0, os.strerror(ctypes.get_errno())
        names[number] = each
    try:
        yield
        told.crossed = [str(names[number] / name) for number, name in _events(descriptor)]
    finally:
        os.close(descriptor)


def _events(descriptor: int) -> Iterator[tuple[int, str]]:
    while True:
        try:
            data = os.read(descriptor, 1 << 16)
        except BlockingIOError:
            return
        at = 0
        while at < len(data):
            number, _, _, length = struct.unpack_from("iIII", data, at)
            at += 16 + length
            yield number, data[at - length : at].rstrip(b"\0").decode()


_ears: list[Told] = []


def _hear(event: str, arguments: tuple[Any, ...]) -> None:
    if _ears and event in _FILE_EVENTS and isinstance(arguments[0], str | bytes | os.PathLike):
        _ears[-1].opened.append(os.path.realpath(os.fsdecode(arguments[0])))


@contextmanager
def _listening(told: Told) -> Iterator[None]:
    _ears.append(told)
    try:
        yield
    finally:
        _ears.pop()
        told.opened = sorted(set(told.opened))


def main(folder: Path) -> None:
    import fault_path_list  # noqa: F401  fills the list of attempts

    sys.addaudithook(_hear)
    for number, words in enumerate(ATTEMPTS):
        told = acted(words, folder / f"{number:02d}")
        sys.stdout.write(json.dumps({name: getattr(told, name) for name in Told.__slots__}) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    # As a module of its name, or the attempts would land on a list of their own.
    import fault_paths

    fault_paths.main(Path(sys.argv[1]).resolve())
