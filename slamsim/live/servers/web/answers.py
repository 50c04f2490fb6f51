"""Answers of the page's server to plain HTTP requests: the page, a recording as one zip file that
is made while it is sent, or why not."""

from __future__ import annotations

import base64
import hashlib
import secrets
from collections.abc import Iterable, Iterator
from dataclasses import replace
from email.utils import formatdate
from functools import cache
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from importlib.resources import files
from io import RawIOBase
from pathlib import Path
from urllib.parse import parse_qs
from zipfile import ZIP_STORED, ZipFile, ZipInfo

from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from slamsim.guard.files import open_as_found
from slamsim.live.servers.access import Access
from slamsim.live.servers.access import refusal as refusal_of

_COMMON = (
    ("Cache-Control", "no-store"),
    ("X-Content-Type-Options", "nosniff"),
    ("Referrer-Policy", "no-referrer"),
    ("Cross-Origin-Resource-Policy", "same-origin"),
    ("Connection", "close"),
)

_ASK_FOR_TOKEN = """<!doctype html><html lang="en"><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1"><title>slamsim live</title>
<style>{style}</style><main class="ask"><h1>slamsim live</h1><p>This robot asks for a token. Open
the address that <code>slamsim live</code> printed, or type the token here.</p>
<form><label for="token">Token</label>
<input id="token" name="token" type="password" required autofocus autocomplete="off">
<button>Connect</button></form></main></html>
"""


@cache
def _asset(name: str) -> str:
    return files("slamsim.live.servers.web").joinpath(name).read_text(encoding="utf-8")


@cache
def page() -> str:
    """The whole page as one text, for there is nothing else that a browser may load."""
    parts = (("style", "page.css"), ("script", "page.js"))
    text = _asset("index.html")
    for tag, name in parts:
        text = text.replace(f"<{tag}></{tag}>", f"<{tag}>{_asset(name)}</{tag}>")
    return text


@cache
def _policy() -> str:
    """Content-Security-Policy: what is in the page by its hash, and nothing from elsewhere."""
    hashes = {}
    for name in ("page.css", "page.js"):
        digest = hashlib.sha256(_asset(name).encode()).digest()
        hashes[name] = f"'sha256-{base64.b64encode(digest).decode()}'"
    return (
        f"default-src 'none'; script-src {hashes['page.js']}; style-src {hashes['page.css']}; "
        "connect-src 'self'; img-src data:; form-action 'self'; base-uri 'none'; "
        "frame-ancestors 'none'"
    )


def answer(
    status: HTTPStatus, text: str, kind: str = "text/plain", more: Iterable[tuple[str, str]] = ()
) -> Response:
    body = text.encode()
    headers = [
        ("Date", formatdate(usegmt=True)),
        ("Content-Type", f"{kind}; charset=utf-8"),
        ("Content-Length", str(len(body))),
        ("Content-Security-Policy", _policy()),
        *_COMMON,
        *more,
    ]
    return Response(status.value, status.phrase, Headers(headers), body)


def page_answer() -> Response:
    return answer(HTTPStatus.OK, page(), "text/html")


def refusal(access: Access, request: Request, cookie: str) -> Response | None:
    """The answer to a request that is not let in, None for one that is. cookie: the name of the one
    that may hold the token, for a browser sends no other header with a WebSocket."""
    if reason := refusal_of(replace(access, token=None), request):
        return answer(HTTPStatus.FORBIDDEN, f"Refused: {reason}.\n")
    kept = access.refusal(request.headers["Host"], None, _cookie(request, cookie))
    if kept is not None and refusal_of(access, request):
        text = _ASK_FOR_TOKEN.format(style=_asset("page.css"))
        return answer(HTTPStatus.UNAUTHORIZED, text, "text/html")
    return None


def has_query_token(request: Request) -> bool:
    return "token" in parse_qs(request.path.partition("?")[2])


def _cookie(request: Request, name: str) -> str | None:
    try:
        cookies = SimpleCookie("; ".join(request.headers.get_all("Cookie")))
    except CookieError:
        return None
    return cookies[name].value if name in cookies else None


def keep_token(token: str, cookie: str) -> Response:
    """Sends a browser to the page without the token in its address, which it keeps as a cookie
    that scripts cannot read. Lax: it is there when a link from elsewhere opens the page, and is
    not sent with what a page from elsewhere loads."""
    kept = f"{cookie}={token}; Path=/; HttpOnly; SameSite=Lax"
    return answer(HTTPStatus.SEE_OTHER, "", more=[("Location", "/"), ("Set-Cookie", kept)])


def zip_head(name: str) -> bytes:
    """What goes before a recording, whose size is not known yet."""
    plain = "".join(c if c.isascii() and (c.isalnum() or c in "-_.") else "_" for c in name)
    headers = [
        *_COMMON,
        ("Content-Type", "application/zip"),
        ("Content-Disposition", f'attachment; filename="{plain}.zip"'),
        ("Transfer-Encoding", "chunked"),
    ]
    return b"HTTP/1.1 200 OK\r\n" + Headers(headers).serialize()


def in_chunks(pieces: Iterator[bytes]) -> Iterator[bytes]:
    """The chunked coding of RFC 9112, section 7.1: without a last chunk it was cut."""
    for piece in pieces:
        if piece:
            yield b"%x\r\n%b\r\n" % (len(piece), piece)
    yield b"0\r\n\r\n"


_CHUNK_BYTES = 1 << 18


class Recordings:
    """Folders that the controls named since the server started. Others cannot be asked for: a
    client knows them by random identifiers alone."""

    def __init__(self) -> None:
        self._folders: dict[str, Path] = {}
        self._current: Path | None = None

    def note(self, current: Path | None) -> None:
        """The folder that is being written by now, if any."""
        self._current = current
        if current is not None and current not in self._folders.values():
            self._folders[secrets.token_urlsafe(16)] = current

    def finished(self) -> dict[str, Path]:
        """By identifier, the newest first. A folder has its name when it is whole."""
        whole = {
            key: folder
            for key, folder in self._folders.items()
            if folder != self._current and folder.is_dir()
        }
        return dict(reversed(whole.items()))


def zipped(folder: Path) -> Iterator[bytes]:
    """A zip file of a folder, piece by piece, with no more than a piece in memory.

    Its files are stored as they are: recordings are compressed already. Links are left out, so that
    nothing from outside the folder is in it.
    """
    sink = _Pieces()
    with ZipFile(sink, "w", ZIP_STORED) as archive:
        for path in sorted(folder.rglob("*")):
            if path.is_symlink() or not path.is_file():
                continue
            place = Path(folder.name) / path.relative_to(folder)
            info = ZipInfo.from_file(path, place.as_posix(), strict_timestamps=False)
            with open_as_found(path) as source, archive.open(info, "w", force_zip64=True) as entry:
                while piece := source.read(_CHUNK_BYTES):
                    entry.write(piece)
                    yield sink.taken()  # never empty: it holds the piece
    yield sink.taken()


class _Pieces(RawIOBase):
    """A stream that cannot be sought, whose bytes are taken from it as they come."""

    def __init__(self) -> None:
        self._held = bytearray()

    def writable(self) -> bool:
        return True

    def write(self, data: bytes | bytearray | memoryview) -> int:  # type: ignore[override]
        self._held += data
        return len(data)

    def taken(self) -> bytes:
        taken = bytes(self._held)
        self._held.clear()
        return taken
