"""``slamsim live --from`` as it is typed."""

from __future__ import annotations

import json
import threading
from pathlib import Path
from typing import Any

import pytest
from fake_robot import FakeRobot
from played_robot import PlayedSource, simulated
from typed import typed

from slamsim.cli.live_command import _url
from slamsim.guard.errors import SlamsimError
from slamsim.live.hub import Hub, Message
from slamsim.live.remote import robot as remote
from slamsim.live.servers.access import Access
from slamsim.live.servers.foxglove import FoxgloveServer
from slamsim.live.servers.rosbridge.server import RosbridgeServer

pytestmark = pytest.mark.usefixtures("drives_here")


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> list[Message]:
    return simulated(tmp_path_factory.mktemp("from") / "log", "drive.route.max_duration_s=14")


@pytest.mark.long
@pytest.mark.parametrize(
    "protocol", ["rosbridge", pytest.param("foxglove", marks=pytest.mark.slow)]
)
def test_a_robot_behind_a_server_is_mapped(
    protocol: str, drive: list[Message], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(remote, "FIRST_S", 0.5)
    played = PlayedSource(drive, speed=1.5)
    played.subscribe(topic.name for topic in played.topics())
    hub, ended = Hub(played.topics()), threading.Event()

    def play() -> None:
        while not ended.is_set():
            message = played.receive(0.05)
            if message is not None:
                hub.publish(message.topic.name, message.log_ns, message.data)
            elif played.is_over:
                return

    starts: dict[str, Any] = {"rosbridge": RosbridgeServer, "foxglove": FoxgloveServer}
    with starts[protocol](hub, FakeRobot(tmp_path), Access(), port=0) as server:
        thread = threading.Thread(target=play)
        thread.start()
        try:
            given = f"--from {server.address} --duration 10 --page-port 0 --no-check --json"
            out = tmp_path / "out"
            done = typed("live", *given.split(), "--out", "out", cwd=tmp_path)
        finally:
            ended.set()
            thread.join()
    assert done.returncode == 0, done.stderr
    numbers = json.loads(done.stdout)
    assert numbers["scans_mapped"] > 10 and numbers["keyframes"] > 2
    out = tmp_path / "out"
    assert (out / "map" / "map.yaml").is_file() and (out / "map" / "trajectory.tum").is_file()


def test_what_is_no_address_is_refused(tmp_path: Path) -> None:
    assert _url("ws://a:1", "labyrinth") == "ws://a:1" == _url("foxglove ws://a:1", "labyrinth")
    assert _url("rosbridge", "ws://a:1") == "ws://a:1" and _url("", "labyrinth") == ""
    with pytest.raises(SlamsimError, match="a URL such as ws://robot:9090"):
        _url("telnet ws://a:1", "labyrinth")
    for address, told in (
        ("http://robot:9090", "an address such as ws://robot:9090"),
        ("ws://127.0.0.1:9", "nothing answers there"),
    ):
        done = typed("live", "--from", address, "--page-port", 0, cwd=tmp_path)
        assert done.returncode != 0 and told in " ".join(done.stderr.split())


@pytest.mark.parametrize(
    "option", ["--drive tour", "--rate 2", "--until-done", "--no-slam", "tiny"]
)
def test_what_only_a_simulation_takes_is_refused(option: str, tmp_path: Path) -> None:
    done = typed("live", *option.split(), "--from", "ws://127.0.0.1:9", cwd=tmp_path)
    assert done.returncode == SlamsimError.exit_code and "belongs to simulations" in done.stderr
