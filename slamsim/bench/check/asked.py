"""What the command line asks of the bench of the checker."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from slamsim.bench.check.campaign import CheckCampaign, run_campaign
from slamsim.bench.check.independent import IndependentCampaign, generator_folder, run_independent
from slamsim.bench.check.outcome import Json, recordings_at
from slamsim.bench.logs import Children, require_none_failed
from slamsim.check.check import check_recording
from slamsim.config.faults import typed_choices
from slamsim.config.loading import load_run_config
from slamsim.console.reporter import Reporter
from slamsim.sensors.faults.cameras import CameraFault
from slamsim.sensors.faults.registry import bundled_faults, chosen_fault
from slamsim.simulation.driven import Driven

CHECK_SECONDS, LONG_SECONDS = 60.0, 600.0
"""A minute is what a first test drive lasts; ten are a long recording."""


@dataclass(frozen=True, slots=True)
class CheckAsked:
    """The options; faults as typed. kept: folder for results as they come. real: a recording, or
    a folder of them, that takes the place of the simulated ones."""

    seeds: int
    first: int
    seconds: float | None
    clean: int
    pairs: int
    mutations: int
    faults: str | None
    curves: bool
    long: bool
    workers: int
    kept: Path | None
    real: Path | None
    fix: bool


def run_check(asked: CheckAsked, independent: bool, reporter: Reporter) -> None:
    """independent: with recordings of the generator in tests/independent."""
    if independent:
        run_independent(_independent(asked), reporter)
        return
    figures = run_campaign(_campaign(asked), reporter)
    if asked.long:
        with Children() as children, reporter.stage("long recording"):
            timed = children.run(time_long_check, LONG_SECONDS, asked.first)
        reporter.table("Long recording", long_rows(timed))
        figures["long"] = timed
    reporter.result(figures)
    require_none_failed(cast(Json, figures["summary"])["failed"])


def _campaign(asked: CheckAsked) -> CheckCampaign:
    # Drives of this bench have no cameras: ``bench check --cameras`` has those faults.
    faults = tuple(each for each in bundled_faults() if not isinstance(each, CameraFault))
    if asked.faults is not None:
        faults = tuple(map(chosen_fault, typed_choices(asked.faults.split(","))))
    after = asked.first + asked.seeds
    return CheckCampaign(
        faults,
        seeds=range(asked.first, after) if asked.real is None else (),
        clean_seeds=range(after, after + asked.clean),
        recordings=() if asked.real is None else recordings_at(asked.real),
        pairs=asked.pairs,
        curves=asked.curves,
        seconds=asked.seconds or CHECK_SECONDS,
        workers=asked.workers,
        kept=asked.kept,
    )


def _independent(asked: CheckAsked) -> IndependentCampaign:
    return IndependentCampaign(
        generator_folder(),
        seeds=range(asked.first, asked.first + asked.seeds),
        clean=asked.clean,
        pairs=asked.pairs,
        mutations=asked.mutations,
        only=None if asked.faults is None else asked.faults.split(","),
        seconds=asked.seconds or CHECK_SECONDS,
        workers=asked.workers,
        kept=asked.kept,
        fix=asked.fix,
    )


WORLD, LIDAR = "labyrinth_large", "utm_30lx"


def time_long_check(seconds: float, seed: int) -> Json:
    """Seconds for a healthy drive of that length at 40 scans of 1081 beams a second, in memory."""
    overrides = [f"sensors.lidar={LIDAR}", f"drive.route.max_duration_s={seconds:.1f}"]
    recording = Driven(load_run_config(WORLD, None, overrides, seed)).recording()
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    report = check_recording(recording)
    return {
        "recorded_s": seconds,
        "scans": len(recording.scans[0]),
        "seconds": time.perf_counter() - wall_s,
        "cpu_seconds": time.process_time() - cpu_s,
        "parts": report.seconds,
        "said": [finding.fault for finding in report.faults],
    }


def long_rows(figures: Json) -> dict[str, str]:
    """What a person sees of it."""
    return {
        "recorded": f"{figures['recorded_s']:.0f} s, {figures['scans']} scans",
        "checked in": f"{figures['seconds']:.1f} s, {figures['cpu_seconds']:.1f} s of processor",
        "found": ", ".join(cast(list[str], figures["said"])) or "nothing",
    }
