"""Messages of a blocking stream that ends anywhere."""

from __future__ import annotations

import io

import pytest

from slamsim.process.pipe import packed, read_message


def test_a_stream_that_ends_within_a_message_has_ended() -> None:
    whole = packed({"a": list(range(200))})
    assert read_message(io.BytesIO(whole)) == {"a": list(range(200))}
    for length in (0, 3, 20, len(whole) - 1):
        with pytest.raises(EOFError):
            read_message(io.BytesIO(whole[:length]))
