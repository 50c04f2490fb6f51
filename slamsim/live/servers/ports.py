"""Which process listens at a port that is taken."""

from __future__ import annotations

import errno
import ipaddress
import socket
from collections.abc import Iterator
from pathlib import Path

from slamsim.guard.errors import OutputRefused, shown

_LISTENING = "0A"
"""State of a socket in ``/proc/net/tcp`` (include/net/tcp_states.h)."""

_PROC = Path("/proc")

Address = ipaddress.IPv4Address | ipaddress.IPv6Address


def not_served(host: str, port: int, error: OSError) -> OutputRefused:
    """To be raised where listening failed."""
    if error.errno == errno.EADDRINUSE:
        return port_in_use_error(host, port)
    return OutputRefused(f"nothing can be served at {host}:{port}: {error}")


def port_in_use_error(host: str, port: int) -> OutputRefused:
    """Names the process that holds a port which is taken.

    It is found in ``/proc`` (Linux) where the process belongs to the same user; else the sentence
    goes without.
    """
    inodes = set(_listening_inodes(host, port))
    holders = [_command(process) for process in _holders(inodes)] if inodes else []
    by = f" by {' and '.join(holders)}" if holders else " by another process"
    return OutputRefused(
        f"port {port} of {host} is already in use{by}; end it or choose another port"
    )


def _listening_inodes(host: str, port: int) -> Iterator[str]:
    """Of the sockets that keep others from binding there."""
    wanted = _addresses(host)
    for table in ("tcp", "tcp6"):
        try:
            lines = (_PROC / "net" / table).read_text().splitlines()[1:]
        except OSError:
            continue
        for line in lines:
            _, local, _, state, *_, inode = line.split()[:10]
            words, _, at = local.partition(":")
            if state != _LISTENING or int(at, 16) != port:
                continue
            bound = _address(words)
            if bound.is_unspecified or bound in wanted or any(a.is_unspecified for a in wanted):
                yield inode


def _addresses(host: str) -> set[Address]:
    """Of a host name; none for one that is not known."""
    try:
        found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    except OSError:
        return set()
    return {ipaddress.ip_address(place[0]) for *_, place in found}


def _address(words: str) -> Address:
    """From words of 32 bits in the byte order of this machine, in hexadecimal."""
    data = bytes.fromhex(words)
    swapped = (int.from_bytes(data[at : at + 4], "big") for at in range(0, len(data), 4))
    address = ipaddress.ip_address(
        b"".join(socket.ntohl(word).to_bytes(4, "big") for word in swapped)
    )
    mapped = address.ipv4_mapped if address.version == 6 else None
    return mapped or address


def _holders(inodes: set[str]) -> Iterator[Path]:
    """The folders in ``/proc`` of the processes that have one of these sockets open."""
    for process in sorted(_PROC.glob("[0-9]*"), key=lambda path: int(path.name)):
        try:
            files = list((process / "fd").iterdir())
        except OSError:  # of another user, or gone by now
            continue
        if any(_target(file).removeprefix("socket:").strip("[]") in inodes for file in files):
            yield process


def _target(link: Path) -> str:
    try:
        return str(link.readlink())
    except OSError:  # closed by now, as the file that this very listing was read from
        return ""


def _command(process: Path) -> str:
    """Number and command line of a process."""
    try:
        words = (process / "cmdline").read_bytes().rstrip(b"\0").split(b"\0")
    except OSError:
        words = []
    text = b" ".join(words).decode(errors="replace")
    return f"process {process.name} ({shown(text, 100)})" if text else f"process {process.name}"
