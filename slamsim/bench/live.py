"""``slamsim bench live``: does a live robot keep pace, and how late are messages and commands?

A tour of the world in real time with SLAM and a Foxglove client, again with a second client that
reads nothing, without SLAM, and as fast as possible; then its recording is mapped off line.
"""

from __future__ import annotations

import json
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np

from slamsim.bench import Figures
from slamsim.config.run import RunConfig
from slamsim.console.reporter import Reporter
from slamsim.core.types import PlanarTrajectory, Trajectory
from slamsim.evaluate.trajectory import compare
from slamsim.io import LOG
from slamsim.io.open import open_recording
from slamsim.live.controls import LiveOptions
from slamsim.live.loop import LiveLoop, LiveSetup
from slamsim.live.loop_controls import LoopControls
from slamsim.live.mapping import MappingProcess
from slamsim.live.servers.access import Access
from slamsim.live.servers.foxglove import FoxgloveServer
from slamsim.run.live.serving import living
from slamsim.run.live.world import live_config
from slamsim.slam.session import run_slam

SECONDS = 60.0
_SETTLED_S = 5.0
"""Left out at the beginning: clients connect."""
_TWISTS_PER_S = 20

_CLIENT = """
import json, struct, sys, time
from websockets.sync.client import connect

with connect(sys.argv[1], subprotocols=["foxglove.sdk.v1"], max_size=None) as socket:
    scan, heard = None, []
    while True:
        try:
            message = socket.recv(timeout=30)
        except Exception:
            break
        now_s = time.monotonic()
        if isinstance(message, str):
            told = json.loads(message)
            for channel in told.get("channels", ()):
                if channel["topic"] == "/scan":
                    wanted = [{"id": 1, "channelId": channel["id"]}]
                    socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        elif message[0] == 1:
            print(struct.unpack("<Q", message[5:13])[0], now_s, flush=True)
"""
"""Prints the log time of each scan, and when it was there; CLOCK_MONOTONIC is every process's."""


@dataclass(slots=True)
class Lived:
    """What was measured while a robot lived."""

    realtime_factor: float = 0.0
    cpu_share: float = 0.0
    late_share: float = 0.0
    latency_ms: list[float] = field(default_factory=list)
    command_ms: list[float] = field(default_factory=list)
    trajectory: PlanarTrajectory | None = None


def measure_live(config: RunConfig, seconds: float, reporter: Reporter) -> Figures:
    """Figures of ``slamsim live`` in the configured world. seconds: of each run in real time."""
    config = live_config(config)
    figures: Figures = {"world": config.world.name}
    with tempfile.TemporaryDirectory(prefix="slamsim-bench-live-") as name:
        folder = Path(name)
        paced = _lived(config, folder / "paced", reporter, "paced", seconds)
        figures |= {
            "realtime_factor": paced.realtime_factor,
            "late_window_share": paced.late_share,
            "latency_p50_ms": _percentile(paced.latency_ms, 50),
            "latency_p95_ms": _percentile(paced.latency_ms, 95),
        }
        driven = _lived(config, folder / "driven", reporter, "driven", seconds, twists=True)
        figures["command_p95_ms"] = _percentile(driven.command_ms, 95)
        slow = _lived(config, folder / "slow", reporter, "slow client", seconds, idle_client=True)
        figures["slow_client_delay_ms"] = _percentile(slow.latency_ms, 95) - _percentile(
            paced.latency_ms, 95
        )
        alone = _lived(config, folder / "alone", reporter, "no SLAM", seconds / 2, slam=False)
        figures["cpu_share_without_slam"] = alone.cpu_share
        fast = _lived(config, folder / "fast", reporter, "unpaced", None)
        figures["unpaced_factor"] = fast.realtime_factor
        figures |= _accuracy(config, folder / "fast" / "drive_1" / LOG, fast, reporter)
    return figures


def _lived(
    config: RunConfig,
    folder: Path,
    reporter: Reporter,
    title: str,
    seconds: float | None,
    *,
    slam: bool = True,
    twists: bool = False,
    idle_client: bool = False,
) -> Lived:
    """One run. seconds: None for a whole tour, unpaced and recorded."""
    options = LiveOptions(
        rate=None if seconds is None else 1.0,
        mode="manual" if twists else "tour",
        record=seconds is None,
        until_done=True,
        duration_s=np.inf if seconds is None else seconds + _SETTLED_S,
        slam=slam,
    )
    found = Lived()
    with ExitStack() as opened:
        process = opened.enter_context(MappingProcess()) if slam else None
        loop = LiveLoop(LiveSetup.built(config, folder, options), process)
        controls = LoopControls(loop)
        with (
            FoxgloveServer(loop.hub, controls, Access(), 0) as server,
            _heard(server.address, loop, found),
            _idle(server.address, idle_client),
            reporter.stage(title, "× real time") as progress,
        ):
            _run(loop, found, progress, controls if twists else None)
        if process is not None and seconds is None:
            found.trajectory = process.finish().trajectory
    found.command_ms = [1e3 * delay for delay in loop.steering.manual.delays_s]
    status = loop.status
    found.late_share = status.late_windows / max(status.windows, 1)
    return found


def _run(
    loop: LiveLoop,
    found: Lived,
    progress: Callable[[float, float], None],
    controls: LoopControls | None,
) -> None:
    """Let it live to its end, and measure from when time begins. controls: to send twists by."""
    begun: tuple[float, int, float] | None = None
    with living(loop) as thread:
        while thread.is_alive():
            thread.join(1.0 / _TWISTS_PER_S)
            stamp_ns = loop.status.stamp_ns
            lived_s = (stamp_ns - loop.begun_ns) * 1e-9
            progress(lived_s, loop.setup.options.duration_s)
            if begun is None and lived_s >= (_SETTLED_S if loop.pace.rate else 0.1):
                begun = time.monotonic(), stamp_ns, time.process_time()
            if controls is not None and begun is not None:
                controls.drive(0.2, 0.3)
    assert begun is not None, "it ended before it began"
    begun_s, begun_ns, begun_cpu_s = begun
    lasted_s = time.monotonic() - begun_s
    found.realtime_factor = (loop.status.stamp_ns - begun_ns) * 1e-9 / lasted_s
    found.cpu_share = (time.process_time() - begun_cpu_s) / lasted_s


@contextmanager
def _heard(address: str, loop: LiveLoop, found: Lived) -> Iterator[None]:
    """A client in a process of its own, which says when each scan was there."""
    command = [sys.executable, "-c", _CLIENT, address]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as client:
        assert client.stdout is not None
        lines: list[str] = []
        reader = threading.Thread(target=lambda: lines.extend(client.stdout or ()), daemon=True)
        reader.start()
        try:
            yield
        finally:
            time.sleep(0.5)  # what is on its way arrives
            client.terminate()
            reader.join(10.0)
    for line in lines:
        log_ns, heard_s = line.split()
        due_s = loop.pace.due_s(int(log_ns))
        if int(log_ns) - loop.begun_ns > _SETTLED_S * 1e9 and np.isfinite(due_s):
            found.latency_ms.append(1e3 * (float(heard_s) - due_s))


@contextmanager
def _idle(address: str, wanted: bool) -> Iterator[None]:
    """A client that subscribes to the scans and reads nothing ever after."""
    if not wanted:
        yield
        return
    place = urlsplit(address)
    with socket.create_connection((place.hostname, place.port)) as client:
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        lines = (
            "GET / HTTP/1.1",
            f"Host: {place.hostname}:{place.port}",
            "Upgrade: websocket",
            "Connection: Upgrade",
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
            "Sec-WebSocket-Version: 13",
            "Sec-WebSocket-Protocol: foxglove.sdk.v1",
        )
        client.sendall("\r\n".join([*lines, "", ""]).encode())
        channels = range(1, 64)  # more than there are: those that exist are subscribed to
        wanted_ids = [{"id": one, "channelId": one} for one in channels]
        text = json.dumps({"op": "subscribe", "subscriptions": wanted_ids}).encode()
        client.sendall(_frame(text))
        yield


def _frame(text: bytes) -> bytes:
    """A masked WebSocket text frame (RFC 6455), its mask zero."""
    return struct.pack("!BBH4x", 0x81, 0x80 | 126, len(text)) + text


def _accuracy(config: RunConfig, log: Path, fast: Lived, reporter: Reporter) -> Figures:
    """ATE of the live map's final solution, and of the same recording mapped off line."""
    recording = open_recording(log)
    with reporter.stage("off line", "scans/s") as progress:
        offline = run_slam(recording.log(), config.slam, progress).trajectory
    truth = recording.truth()
    assert truth is not None and fast.trajectory is not None
    online_m, offline_m = _ate_m(fast.trajectory, truth), _ate_m(offline, truth)
    return {
        "ate_online_m": online_m,
        "ate_offline_m": offline_m,
        "ate_online_over_offline": online_m / offline_m,
    }


def _ate_m(trajectory: PlanarTrajectory, truth: Trajectory) -> float:
    errors_m = compare(trajectory, truth.planar()).translation_m
    return float(np.sqrt(np.mean(errors_m**2)))


def _percentile(values: list[float], share: float) -> float:
    return float(np.percentile(values, share)) if values else float("nan")
