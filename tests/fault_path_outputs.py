"""Attempts to have results written where nobody wanted them."""

from __future__ import annotations

import re

from fault_paths import Action, Scene, attempt

from slamsim.config.measurements import MeasurementsConfig
from slamsim.run.naming import OUTPUTS, output_folder
from slamsim.safe.output import partial_folder, write_atomic


@attempt("a link under the name of the lock")
def _(scene: Scene) -> Action:
    (scene.outside / "notes").write_text("mine\n")
    (scene.out / "run.lock").symlink_to(scene.outside / "notes")

    def act() -> None:
        with partial_folder(scene.out / "run"):
            pass

    return act


@attempt("a dangling link under the name of the lock")
def _(scene: Scene) -> Action:
    (scene.out / "run.lock").symlink_to(scene.outside / "new")

    def act() -> None:
        with partial_folder(scene.out / "run"):
            pass

    return act


@attempt("a link under the name of what is not finished")
def _(scene: Scene) -> Action:
    (scene.out / "run.partial").symlink_to(scene.outside, target_is_directory=True)

    def act() -> None:
        with partial_folder(scene.out / "run") as folder:
            (folder / "a").write_text("a")

    return act


@attempt("a link under the name of what was retired")
def _(scene: Scene) -> Action:
    (scene.outside / ".slamsim").write_text("")
    (scene.out / "run.old").symlink_to(scene.outside, target_is_directory=True)

    def act() -> None:
        with partial_folder(scene.out / "run") as folder:
            (folder / "a").write_text("a")

    return act


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
    return lambda: write_atomic(scene.out / "page.html", b"new")


@attempt("a link under the name of an unfinished output file")
def _(scene: Scene) -> Action:
    (scene.outside / "notes").write_text("mine\n")
    (scene.out / ".page.html.partial").symlink_to(scene.outside / "notes")
    return lambda: write_atomic(scene.out / "page.html", b"new")


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
