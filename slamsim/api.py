"""The package as it is used from Python: ``slamsim.map``, ``simulate``, ``check_recording``, ...

Each function does what the command of that name does, takes its options as keywords and
returns what the command wrote. The checker's function is ``check_recording``, because
``slamsim.check`` is the package with its questions: an attribute of that name would be the package
or the function, depending on what was imported before.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from slamsim.check.findings import CheckReport
from slamsim.cli import main as commands
from slamsim.cli import map_command
from slamsim.cli.common import selection
from slamsim.console.reporter import Reporter
from slamsim.opened_run import Run
from slamsim.slam.session import open_session

if TYPE_CHECKING:
    from os import PathLike

    from slamsim.dataset.store.reader import Dataset
    from slamsim.io.selection import Selection

__all__ = ["Run", "check_recording", "localise", "make_dataset", "map", "open_session", "simulate"]

Settings = Mapping[str, object]
"""Values of single settings by their dotted keys, as in ``{"drive.route.max_duration_s": 20}``."""


def map(  # noqa: A001 - named as the command
    source: str | PathLike[str] = "labyrinth",
    *,
    out: str | PathLike[str] | None = None,
    seed: int | None = None,
    drive_seed: int | None = None,
    settings: Settings | None = None,
    config: str | PathLike[str] | None = None,
    relations: str | PathLike[str] | None = None,
    scan_topic: str | Iterable[str] = (),
    odom_topic: str = "",
    imu_topic: str = "",
    base_frame: str = "",
    cloud_height: tuple[float, float] | None = None,
    continued: str | PathLike[str] | None = None,
    start: str | None = None,
    overwrite: bool = False,
    quiet: bool = False,
) -> Run:
    """Map a recording, or a world that is simulated first, and evaluate the map.

    source: path of a recording or a world, or the bundled name of a world. out: folder of the run;
    a new one under ``outputs/`` by default. drive_seed: another drive through the world of
    ``seed``. settings: values by dotted key, as ``--set``; config: a YAML file of them. continued:
    run whose map is continued (``--continue``), from the pose start "x,y,yaw_deg". scan_topic,
    odom_topic, imu_topic, base_frame: what is read of a recording that holds several of a kind.
    cloud_height: lowest and highest return of point clouds above the base frame, in metres.
    quiet: no progress, no table. Raises SlamsimError as the command ends with an exit code.
    """
    wanted = _wanted(scan_topic, odom_topic, imu_topic, base_frame, cloud_height)
    return Run(
        map_command.map_(
            Reporter(quiet=quiet),
            str(source),
            out=_path(out),
            seed=seed,
            drive_seed=drive_seed,
            set_=_overrides(settings),
            config=None if config is None else str(config),
            relations=_path(relations),
            wanted=wanted,
            earlier=_path(continued),
            start=start,
            overwrite=overwrite,
        )
    )


def localise(
    source: str | PathLike[str],
    known: str | PathLike[str],
    *,
    start: str | None = None,
    out: str | PathLike[str] | None = None,
    settings: Settings | None = None,
    config: str | PathLike[str] | None = None,
    scan_topic: str | Iterable[str] = (),
    odom_topic: str = "",
    imu_topic: str = "",
    base_frame: str = "",
    cloud_height: tuple[float, float] | None = None,
    overwrite: bool = False,
    quiet: bool = False,
) -> Run:
    """Localise a recording in a finished map.

    known: the folder of a mapped run, or a ROS map.yaml (``--in``). Other options and errors as
    those of ``map``.
    """
    wanted = _wanted(scan_topic, odom_topic, imu_topic, base_frame, cloud_height)
    return Run(
        map_command.localise(
            Reporter(quiet=quiet),
            Path(source),
            Path(known),
            start=start,
            out=_path(out),
            set_=_overrides(settings),
            config=None if config is None else str(config),
            wanted=wanted,
            overwrite=overwrite,
        )
    )


def simulate(
    world: str | PathLike[str] = "labyrinth",
    *,
    out: str | PathLike[str] | None = None,
    seed: int | None = None,
    drive_seed: int | None = None,
    settings: Settings | None = None,
    config: str | PathLike[str] | None = None,
    faults: Iterable[str] = (),
    overwrite: bool = False,
    quiet: bool = False,
) -> Run:
    """Drive through a world and record what the sensors measure, with the ground truth.

    faults: names, each with its size behind a colon if wanted: ``["lidar_late:0.02"]``. Other
    options and errors as those of ``map``.
    """
    return Run(
        commands.simulate(
            Reporter(quiet=quiet),
            str(world),
            out=_path(out),
            seed=seed,
            drive_seed=drive_seed,
            set_=_overrides(settings),
            config=None if config is None else str(config),
            faults=list(faults),
            overwrite=overwrite,
        )
    )


def check_recording(
    source: str | PathLike[str],
    *,
    scan_topic: str | Iterable[str] = (),
    odom_topic: str = "",
    imu_topic: str = "",
    base_frame: str = "",
    cloud_height: tuple[float, float] | None = None,
    quick: bool = False,
    quiet: bool = False,
) -> CheckReport:
    """Ask all questions of ``slamsim check`` about a recording; ``report.faults`` are its faults.

    quick: leave out the questions that compare scans with one another. Raises NotFound,
    InputRefused and OverrideRefused; a fault is no error.
    """
    from slamsim.run.checking import check_log

    wanted = _wanted(scan_topic, odom_topic, imu_topic, base_frame, cloud_height)
    return check_log(Path(source), Reporter(quiet=quiet), wanted=wanted, quick=quick)


def make_dataset(
    recipe: str | PathLike[str],
    count: int,
    out: str | PathLike[str],
    *,
    workers: int | None = None,
    quiet: bool = False,
) -> Dataset:
    """Make the first ``count`` sequences of a recipe, or those that are missing, and open the set.

    recipe: path or bundled name. out: a folder or a URL. workers: processes, all cores by default.
    They import the script that calls this, which therefore needs ``if __name__ == "__main__":``.
    Raises SlamsimError if a sequence could not be made.
    """
    from slamsim.dataset import open as open_dataset
    from slamsim.run.dataset.making import run_make

    run_make(str(recipe), count, str(out), Reporter(quiet=quiet), workers=workers)
    return open_dataset(str(out))


def _path(given: str | PathLike[str] | None) -> Path | None:
    return None if given is None else Path(given)


def _overrides(settings: Settings | None) -> list[str]:
    """As ``--set`` takes them: a value is YAML, of which JSON is a part."""
    return [f"{key}={json.dumps(value)}" for key, value in (settings or {}).items()]


def _wanted(
    scan_topic: str | Iterable[str],
    odom_topic: str,
    imu_topic: str,
    base_frame: str,
    cloud_height: tuple[float, float] | None,
) -> Selection:
    topics = [scan_topic] if isinstance(scan_topic, str) else list(scan_topic)
    heights = "" if cloud_height is None else f"{cloud_height[0]},{cloud_height[1]}"
    return selection(topics, odom_topic, imu_topic, base_frame, heights)
