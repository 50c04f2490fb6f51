"""The process at a port that is taken is found."""

from __future__ import annotations

import os
import socket
import subprocess
import sys

import pytest

from slamsim.live.servers.access import port_in_use_error

linux = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")


@linux
@pytest.mark.parametrize(
    ("bound", "asked"),
    [("127.0.0.1", "127.0.0.1"), ("127.0.0.1", "localhost"), ("", "127.0.0.1"), ("127.0.0.1", "")],
)
def test_the_process_that_holds_a_port_is_named(bound: str, asked: str) -> None:
    with socket.create_server((bound, 0)) as server:
        port = server.getsockname()[1]
        error = port_in_use_error(asked or "0.0.0.0", port)
    assert f"process {os.getpid()} (" in str(error) and f"port {port} of" in str(error)
    assert error.exit_code == 2


@linux
@pytest.mark.skipif(not socket.has_dualstack_ipv6(), reason="no IPv6 on this machine")
def test_a_socket_of_both_families_is_found() -> None:
    with socket.create_server(("", 0), family=socket.AF_INET6, dualstack_ipv6=True) as server:
        error = port_in_use_error("127.0.0.1", server.getsockname()[1])
    assert f"process {os.getpid()} (" in str(error)


@linux
def test_another_process_is_named_with_its_command() -> None:
    script = (
        "import socket; s = socket.create_server(('127.0.0.1', 0));"
        "print(s.getsockname()[1], flush=True); input()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", script, "--some-name"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        error = port_in_use_error("127.0.0.1", int(process.stdout.readline()))
        process.communicate("\n")
    assert f"process {process.pid} (" in str(error)


def test_an_unknown_holder_is_said_to_be_another_process() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        free = server.getsockname()[1]
    for host in ("127.0.0.1", "no.such.host.invalid"):
        assert "another process" in str(port_in_use_error(host, free))
