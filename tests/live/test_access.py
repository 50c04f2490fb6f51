"""Who may connect: hosts, origins, tokens."""

from __future__ import annotations

import pytest

from slamsim.live.servers.access import Access

HERE = "127.0.0.1:8765"


@pytest.mark.parametrize(
    "origin", [None, "http://localhost:3000", "http://127.0.0.1:8000", "http://[::1]:1", "file://"]
)
def test_this_machine_may(origin: str | None) -> None:
    assert Access().refusal(HERE, origin, None) is None


@pytest.mark.parametrize(
    "origin",
    [
        "null",
        "",
        "https://app.example.com",
        "http://127.0.0.1.example.com",
        "file://host",
        "http://[",
    ],
)
def test_pages_from_elsewhere_may_not(origin: str) -> None:
    assert "may not connect" in (Access().refusal(HERE, origin, None) or "")


def test_a_name_that_resolves_to_this_machine_may_not() -> None:
    assert "not this machine" in (Access().refusal("evil.example.com", None, None) or "")


def test_others_need_the_token() -> None:
    access = Access.at("0.0.0.0")
    assert access.token
    assert access.refusal("robot:8765", None, access.token) is None
    assert access.refusal("robot:8765", "http://robot:8000", access.token) is None
    for token in (None, "", access.token[:-1], "é"):
        assert "token" in (access.refusal("robot:8765", None, token) or "")
