"""Many drives with many faults, on several cores; finished trials are kept and not repeated."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from slamsim.bench.check.outcome import (
    CheckOutcome,
    CheckTrial,
    Json,
    clean_trial,
    curve_trials,
    fault_trials,
    outcome_of,
    pair_trials,
    require_known_names,
    run_recording,
)
from slamsim.bench.check.summary import run_line, summarise, summary_tables
from slamsim.bench.check.truth import truths
from slamsim.bench.logs import Children, each_done
from slamsim.config.bundled import bundled_names
from slamsim.config.loading import load_run_config
from slamsim.config.run import RunConfig
from slamsim.console.reporter import Reporter
from slamsim.core.randomness import random_stream
from slamsim.guard.errors import InputRefused, SlamsimError
from slamsim.guard.files import open_input
from slamsim.guard.output import write_atomic
from slamsim.sensors.faults.base import Fault
from slamsim.simulation.driven import Driven

KEPT_EVERY = 10
"""After so many trials what is done is written to disk."""


@dataclass(frozen=True, slots=True)
class CheckCampaign:
    """What to run. seeds: a drive each, checked clean and with every fault. clean_seeds: drives
    that are only checked clean. recordings: real ones. pairs: random pairs of faults for each of
    ``seeds``. curves: every size of every fault too. seconds: length of a drive. kept: folder with
    what is done of the drives."""

    faults: Sequence[Fault]
    seeds: Sequence[int]
    clean_seeds: Sequence[int] = ()
    recordings: Sequence[Path] = ()
    pairs: int = 0
    curves: bool = False
    seconds: float = 60.0
    workers: int = 1
    kept: Path | None = None

    def trials(self, seed: int) -> list[CheckTrial]:
        """What is checked of one drive."""
        if seed in self.clean_seeds:
            return [clean_trial()]
        return [
            clean_trial(),
            *fault_trials(self.faults),
            *pair_trials(self.faults, self.pairs, seed),
            *(curve_trials(self.faults) if self.curves else ()),
        ]


def run_campaign(campaign: CheckCampaign, reporter: Reporter) -> Json:
    """Every outcome, and the summary over all drives; one that fails is told and counted.

    Raises SlamsimError for faults that the checker cannot report.
    """
    require_known_names(campaign.faults)
    runs: list[Json] = []
    count = len(campaign.seeds) + len(campaign.clean_seeds) + len(campaign.recordings)
    with reporter.stage("check") as progress, each_done(_jobs(campaign), campaign.workers) as done:
        for run in done:
            runs.append(run)
            reporter.say(run_line(run))
            progress(len(runs), count)
    runs.sort(key=lambda run: str(run["drive"]))
    summary = summarise(runs)
    for title, rows in summary_tables(summary).items():
        reporter.table(title, rows)
    return {"summary": summary, "runs": runs}


def _jobs(campaign: CheckCampaign) -> list[Callable[[Children], Json]]:
    """Each gives the outcomes of a drive, or why there are none."""
    seeds = (*campaign.seeds, *campaign.clean_seeds)
    return [
        *(partial(_tried, _drive(seed), partial(run_seed, campaign, seed)) for seed in seeds),
        *(
            partial(_tried, str(path), partial(run_recording, path, campaign.faults))
            for path in campaign.recordings
        ),
    ]


def _tried(drive: str, run: Callable[[], Json], children: Children) -> Json:
    try:
        return children.run(run)
    except SlamsimError as error:
        return {"drive": drive, "error": str(error), "outcomes": []}


def _drive(seed: int) -> str:
    return f"seed {seed:4d}"


def run_seed(campaign: CheckCampaign, seed: int) -> Json:
    """One drive with all of its trials, in this process; those that were kept are taken over."""
    scenario = random_scenario(seed, campaign.seconds)
    done = _kept(campaign, seed)
    missing = [trial for trial in campaign.trials(seed) if trial.name not in done]
    if missing:
        driven = Driven(scenario.config)
        for count, trial in enumerate(missing, 1):
            truth = truths(scenario.config, trial.faults)
            done[trial.name] = outcome_of(trial, driven.recording, truth)
            if count % KEPT_EVERY == 0 or count == len(missing):
                _keep(campaign, seed, done)
    asked = [done[trial.name].as_json() for trial in campaign.trials(seed)]
    return {
        "drive": _drive(seed),
        "world": scenario.world,
        "lidar": scenario.lidar,
        "outcomes": asked,
    }


def _kept(campaign: CheckCampaign, seed: int) -> dict[str, CheckOutcome]:
    path = _path(campaign, seed)
    if path is None or not path.is_file():
        return {}
    try:
        with open_input(path) as file:
            return {name: CheckOutcome.from_json(data) for name, data in json.load(file).items()}
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        reason = f"holds no outcomes of trials ({error!r:.100}); delete it to measure again"
        raise InputRefused(path, reason) from None


def _keep(campaign: CheckCampaign, seed: int, done: dict[str, CheckOutcome]) -> None:
    path = _path(campaign, seed)
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        data = {name: outcome.as_json() for name, outcome in done.items()}
        write_atomic(path, json.dumps(data).encode())


def _path(campaign: CheckCampaign, seed: int) -> Path | None:
    if campaign.kept is None:
        return None
    return campaign.kept / f"seed_{seed}_{campaign.seconds:g}s.json"


WORLDS = ("labyrinth", "labyrinth", "labyrinth", "rooms", "loop", "symmetric")


@dataclass(frozen=True, slots=True)
class CheckScenario:
    """What one seed stands for; world and lidar are the names of what it was drawn from."""

    seed: int
    world: str
    lidar: str
    config: RunConfig


def random_scenario(seed: int, seconds: float) -> CheckScenario:
    """The scenario of a seed, always the same one.

    World, size, preset of the lidar, rates, phases, where the laser is mounted and the errors that
    a careful user leaves are drawn; the route is a tour cut after ``seconds``.
    """
    rng = random_stream(seed, "bench check", "scenario")
    world = str(rng.choice(WORLDS))
    lidar = str(rng.choice(bundled_names("configs/sensors")))
    overrides = [
        f"drive.route.max_duration_s={seconds:.1f}",
        f"sensors.lidar={lidar}",
        "robot=turtlebot2",
        *_world(world, rng),
        *_clocks(rng),
        *_wheels(rng),
        *_mount(rng),
    ]
    return CheckScenario(seed, world, lidar, load_run_config(world, None, overrides, seed))


def _world(world: str, rng: np.random.Generator) -> list[str]:
    if world != "labyrinth":
        return ["world.floor.patches=[]"]  # on a wet floor wheels truly slip
    rows, columns = rng.integers(4, 11, size=2)
    return [f"world.maze.rows={rows}", f"world.maze.columns={columns}"]


def _clocks(rng: np.random.Generator) -> list[str]:
    """Streams that begin at any instant, stamped and received nearly when they should be."""
    rates = {"imu": rng.choice([100.0, 200.0, 400.0]), "encoders": rng.choice([20.0, 50.0, 100.0])}
    overrides = [f"sensors.{name}.rate_hz={rate}" for name, rate in rates.items()]
    for name in ("lidar", "imu", "encoders"):
        at = f"sensors.{name}"
        overrides += [
            f"{at}.phase_s={rng.uniform(0.0, 0.2):.6f}",
            f"{at}.clock.jitter_s={rng.uniform(0.0, 5e-5):.7f}",
            f"{at}.clock.latency_s={rng.uniform(5e-4, 3e-3):.6f}",
            f"{at}.clock.latency_jitter_s={rng.uniform(1e-4, 1e-3):.6f}",
        ]
    return overrides


def _wheels(rng: np.random.Generator) -> list[str]:
    """What a careful calibration leaves (Borenstein & Feng 1996), of either sign."""
    at = "sensors.encoders"
    left, right = rng.uniform(-7e-4, 7e-4, size=2)
    return [
        f"{at}.wheel_radius_error={rng.uniform(-0.003, 0.003):.5f}",
        f"{at}.track_error={rng.uniform(-0.006, 0.006):.5f}",
        f"{at}.wheel_scale_error=[{left:.6f}, {right:.6f}]",
        f"{at}.ticks_per_revolution={rng.choice([1024, 2578, 4096])}",
    ]


def _mount(rng: np.random.Generator) -> list[str]:
    at = "robot.lidar.mount"
    return [
        f"{at}.x_m={rng.uniform(-0.05, 0.1):.3f}",
        f"{at}.y_m={rng.uniform(-0.05, 0.05):.3f}",
        f"{at}.yaw_deg={rng.choice([0.0, 0.0, 0.0, 180.0, 90.0, -45.0])}",
    ]
