"""``slamsim bench``: the parts and their options."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Self, cast

import typer

from slamsim.bench.parts import require_used
from slamsim.console.options import ConfigFile, Json, Quiet, Set

if TYPE_CHECKING:
    from slamsim.config.run import RunConfig
    from slamsim.console.reporter import Reporter

SPEED_SECONDS = 120.0
STANDARD = "labyrinth_10hz"
"""The setting of the accuracy bench when neither a world nor a configuration is named."""

STANDARD_RECIPE = "labyrinths"

FIRST_SEED = 1
ONLINE_PATH_M = 10000.0
"""Long enough for memory and latency to show whether they grow."""
ONLINE_RATE = "sensors.lidar.rate_hz=10"


@dataclass(frozen=True, slots=True)
class _Asked:
    """What the command line asks for."""

    world: str | None
    config: str | None
    overrides: tuple[str, ...]
    seed: int | None
    seconds: float | None
    path_m: float | None
    reporter: Reporter

    def resolved(self, world: str, *standing: str) -> RunConfig:
        """The configuration, in this world if none was named; standing: overrides before all."""
        from slamsim.config.loading import load_run_config

        named = self.world if self.world or self.config else world
        return load_run_config(named, self.config, [*standing, *self.overrides], self.seed)

    def resolved_until_end(self, seconds: float | None = None) -> RunConfig:
        """That of the labyrinth, its drive limited as asked; without limits, to ``seconds``."""
        limits = []
        if self.path_m is not None:
            limits.append(f"drive.route.max_path_length_m={float(self.path_m)}")
        ends = self.path_m is not None or self.config is not None
        wanted_s = self.seconds if self.seconds is not None or ends else seconds
        if wanted_s is not None:
            limits.append(f"drive.route.max_duration_s={float(wanted_s)}")
        return self.resolved("labyrinth", *limits)

    def or_standard(self) -> Self:
        """With the standard setting if neither a world nor a configuration was named."""
        return self if self.world or self.config else replace(self, config=STANDARD)


def _given(context: typer.Context) -> list[str]:
    """The first name of each option that was typed."""
    names = []
    for parameter in context.command.params:
        source = context.get_parameter_source(parameter.name or "")
        if source is not None and source.name == "COMMANDLINE":
            names.append(parameter.opts[0])
    return [name for name in names if name.startswith("--")]


Part = Annotated[
    str,
    typer.Argument(
        help="sense, drive, simulate, slam, all: speed. Or accuracy, matcher, check, dataset; "
        "robustness: random conditions, tracked, told or silently wrong; "
        "online: latency and memory of a session, told for each kilometre; "
        "live: pace, latency and accuracy of slamsim live; "
        "cameras: speed of rendering, exactness of flow."
    ),
]
World = Annotated[
    str | None,
    typer.Option(help=f"World to measure in: labyrinth; accuracy: the preset {STANDARD}."),
]
Seconds = Annotated[
    float | None, typer.Option(help=f"Simulated time; speed: {SPEED_SECONDS:g} s.", min=5)
]
BenchPath = Annotated[
    float | None,
    typer.Option(help=f"End the drive after so many metres; online: {ONLINE_PATH_M:g}.", min=1),
]
Repeats = Annotated[int, typer.Option(help="Speed: repetitions, of which the best counts.", min=1)]
Peers = Annotated[
    bool, typer.Option("--peers", help="slam: beside other scan matchers, on one log.")
]
Seeds = Annotated[
    int, typer.Option(help="Accuracy, check: number of seeds; dataset: of sequences.", min=1)
]
Seed = Annotated[
    int | None, typer.Option(help="The seed; accuracy: the first, by default 1.", min=0)
]
Only = Annotated[int | None, typer.Option(help="Robustness: only the case of this number.", min=1)]
Workers = Annotated[
    int, typer.Option(help="Accuracy, check, robustness: runs at a time.", min=1, max=64)
]
Recording = Annotated[
    Path | None,
    typer.Option(help="Matcher, check: on this recording, not simulated."),
]
Bound = Annotated[bool, typer.Option(help="Accuracy: compare with the least possible error.")]
Logs = Annotated[
    Path | None,
    typer.Option(
        metavar="FOLDER",
        help="Keep simulated logs here, and use them again; robustness: results as they come.",
    ),
]
Faults = Annotated[str | None, typer.Option(help="Check: only these faults, as name,name:size,...")]
Clean = Annotated[int, typer.Option(help="Check: number of further drives without a fault.", min=0)]
Curves = Annotated[bool, typer.Option("--curves", help="Check: every size of every fault too.")]
Independent = Annotated[
    bool,
    typer.Option(
        "--independent",
        help="Check: recordings of the generator in tests/independent, not of slamsim.",
    ),
]
Mutations = Annotated[
    int, typer.Option(help="Check --independent: random changes of messages a seed.", min=0)
]
Fix = Annotated[
    bool, typer.Option("--fix", help="Check --independent: repair each recording, too.")
]
OfCameras = Annotated[
    bool, typer.Option("--cameras", help="Check: faults of cameras, on drives with small images.")
]
Long = Annotated[
    bool, typer.Option("--long", help="Check: time ten minutes at 40 scans a second too.")
]

Cases = Annotated[int, typer.Option(help="Robustness: number of cases.", min=1)]
Pairs = Annotated[int, typer.Option(help="Check: random pairs of faults a drive.", min=0)]


def bench(
    context: typer.Context,
    part: Part = "all",
    world: World = None,
    seconds: Seconds = None,
    path: BenchPath = None,
    repeats: Repeats = 3,
    peers: Peers = False,
    seeds: Seeds = 20,
    seed: Seed = None,
    cases: Cases = 200,
    only: Only = None,
    workers: Workers = 1,
    recording: Recording = None,
    bound: Bound = True,
    logs: Logs = None,
    faults: Faults = None,
    pairs: Pairs = 4,
    clean: Clean = 0,
    curves: Curves = False,
    long: Long = False,
    independent: Independent = False,
    mutations: Mutations = 0,
    fix: Fix = False,
    cameras: OfCameras = False,
    set_: Set = None,
    config: ConfigFile = None,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Measure speed, as ratios taken in one run on this machine; or accuracy over many seeds."""
    from slamsim.console.reporter import Reporter
    from slamsim.guard.replaceable import require_apart

    require_used(part, _given(context))
    reporter = Reporter(quiet=quiet, as_json=as_json)
    require_apart((logs,), (recording,))
    asked = _Asked(world, config, tuple(set_ or ()), seed, seconds, path, reporter)
    if part == "accuracy":
        _accuracy(asked, seeds, workers, logs, bound)
    elif part == "robustness":
        _robustness(asked, range(1, cases + 1) if only is None else (only,), workers, logs)
    elif part == "online":
        _online(asked)
    elif part == "live":
        _live(asked)
    elif part == "check" and cameras:
        _check_cameras(asked, seeds, clean, faults, workers, logs)
    elif part == "check":
        from slamsim.bench.check.asked import CheckAsked, run_check

        figures = (seeds, FIRST_SEED if seed is None else seed, seconds, clean, pairs, mutations)
        trials = CheckAsked(*figures, faults, curves, long, workers, logs, recording, fix)
        run_check(trials, independent, reporter)
    elif part == "cameras":
        _cameras(asked)
    elif part == "matcher":
        _matcher(asked, recording, logs)
    elif part == "dataset":
        _dataset(asked, config, seeds)
    elif part == "slam" and peers:
        _peers(asked, logs)
    else:
        _speed(part, asked, repeats)


def _accuracy(asked: _Asked, seeds: int, workers: int, logs: Path | None, bound: bool) -> None:
    from slamsim.bench.accuracy import AccuracyCampaign, run_accuracy
    from slamsim.bench.logs import require_none_failed

    resolved = asked.or_standard().resolved_until_end()
    first = FIRST_SEED if asked.seed is None else asked.seed
    campaign = AccuracyCampaign(resolved, range(first, first + seeds), workers, logs, bound)
    figures = run_accuracy(campaign, asked.reporter)
    asked.reporter.result(figures)
    require_none_failed(cast(Mapping[str, object], figures["summary"])["failed"])


def _robustness(asked: _Asked, cases: Sequence[int], workers: int, kept: Path | None) -> None:
    from slamsim.bench.robustness.campaign import RobustnessCampaign, run_robustness

    seed = FIRST_SEED if asked.seed is None else asked.seed
    campaign = RobustnessCampaign(seed, cases, workers, kept)
    run_robustness(campaign, asked.reporter)


def _matcher(asked: _Asked, recording: Path | None, logs: Path | None) -> None:
    from slamsim.bench.logs import Children, kept_or_temporary, simulated_log
    from slamsim.bench.matcher import basin_rows, measure_matcher

    resolved = asked.or_standard().resolved_until_end()
    with (
        kept_or_temporary(logs) as folder,
        Children() as children,
        asked.reporter.stage("matcher", "scans/s") as progress,
    ):
        path = recording or simulated_log(resolved, folder, children)
        measured = measure_matcher(path, resolved.slam, progress)
    asked.reporter.table(
        "Home from, %: plain/with search", basin_rows(measured.plain, measured.searched)
    )
    _show("Single matches", asdict(measured), asked)


def _check_cameras(
    asked: _Asked, seeds: int, clean: int, typed: str | None, workers: int, logs: Path | None
) -> None:
    from slamsim.bench.cameras.faults import SECONDS, CameraCampaign, run_camera_check, typed_faults
    from slamsim.bench.logs import require_none_failed

    first = FIRST_SEED if asked.seed is None else asked.seed
    campaign = CameraCampaign(
        range(first, first + seeds),
        range(first + seeds, first + seeds + clean),
        None if typed is None else typed_faults(typed),
        asked.seconds or SECONDS,
        workers,
        logs,
    )
    figures = run_camera_check(campaign, asked.reporter)
    asked.reporter.result(figures)
    require_none_failed(figures["failed"])


def _cameras(asked: _Asked) -> None:
    from slamsim.bench.cameras.command import CAMERA_SECONDS, measure_cameras

    resolved = asked.resolved_until_end(CAMERA_SECONDS)
    _show("Cameras", measure_cameras(resolved, asked.reporter), asked)


def _dataset(asked: _Asked, recipe: str | None, count: int) -> None:
    from slamsim.bench.dataset import measure_dataset

    figures: dict[str, object] = {}
    try:
        measure_dataset(recipe or STANDARD_RECIPE, count, figures, asked.reporter)
    finally:  # what was measured before something failed is worth minutes
        if figures:
            _show("Data set", figures, asked)


def _online(asked: _Asked) -> None:
    from slamsim.bench.online import measure_online

    resolved = asked.resolved("labyrinth_large", ONLINE_RATE)
    _show("On line", measure_online(resolved, asked.path_m or ONLINE_PATH_M, asked.reporter), asked)


def _live(asked: _Asked) -> None:
    from slamsim.bench.live import SECONDS, measure_live

    figures = measure_live(asked.resolved("labyrinth"), asked.seconds or SECONDS, asked.reporter)
    _show("Live", figures, asked)


def _peers(asked: _Asked, logs: Path | None) -> None:
    from slamsim.bench.logs import Children, kept_or_temporary, simulated_log
    from slamsim.bench.peers.run import rows_shown, run_peers

    resolved = asked.resolved_until_end(SPEED_SECONDS)
    with kept_or_temporary(logs) as folder, Children() as children:
        log = simulated_log(resolved, folder, children)
        figures = run_peers(log, resolved.slam, asked.reporter)
    asked.reporter.table(f"Peers on {figures['log']}", rows_shown(figures))
    asked.reporter.result(figures)


def _speed(part: str, asked: _Asked, repeats: int) -> None:
    from slamsim.bench.speed import run_bench

    resolved = asked.resolved_until_end(SPEED_SECONDS)
    _show("Bench", run_bench(part, resolved, repeats, asked.reporter), asked)


def _show(title: str, figures: dict[str, object], asked: _Asked) -> None:
    from slamsim.console.summary import labelled

    asked.reporter.table(title, labelled(figures))
    asked.reporter.result(figures)
