"""A data set on a real SSH server of this machine."""

from __future__ import annotations

import getpass
import os
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import fsspec.config
import pytest
from dataset_remote_life import live_through
from dataset_whole import KeptEngine

from slamsim.dataset.make.engines.local import LocalEngine

pytest.importorskip("paramiko")
SSHD = shutil.which("sshd", path=f"{os.environ['PATH']}:/usr/sbin")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(SSHD is None, reason="openssh-server is not installed"),
]


def _key(path: Path) -> Path:
    command = ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(path)]
    subprocess.run(command, check=True)
    return path


@pytest.fixture
def server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Its address; whoever runs the tests may enter by a key made for it."""
    key = _key(tmp_path / "key")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    settings = {
        "Port": port,
        "ListenAddress": "127.0.0.1",
        "HostKey": _key(tmp_path / "host_key"),
        "AuthorizedKeysFile": key.with_suffix(".pub"),
        "PidFile": tmp_path / "pid",
        "StrictModes": "no",
        "UsePAM": "no",
        "Subsystem": "sftp internal-sftp",
    }
    config = tmp_path / "sshd_config"
    config.write_text("".join(f"{name} {value}\n" for name, value in settings.items()))
    if os.geteuid() == 0:
        Path("/run/sshd").mkdir(exist_ok=True)
    monkeypatch.setitem(fsspec.config.conf, "sftp", {"key_filename": str(key)})
    monkeypatch.setenv("FSSPEC_SFTP_KEY_FILENAME", str(key))
    assert SSHD is not None
    with subprocess.Popen([SSHD, "-D", "-f", config], stderr=subprocess.DEVNULL) as sshd:
        _await_greeting(port)
        yield f"sftp://{getpass.getuser()}@127.0.0.1:{port}"
        sshd.terminate()


def _await_greeting(port: int) -> None:
    end_s = time.monotonic() + 10.0
    while True:
        try:
            with socket.create_connection(("127.0.0.1", port), 1.0) as connection:
                assert connection.recv(4) == b"SSH-"
                return
        except OSError:
            if time.monotonic() > end_s:
                raise
            time.sleep(0.1)


def test_a_data_set_on_a_server_is_made_read_verified_and_repaired(
    server: str, tmp_path: Path
) -> None:
    with LocalEngine(1) as engine:
        live_through(f"{server}{tmp_path}/there/set", KeptEngine(engine), tmp_path)
