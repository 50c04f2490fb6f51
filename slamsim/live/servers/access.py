"""Who may connect to the servers of a live robot."""

from __future__ import annotations

import hmac
import ipaddress
import secrets
import socket
from dataclasses import dataclass
from typing import Protocol, Self
from urllib.parse import parse_qs, urlsplit

from websockets.http11 import Request

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
