"""A live robot that is told to stop leaves a whole recording, which can be driven again."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
from fault_processes import running
from waiting import TIMEOUT_S, wait_for

from slamsim.console.reporter import Reporter
from slamsim.run.live.world import replay_drive

pytestmark = pytest.mark.fault

COMMAND = "live tiny --drive tour --no-slam --record -q --out out"
NO_SERVERS = "--page-port 0 --rosbridge-port 0 --foxglove-port 0"


def contents(folder: Path) -> dict[str, bytes]:
    found = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in found}


@pytest.mark.long
def test_a_drive_that_ctrl_c_ends_is_whole_and_can_be_driven_again(tmp_path: Path) -> None:
    def is_recorded() -> bool:
        return any(path.stat().st_size > 100_000 for path in tmp_path.rglob("*.mcap"))

    with running(*COMMAND.split(), *NO_SERVERS.split(), cwd=tmp_path) as run:
        wait_for(is_recorded)
        run.process.send_signal(signal.SIGINT)
        code, told, _ = run.ended(TIMEOUT_S)
        assert run.orphans() == []
    assert (code, told) == (0, "")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["drive_1"]
    replay_drive(tmp_path / "out" / "drive_1", tmp_path / "again", Reporter(quiet=True))
    assert contents(tmp_path / "again") == contents(tmp_path / "out" / "drive_1")
