"""Attempts to have results written where nobody wanted them."""

from __future__ import annotations

import re
from pathlib import Path

from fault_paths import Action, Scene, attempt

from slamsim.config.measurements import MeasurementsConfig
from slamsim.guard.lock import lock_of, owner_words
from slamsim.guard.output import partial_file, partial_folder, write_atomic
from slamsim.guard.staging import MARKER, NEW, OLD
from slamsim.run.naming import OUTPUTS, output_folder


def _write(final: Path) -> None:
    with partial_folder(final) as folder:
        (folder / "a").write_text("a")


def _left_behind(final: Path) -> Path:
    """A lock file as a killed process leaves it; the staging folder that it names."""
    staging = final.with_name(f".{final.name}.slamsim-{'0' * 16}")
    lock_of(final).write_bytes(owner_words("lock", final.name, staging))
    return staging


@attempt("a link under the name of the lock")
def _(scene: Scene) -> Action:
    (scene.outside / "notes").write_text("mine\n")
    lock_of(scene.out / "run").symlink_to(scene.outside / "notes")
    return lambda: _write(scene.out / "run")


@attempt("a dangling link under the name of the lock")
def _(scene: Scene) -> Action:
    lock_of(scene.out / "run").symlink_to(scene.outside / "new")
    return lambda: _write(scene.out / "run")


@attempt("a link under the name of what is not finished")
def _(scene: Scene) -> Action:
    (scene.outside / MARKER).write_text("")
    _left_behind(scene.out / "run").symlink_to(scene.outside, target_is_directory=True)
    return lambda: _write(scene.out / "run")


@attempt("a link under the name of what was retired")
def _(scene: Scene) -> Action:
    (scene.outside / ".slamsim").write_text("")
    staging = _left_behind(scene.out / "run")
    staging.mkdir()
    (staging / MARKER).write_text("")
    (staging / OLD).symlink_to(scene.outside, target_is_directory=True)
    return lambda: _write(scene.out / "run")


@attempt("a lock that names a staging folder elsewhere")
def _(scene: Scene) -> Action:
    (scene.outside / MARKER).write_text("")
    lock = lock_of(scene.out / "run")
    words = owner_words("lock", "run", Path("x")).decode()
    lock.write_text(words.replace('"x"', '"../outside"'))
    return lambda: _write(scene.out / "run")


@attempt("an output folder that is a link, to be overwritten")
def _(scene: Scene) -> Action:
    (scene.outside / ".slamsim").write_text("")
    (scene.out / "run").symlink_to(scene.outside, target_is_directory=True)

    def act() -> None:
        with partial_folder(scene.out / "run", overwrite=True) as folder:
            (folder / "a").write_text("a")

    return act


@attempt("an output folder that holds links, to be overwritten")
def _(scene: Scene) -> Action:
    (scene.outside / "notes").write_text("mine\n")
    run = scene.out / "run"
    run.mkdir()
    (run / ".slamsim").write_text("")
    (run / "log").symlink_to(scene.outside, target_is_directory=True)
    (run / "map.yaml").symlink_to(scene.outside / "notes")

    def act() -> None:
        with partial_folder(run, overwrite=True) as folder:
            (folder / "map.yaml").write_text("a")

    return act


@attempt("an output file that is a link")
def _(scene: Scene) -> Action:
    (scene.outside / "notes").write_text("mine\n")
    (scene.out / "page.html").symlink_to(scene.outside / "notes")

    def act() -> None:
        with partial_file(scene.out / "page.html", overwrite=True) as unfinished:
            unfinished.write_text("new")

    return act


@attempt("a file in our folders that is a link")
def _(scene: Scene) -> Action:
    (scene.outside / "notes").write_text("mine\n")
    (scene.out / "page.html").symlink_to(scene.outside / "notes")
    return lambda: write_atomic(scene.out / "page.html", b"new")


@attempt("a link under the name of an unfinished output file")
def _(scene: Scene) -> Action:
    (scene.outside / "notes").write_text("mine\n")
    (staging := _left_behind(scene.out / "page.html")).mkdir()
    (staging / MARKER).write_text("")
    (staging / NEW).symlink_to(scene.outside / "notes")

    def act() -> None:
        with partial_file(scene.out / "page.html") as unfinished:
            unfinished.write_text("new")

    return act


@attempt("the name of a world that is a path")
def _(scene: Scene) -> Action:
    def act() -> None:
        for name in ("../../outside/x", str(scene.outside / "x"), "..", "a/../../x", "\0", "~/x"):
            with output_folder(None, name, overwrite=True) as folder:
                assert folder.parent == OUTPUTS
                assert re.fullmatch(r"[\w.-]+", folder.name) and folder.name not in (".", "..")

    return act


@attempt("the name of an identified robot that is a path")
def _(scene: Scene) -> Action:
    from slamsim.config.loading import load_model

    path = scene.inputs / "m.yaml"
    figure = "{quantity: umbmark.e_max_m, value: 0.1, sigma: 0.1, source: x}"
    path.write_text(f"name: ../../outside/x\nfigures: [{figure}]\n")
    return lambda: load_model(MeasurementsConfig, path)
