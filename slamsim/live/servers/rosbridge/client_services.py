"""Services that clients serve to each other."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from slamsim.guard.errors import shown
from slamsim.io.ros.values import WrongMessage
from slamsim.live.servers.rosbridge.client import Client

Answer = Callable[[object, bool], None]
"""Gets the values of a response, and whether the call succeeded."""

MOST_SERVICES = 256
"""Of one client."""


@dataclass(frozen=True, slots=True)
class _Call:
    server: Client
    caller: Client
    answer: Answer


class ClientServices:
    """All of it happens on the server's event loop."""

    def __init__(self) -> None:
        self._servers: dict[str, tuple[Client, str]] = {}
        self._calls: dict[str, _Call] = {}
        self._numbers = itertools.count()

    def types(self) -> Mapping[str, str]:
        """Of the services, by name."""
        return {name: kind for name, (_, kind) in self._servers.items()}

    def advertise(self, client: Client, name: str, type_name: str) -> None:
        """Raises WrongMessage for one that another client serves, and for too many."""
        server = self._servers.get(name, (client, ""))[0]
        if server is not client:
            raise WrongMessage(f"another client serves {shown(name)}")
        if sum(one is client for one, _ in self._servers.values()) >= MOST_SERVICES:
            raise WrongMessage(f"a client may serve {MOST_SERVICES} services at most")
        self._servers[name] = client, type_name

    def unadvertise(self, client: Client, name: str) -> None:
        """Raises WrongMessage if the client does not serve it."""
        if self._servers.get(name, (None, ""))[0] is not client:
            raise WrongMessage(f"{shown(name)} was not advertised")
        del self._servers[name]

    def call(self, caller: Client, name: str, args: Mapping[str, Any], answer: Answer) -> None:
        """Ask the client that serves it; answered when that does, or is gone."""
        server, _ = self._servers[name]
        if not server.reads:
            answer(f"the client that serves {name} does not read", False)
            return
        key = f"slamsim:{next(self._numbers)}"
        server.reply({"op": "call_service", "id": key, "service": name, "args": args})
        self._calls[key] = _Call(server, caller, answer)
        caller.calls += 1

    def respond(self, client: Client, key: object, values: object, succeeded: bool) -> None:
        """Raises WrongMessage if the client was not asked, or for what JSON cannot hold."""
        call = self._calls.get(key) if isinstance(key, str) else None
        if call is None or call.server is not client:
            raise WrongMessage(f"no service was called with the id {shown(key)}")
        try:
            self._end(str(key), values, succeeded)
        except WrongMessage as error:
            call.answer(str(error), False)
            raise

    def leave(self, client: Client) -> None:
        """The client is gone, with its services; those that wait for one are answered."""
        self._servers = {n: one for n, one in self._servers.items() if one[0] is not client}
        for key, call in tuple(self._calls.items()):
            if client in (call.server, call.caller):
                self._end(key, "the client that serves it is gone", False)

    def _end(self, key: str, values: object, succeeded: bool) -> None:
        call = self._calls.pop(key)
        call.caller.calls -= 1
        call.answer(values, succeeded)
