"""Hostile text: CARMEN logs plain and packed, trajectories, relations, routes; and saved maps."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator

import fault_doors as doors
import numpy as np
from fault_corpus_bags import log
from fault_corpus_base import Data, Hostile, Read, bz2_of, gz, gz_of, one

_MIB = 1 << 20
_LINE = b"FLASER 3 1.0 2.0 3.0 0 0 0 0 0 0 %d.5 host %d.5\n"
_LOG = b"".join(_LINE % (i, i) for i in range(40))

LOGS: dict[str, tuple[str, Data, str]] = {
    "gzip of 3 GB in a line": ("a.clf.gz", lambda: gz_of(bytes(8 * _MIB), 400), "NUL"),
    "gzip of 3 GB of blanks": ("a.clf.gz", lambda: gz_of(b" " * (8 * _MIB), 400), "longer than"),
    "gzip of 3 GB of lines": (
        "a.clf.gz",
        lambda: gz_of(b"\n" * (8 * _MIB), 400),
        "unpacks to more",
    ),
    "bzip2 of 800 MB in a line": (
        "a.clf.bz2",
        lambda: bz2_of(b" " * (8 * _MIB), 100),
        "longer than",
    ),
    "bzip2 of 800 MB of lines": (
        "a.clf.bz2",
        lambda: bz2_of((b"# " + b"x" * 97 + b"\n") * 80_000, 100),
        "unpacks to more",
    ),
    "gzip cut off": ("a.clf.gz", gz(_LOG)[:-30], "cut off"),
    "gzip of rubbish": ("a.clf.gz", gz(_LOG)[:40] + bytes(99), "damaged"),
    "gzip with a tail": ("a.clf.gz", gz(_LOG) + b"rubbish", "damaged"),
    "gzip that is plain": ("a.clf.gz", _LOG, ""),
    "bzip2 cut off": ("a.clf.bz2", lambda: bz2_of(_LOG, 1)[:-9], "cut off"),
    "bzip2 with a tail": ("a.clf.bz2", lambda: bz2_of(_LOG, 1) + b"rubbish", "damaged"),
    "gzip in gzip": ("a.clf.gz", gz(gz(_LOG)), "a.clf.gz"),
    "a line of 100 MB": ("a.clf", lambda: b"FLASER 1 " + b"9" * 100_000_000, "longer than"),
    "NUL in a log": ("a.clf", _LOG + b"\0", "NUL"),
    "a log of nothing": ("a.clf", b"", "a.clf"),
    "a log of prose": ("a.clf", b"to be or not to be\n" * 999, "a.clf"),
    "a log of 10^9 beams": ("a.clf", b"FLASER 1000000000 1.0\n" * 9, "a.clf"),
    "a log of -1 beams": ("a.clf", b"FLASER -1 1.0\n" * 9, "a.clf"),
    "a log of nan": ("a.clf", _LOG.replace(b"2.0", b"nan"), ""),
    "a log of nan poses": (
        "a.clf",
        _LOG.replace(b" 0 0 0 0 0 0 ", b" nan nan nan 0 0 0 "),
        "a.clf",
    ),
    "a log without time": ("a.clf", (_LINE % (5, 5)) * 40, ""),
    "a log out of time": ("a.clf", _LOG.replace(b"7.5 host", b"1e300 host"), ""),
}

TABLES: dict[str, tuple[Read, str, Data, str]] = {
    "poses of nan": (doors.tum, "t.tum", b"1 nan 0 0 0 0 0 1\n", "line 1"),
    "poses of words": (doors.tum, "t.tum", b"one 2 3 4 5 6 7 8\n", "line 1"),
    "poses of 10^400": (doors.tum, "t.tum", b"1e400 0 0 0 0 0 0 1\n", "line 1"),
    "poses of a million digits": (
        doors.tum,
        "t.tum",
        b"9" * 1_000_000 + b" 0 0 0 0 0 0 1",
        "line 1",
    ),
    "poses out of time": (doors.tum, "t.tum", b"2 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", "line 2"),
    "poses that do not turn": (doors.tum, "t.tum", b"1 0 0 0 0 0 0 0\n", "length 0"),
    "poses of nothing": (doors.tum, "t.tum", b"# none\n", "no pose"),
    "poses of 1e308": (doors.tum, "t.tum", b"1 1e308 0 0 1e308 0 0 1e308\n", "line 1"),
    "relations of nan": (doors.relations, "a.relations", b"1 2 nan 0 0 0 0 0\n", "line 1"),
    "relations of seven": (doors.relations, "a.relations", b"1 2 3 0 0 0 0\n", "7 words"),
    "relations of nothing": (doors.relations, "a.relations", b"", "no relation"),
    "relations without end": (
        doors.relations,
        "a.relations",
        lambda: gz_of(b" " * (8 * _MIB), 400),
        "longer than",
    ),
    "route of other columns": (doors.route, "r.csv", b"a,b\n1,2\n", "columns"),
    "route of words": (doors.route, "r.csv", b"x_m,y_m\none,two\n", "finite numbers"),
    "route of inf": (doors.route, "r.csv", b"x_m,y_m\n1e999,2\n", "finite numbers"),
    "route beyond the stars": (doors.route, "r.csv", b"x_m,y_m\n1e300,2\n", "beyond"),
    "route of 200,000 rows": (
        doors.route,
        "r.csv",
        lambda: b"x_m,y_m\n" + b"1,2\n" * 200_000,
        "at most",
    ),
}


def _zip(compression: int, **members: bytes) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", compression) as archive:
        for name, data in members.items():
            archive.writestr(f"{name}.npy", data)
    return file.getvalue()


def _npy(array: object) -> bytes:
    file = io.BytesIO()
    np.save(file, np.asarray(array))
    return file.getvalue()


def _pickled() -> bytes:
    file = io.BytesIO()
    np.save(file, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    return file.getvalue()


_FORMAT = _npy([2, 1, 0])
MAPS: dict[str, tuple[Data, str]] = {
    "saved map of nothing": (b"", "no map"),
    "saved map of rubbish": (b"PK\3\4" + bytes(99), "no map"),
    "saved map that unpacks to 1 GB": (
        lambda: _zip(zipfile.ZIP_DEFLATED, format=_FORMAT, poses=bytes(200 * _MIB)),
        "compressed",
    ),
    "saved map of code": (_zip(zipfile.ZIP_STORED, format=_FORMAT, poses=_pickled()), "no map"),
    "saved map of other arrays": (_zip(zipfile.ZIP_STORED, format=_FORMAT), "no map"),
    "saved map of the future": (_zip(zipfile.ZIP_STORED, format=_npy([99, 1, 0])), "format"),
    "saved map of 10^12 key frames": (
        _zip(zipfile.ZIP_STORED, format=_npy([2, 10**12, 0]), poses=_npy(np.zeros((1, 3)))),
        "no map",
    ),
    "saved map of -1 key frames": (
        _zip(zipfile.ZIP_STORED, format=_npy([2, -1, 0]), poses=_npy(np.zeros((0, 3)))),
        "no map",
    ),
    "saved map of a shape without end": (
        _zip(
            zipfile.ZIP_STORED,
            format=_npy(np.zeros(3)).replace(
                b"'shape': (3,), }        ", b"'shape': (9999999999,)}"
            ),
        ),
        "no map",
    ),
}


def hostile_texts() -> Iterator[Hostile]:
    """All of them."""
    for number, (name, (file, data, words)) in enumerate(LOGS.items()):
        command = ("map",) if number % 7 == 0 else ()
        yield Hostile(name, file, one(file, data), log, words, command)
    for name, (read, file, data, words) in TABLES.items():
        yield Hostile(name, file, one(file, data), read, words)
    for name, (data, words) in MAPS.items():
        yield Hostile(name, "session.npz", one("session.npz", data), doors.saved_map, words)
