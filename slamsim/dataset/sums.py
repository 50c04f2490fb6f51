"""``SHA256SUMS``: what the files beside the sequences must be; ``sha256sum -c`` reads it, too.

Those of the sequences stand in each ``sequence.json``, whose own hash stands in the manifest.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping

SUMS = "SHA256SUMS"
_OWN = "# of the lines above: "
_LINE = re.compile(r"([0-9a-f]{64})  ([^\n]+)")


class SumsDamaged(ValueError):
    """The file is not as it was written."""


def sums_text(hashes: Mapping[str, str]) -> str:
    """path -> SHA-256 in hexadecimal. Its last line, a comment, vouches for the others."""
    lines = "".join(f"{hashes[path]}  {path}\n" for path in sorted(hashes))
    return f"{lines}{_OWN}{hashlib.sha256(lines.encode()).hexdigest()}\n"


def read_sums(data: bytes) -> dict[str, str]:
    """Raises SumsDamaged unless every byte is as ``sums_text`` wrote it."""
    text = data.decode("utf-8", "replace")
    lines = map(_LINE.fullmatch, text.split("\n"))
    hashes = {line[2]: line[1] for line in lines if line is not None}
    if sums_text(hashes).encode() != data:
        raise SumsDamaged(f"{SUMS} is not as it was written")
    return hashes
