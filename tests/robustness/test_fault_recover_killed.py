"""A recording whose writer was killed at any moment loses at most the chunk that was open."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from log_data import drive, header, readings
from typed import typed
from waiting import wait_for

from slamsim.guard.output import partial_folder
from slamsim.io.bag2.writer import MCAP_NAME
from slamsim.io.open import read_log, read_truth
from slamsim.io.salvage.recover import recover
from slamsim.io.salvage.source import damaged_recording
from slamsim.simulation.log_writer import LogWriter

pytestmark = pytest.mark.fault

KILLS = 4
WINDOW_S = 0.5
CHUNK_BYTES = 20_000
MAGIC = b"\x89MCAP0\r\n"
COMMAND = [sys.executable, "-c", "from slamsim.entry import main; main()"]


def write_until_killed(run: Path, told: int) -> None:
    """Records for ever, and says after each window that it is written."""
    with partial_folder(run) as folder, LogWriter(folder / "log", header()) as writer:
        for number in range(10_000):
            span = (number * WINDOW_S, (number + 1) * WINDOW_S)
            writer.write(readings(*span), drive(*span))
            os.write(told, b".")


def killed_writer(run: Path, after_s: float) -> int:
    """How many windows a child said to be written before it was killed."""
    heard, told = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.close(heard)
            write_until_killed(run, told)
        finally:
            os._exit(1)
    os.close(told)
    os.read(heard, 1)
    time.sleep(after_s)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    with os.fdopen(heard, "rb") as rest:
        return 1 + len(rest.read())


@pytest.mark.long
def test_a_killed_writer_loses_at_most_one_chunk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slamsim.io.mcap.writer.CHUNK_BYTES", CHUNK_BYTES)
    for number, after_s in enumerate(np.random.default_rng(1).uniform(0.0, 0.4, KILLS).tolist()):
        windows = killed_writer(tmp_path / str(number), after_s)
        (out := tmp_path / f"out_{number}").mkdir()
        told = recover(damaged_recording(tmp_path / str(number)), out)
        last_ns = max(topic.last_ns for topic in told.topics)
        bytes_per_s = sum(topic.bytes for topic in told.topics) / (last_ns * 1e-9)
        assert windows * WINDOW_S - last_ns * 1e-9 <= CHUNK_BYTES / bytes_per_s + 0.1
        read_log(out)
        truth = read_truth(out)
        assert truth is not None and len(truth) > 10


def end_of_last_whole_record(mcap: Path) -> int:
    """As the specification lays records out: magic of 8 bytes; then opcode, length, content."""
    data, end = mcap.read_bytes(), len(MAGIC)
    assert data.startswith(MAGIC)
    while len(data) >= end + 9:
        after = end + 9 + int.from_bytes(data[end + 1 : end + 9], "little")
        if after > len(data):
            break
        end = after
    return end


def test_what_a_killed_simulation_had_recorded_is_mapped(tmp_path: Path) -> None:
    """By its own name, although only the unfinished folder is there."""
    run = subprocess.Popen(
        [*COMMAND, "simulate", "labyrinth", "-q"],
        cwd=tmp_path,
        start_new_session=True,
        stderr=subprocess.DEVNULL,
    )
    pattern = f".labyrinth.slamsim-*/new/log/{MCAP_NAME}"
    found = (tmp_path / "outputs").glob
    wait_for(lambda: any(file.stat().st_size > 450_000 for file in found(pattern)))
    (recording,) = (tmp_path / "outputs").glob(pattern)
    os.killpg(run.pid, signal.SIGKILL)
    run.wait()
    size = recording.stat().st_size
    done = typed("recover", "outputs/labyrinth", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["folder"] == told["recording"] == "outputs/labyrinth_recovered"
    torn = size - end_of_last_whole_record(recording)
    assert sum(loss["bytes"] for loss in told["losses"]) == torn
    assert recording.stat().st_size == size
    log = read_log(tmp_path / told["recording"])
    seconds = {topic["topic"]: topic["seconds"] for topic in told["topics"]}
    assert len(list(log.scans)) > 20 and seconds["/scan"] > 2.0
    again = typed(*("recover", "outputs/labyrinth", "--out", "outputs/labyrinth"), cwd=tmp_path)
    assert again.returncode == 2
    assert "choose another" in again.stderr
    assert recording.stat().st_size == size
