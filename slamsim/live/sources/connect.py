"""Which protocol a server speaks."""

from __future__ import annotations

from urllib.parse import urlsplit

from websockets.exceptions import InvalidHandshake, InvalidStatus, WebSocketException

from slamsim.guard.errors import InputRefused, reason_of, shown
from slamsim.live.sources.foxglove import SUBPROTOCOLS, FoxgloveSource
from slamsim.live.sources.rosbridge import RosbridgeSource
from slamsim.live.sources.source import LiveSource, Tell, connected


def open_source(url: str, tell: Tell) -> LiveSource:
    """The server at a URL, not connected yet: its block connects.

    A server of the Foxglove protocol picks one of its subprotocols; one of rosbridge has none, or
    refuses them. tell: gets a sentence each when the connection breaks, or messages are left out.
    Raises InputRefused for no such URL, and where nothing answers.
    """
    _require_url(url)
    try:
        with connected(url, SUBPROTOCOLS) as connection:
            speaks_foxglove = connection.subprotocol in SUBPROTOCOLS
    except InvalidStatus as error:
        if error.response.status_code in (401, 403):
            body = (error.response.body or b"").decode(errors="replace").strip()
            raise InputRefused(url, f"the server refuses: {shown(body, 200)}") from None
        speaks_foxglove = False
    except InvalidHandshake:
        speaks_foxglove = False
    except (WebSocketException, OSError, EOFError) as error:
        raise InputRefused(url, f"nothing answers there: {reason_of(error)}") from None
    return FoxgloveSource(url, tell) if speaks_foxglove else RosbridgeSource(url, tell)


def _require_url(url: str) -> None:
    try:
        parts = urlsplit(url)
        valid = parts.scheme in ("ws", "wss") and bool(parts.hostname) and (parts.port or 1) > 0
    except ValueError:
        valid = False
    if not valid:
        raise InputRefused(url, "an address such as ws://robot:9090 or ws://robot:8765 is needed")
