"""Services: those of the robot, those that clients serve to each other, and what rosapi tells."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from slamsim.guard.errors import SlamsimError, shown
from slamsim.io.bag2.writer import described
from slamsim.io.ros.values import WrongMessage, known_type, type_details
from slamsim.live import requests
from slamsim.live.controls import Controls
from slamsim.live.requests import SERVICES
from slamsim.live.servers.rosbridge.client import Client
from slamsim.live.servers.rosbridge.topics import Topics

Arguments = Mapping[str, Any]
Service = tuple[str, Callable[[Arguments], Mapping[str, Any]]]
"""Its type and what it does; raises SlamsimError."""

NODE, ROSAPI = "/slamsim", "/rosapi"
_SET_RATE = "slamsim_msgs/srv/SetRate"


def robot_services(controls: Controls) -> Mapping[str, Service]:
    """By name. Each may take as long as what it asks for takes; what the robot refuses is no fault
    of the call: ``success`` is false, with the reason as ``message``."""
    services = {**SERVICES, f"{NODE}/set_rate": requests.Service(_SET_RATE, _set_rate)}
    return {name: (one.type_name, _told(controls, one)) for name, one in services.items()}


def _told(controls: Controls, service: requests.Service) -> Callable[[Arguments], Arguments]:
    def call(given: Arguments) -> Arguments:
        try:
            return {"success": True, "message": service.call(controls, given)}
        except SlamsimError as error:
            return {"success": False, "message": str(error)}

    return call


def _set_rate(controls: Controls, given: Arguments) -> str:
    """What Foxglove has a parameter for: times real time, null for as fast as possible."""
    rate = given.get("rate")
    if isinstance(rate, bool) or not isinstance(rate, int | float | None):
        raise WrongMessage(f"rate must be a number or null, not {shown(rate)}")
    controls.set_rate(None if rate is None else float(rate))
    return "as fast as possible" if rate is None else f"{rate:g} times real time"


def _text(given: Arguments, name: str) -> str:
    value = given.get(name)
    if not isinstance(value, str):
        raise WrongMessage(f"{name}: a string is needed, not {shown(value)}")
    return value


class Rosapi:
    """What clients ask before they subscribe; types of ``rosapi_msgs``.

    services: all that may be called, with their types.
    """

    def __init__(
        self, topics: Topics, now_ns: Callable[[], int], services: Callable[[], Mapping[str, str]]
    ) -> None:
        self._topics, self._now_ns, self._services = topics, now_ns, services

    def services(self) -> Mapping[str, Service]:
        """By name."""
        table: Mapping[str, Callable[[Arguments], Mapping[str, Any]]] = {
            "Topics": self._all_topics,
            "TopicsAndRawTypes": self._topics_and_raw_types,
            "TopicType": self._topic_type,
            "TopicsForType": self._topics_for_type,
            "Publishers": self._publishers,
            "Subscribers": self._subscribers,
            "MessageDetails": lambda given: {"typedefs": type_details(_text(given, "type"))},
            "Nodes": lambda _: {"nodes": [NODE, ROSAPI]},
            "NodeDetails": self._node_details,
            "Services": lambda _: {"services": sorted(self._services())},
            "ServiceType": lambda given: {
                "type": self._services().get(_text(given, "service"), "")
            },
            "ServicesForType": self._services_for_type,
            "GetTime": self._time,
            "GetROSVersion": lambda _: {"version": 2, "distro": "jazzy"},
            "GetParamNames": lambda _: {"names": []},
            "ActionServers": lambda _: {"action_servers": []},
        }
        names = {"GetROSVersion": "get_ros_version"}
        return {
            f"{ROSAPI}/{names.get(name, _snake(name))}": (f"rosapi_msgs/srv/{name}", call)
            for name, call in table.items()
        }

    def _all_topics(self, _: Arguments) -> Mapping[str, Any]:
        kinds = sorted(self._topics.kinds().values(), key=lambda kind: kind.name)
        return {"topics": [k.name for k in kinds], "types": [k.type_name for k in kinds]}

    def _topics_and_raw_types(self, given: Arguments) -> Mapping[str, Any]:
        told = self._all_topics(given)
        return {**told, "typedefs_full_text": [described(name)[1] for name in told["types"]]}

    def _topic_type(self, given: Arguments) -> Mapping[str, Any]:
        kind = self._topics.kinds().get(_text(given, "topic"))
        return {"type": kind.type_name if kind else ""}

    def _topics_for_type(self, given: Arguments) -> Mapping[str, Any]:
        wanted = known_type(_text(given, "type"))
        kinds = self._topics.kinds().values()
        return {"topics": sorted(kind.name for kind in kinds if kind.type_name == wanted)}

    def _publishers(self, given: Arguments) -> Mapping[str, Any]:
        known = _text(given, "topic") in self._topics.kinds()
        return {"publishers": [NODE] if known else []}

    def _subscribers(self, given: Arguments) -> Mapping[str, Any]:
        return {"subscribers": [NODE] if self._topics.subscribers(_text(given, "topic")) else []}

    def _node_details(self, given: Arguments) -> Mapping[str, Any]:
        mine = _text(given, "node") == NODE
        names = sorted(self._topics.kinds())
        services = [name for name in sorted(self._services()) if name.startswith(f"{NODE}/")]
        return {
            "subscribing": [],
            "publishing": names if mine else [],
            "services": services if mine else [],
        }

    def _services_for_type(self, given: Arguments) -> Mapping[str, Any]:
        wanted = _text(given, "type").replace("/srv/", "/")
        named = self._services().items()
        return {"services": sorted(n for n, kind in named if kind.replace("/srv/", "/") == wanted)}

    def _time(self, _: Arguments) -> Mapping[str, Any]:
        sec, nanosec = divmod(self._now_ns(), 10**9)
        return {"time": {"sec": sec, "nanosec": nanosec, "secs": sec, "nsecs": nanosec}}


def _snake(name: str) -> str:
    return "".join(f"_{c.lower()}" if c.isupper() else c for c in name).lstrip("_")


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
