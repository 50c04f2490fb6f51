"""Run time of a check of a long recording."""

from __future__ import annotations

import time
from typing import cast

from slamsim.bench.check.outcome import Json
from slamsim.check.check import check_recording
from slamsim.config.loading import load_run_config
from slamsim.simulation.driven import Driven

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
