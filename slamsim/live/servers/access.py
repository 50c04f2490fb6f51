"""Who may connect to the servers of a live robot; which process listens at a port that is taken."""

from __future__ import annotations

import errno
import hmac
import ipaddress
import secrets
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, Self
from urllib.parse import parse_qs, urlsplit

from websockets.http11 import Request

from slamsim.guard.errors import OutputRefused, shown

LOOPBACK = "127.0.0.1"
DESKTOP_ORIGIN = "file://"
"""Of Electron; a browser says ``null`` for a page that it opened from a file."""


class Server(Protocol):
    """Serves from when it was started until its block ends. address: what a client opens."""

    @property
    def address(self) -> str: ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *error: object) -> None: ...


@dataclass(frozen=True, slots=True)
class Access:
    """host: address to listen at. token: what every client must bring; None on this machine."""

    host: str = LOOPBACK
    token: str | None = None

    @classmethod
    def at(cls, host: str) -> Access:
        """Beyond this machine only with a new token."""
        return cls(host, None if is_loopback(host) else secrets.token_urlsafe(24))

    @property
    def url_host(self) -> str:
        """The host of the addresses that clients open: where all of this machine's are listened at,
        the one by which others reach it."""
        host = self.host
        if host in ("0.0.0.0", "::", ""):
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                try:
                    probe.connect(("192.0.2.1", 9))  # chooses a route, and sends nothing
                    host = str(probe.getsockname()[0])
                except OSError:
                    host = LOOPBACK
        return f"[{host}]" if ":" in host else host

    def refusal(self, host: str, origin: str | None, token: str | None) -> str | None:
        """Why a request is refused, None if it is not.

        host: its Host header. origin: its Origin header, which a browser always sends with a
        WebSocket: a page may only be one of this machine, or come from the very host that it asks
        for. A name that is not known to be this machine's is refused where only this machine may
        ask, for a page elsewhere could have it resolve to 127.0.0.1 (DNS rebinding). The desktop
        programs of Foxglove and Lichtblick, whose pages are files, say so; no page of a server can.
        """
        asked = _hostname(f"//{host}")
        if is_loopback(self.host) and not is_loopback(asked):
            return f"the host {asked!r} is not this machine"
        if origin is not None and origin != DESKTOP_ORIGIN:
            page = _hostname(origin)
            if not (is_loopback(page) or (page and page == asked)):
                return f"pages from {origin!r} may not connect"
        if self.token is not None and not hmac.compare_digest(
            self.token.encode(), (token or "").encode()
        ):
            return "the token is missing or wrong"
        return None


def refusal(access: Access, request: Request) -> str | None:
    """Why a request is refused; its token is in the URL (?token=) or an Authorization header."""
    hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
    if len(hosts) != 1 or len(origins) > 1:
        return "a request has one Host and at most one Origin"
    return access.refusal(hosts[0], next(iter(origins), None), _token(request))


def _token(request: Request) -> str | None:
    for value in request.headers.get_all("Authorization"):
        kind, _, token = value.partition(" ")
        if kind.lower() == "bearer":
            return token.strip()
    return next(iter(parse_qs(urlsplit(request.path).query).get("token", [])), None)


def is_loopback(host: str) -> bool:
    """Whether a host name or address means this very machine."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _hostname(url: str) -> str:
    try:
        return urlsplit(url).hostname or ""
    except ValueError:
        return ""


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
