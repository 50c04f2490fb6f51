"""Hostile YAML: worlds, run configurations, recipes, measurements and faults."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import fault_doors as doors
from fault_corpus_base import Fill, Hostile, Read, one, several

_BOMB = "a: &a [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{new}: &{new} [{', '.join(10 * [f'*{old}'])}]\n"
    for old, new in zip("abcdefghi", "bcdefghij", strict=True)
)
_MERGES = "a: &a {x: 1}\n" + "".join(
    f"{new}: &{new} {{<<: [{', '.join(9 * [f'*{old}'])}], {new}: 1}}\n"
    for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)

SYNTAX: dict[str, tuple[bytes | str, str]] = {
    "alias bomb": (_BOMB, "alias"),
    "merge bomb": (_MERGES, "merge key"),
    "recursive alias": ("a: &a [*a]\n", "alias"),
    "an alias alone": ("name: &n x\nworld: *n\n", "alias"),
    "an anchor as a key": ("&a a: 1\n*a : 2\n", "alias"),
    "20,000 brackets": ("a: " + "[" * 20_000, "nested deeper"),
    "20,000 braces": ("{a: " * 20_000, "nested deeper"),
    "20,000 dashes": ("- " * 20_000, "nested deeper"),
    "33 levels": ("a: " + "[" * 33 + "]" * 33, "nested deeper than 32"),
    "5 million digits": (b"seed: " + b"7" * 5_000_000, "bytes long"),
    "a million digits": (b"seed: " + b"7" * 1_000_000, "too large"),
    "a million hexadecimal digits": (b"seed: 0x" + b"f" * 1_000_000, "too large"),
    "50 MB of text": (b"name: " + b"x" * 50_000_000, "bytes long"),
    "a long key": (b"k" * 1_000_000 + b": 1\n", "line 1"),
    "300,000 keys": ("".join(f"k{i}: 1\n" for i in range(300_000)), "bytes long"),
    "22,000 unknown keys": ("".join(f"wal{i}: 1\n" for i in range(22_000)), "did you mean"),
    "40,000 values": (f"name: [{', '.join('1' for _ in range(40_000))}]\n", "must be a text"),
    "200,000 values": (f"name: [{','.join('1' for _ in range(200_000))}]\n", "50,000 values"),
    "duplicate key": ("seed: 1\nname: a\nseed: 2\n", "twice"),
    "duplicate key below": ("maze: {rows: 3, rows: 400}\n", "twice"),
    "yes and no": ("image: no\n", "must be a mapping"),
    "number too large": ("clearance_m: 1e999\n", "too large"),
    "not a number": ("clearance_m: .nan\n", "finite"),
    "infinite": ("clearance_m: -.inf\n", "finite"),
    "300 digits of a float": ("clearance_m: " + "9" * 300 + ".0\n", "clearance_m"),
    "sexagesimal": ("seed: 190:20:30\n", "whole number"),
    "65 bits": ("seed: 18446744073709551616\n", "too large"),
    "python object": ("name: !!python/object/apply:os.system ['true']\n", "tag"),
    "python name": ("name: !!python/name:os.system\n", "tag"),
    "binary tag": ("name: !!binary aGVsbG8=\n", "tag"),
    "a local tag": ("name: !file /etc/passwd\n", "tag"),
    "NUL": (b"name: a\0b\n", "U+0000"),
    "escape character": (b"name: \x1b[31m\n", "U+001B"),
    "rubbish": (bytes(range(256)) * 16, "UTF-8"),
    "UTF-16": ("name: a\n".encode("utf-16"), "UTF-16"),
    "Latin 1": ("name: Höhle\n".encode("latin-1"), "UTF-8"),
    "lone surrogate": (b"name: \xed\xa0\x80\n", "UTF-8"),
    "tab": ("maze:\n\trows: 3\n", "tab"),
    "two documents": ("name: a\n---\nname: b\n", "second document"),
    "an unknown version": ("%YAML 9.9\n---\nname: a\n", "YAML"),
    "a list": ("- 1\n- 2\n", "a mapping"),
    "a text": ("hello\n", "a mapping"),
    "empty": ("", "is empty"),
    "only comments": ("# nothing\n" * 1000, "is empty"),
    "an open quote": ('name: "abc\n' + "x\n" * 1000, "not YAML"),
    "a long explicit key": (b"? " + b"k" * 1_000_000 + b"\n: 1\n", "a key of 1,000,000"),
    "a key that is a list": ("? [a, b]\n: 1\n", "cannot be a key"),
    "a key that is null": ("~: 1\n", "~"),
    "JSON cut off": ('{"maze": {"rows": 3, "col', "not YAML"),
    "an image of a cat": (b"\x89PNG\r\n\x1a\n" + bytes(100), "UTF-8"),
}
"""What is wrong for every YAML file: its text, and words of the refusal."""

WORLDS: dict[str, tuple[str, str]] = {
    "no such key": ("maze: {rowss: 3}\n", "rows"),
    "two layouts": ("maze: {}\nrooms: {}\n", "one layout"),
    "no layout's worth": ("maze: {rows: 0}\n", "rows"),
    "too many cells": ("maze: {rows: 400, columns: 400}\n", "40000"),
    "a true number": ("maze: {rows: true}\n", "whole number"),
    "a quoted number": ("maze: {rows: '3'}\n", "without quotes"),
    "walls thicker than cells": ("maze: {cell_m: 0.5}\nwalls: {thickness_m: 9}\n", "fit"),
    "no way through": ("maze: {}\nclearance_m: 19\n", "fit"),
    "ragged drawing": ("plan: {drawing: '+--+\n\n  |'}\n", "drawing"),
    "a drawing of a novel": (f"plan: {{drawing: '{'x' * 300_000}'}}\n", "drawing"),
    "a drawing of blanks": (f"plan: {{drawing: '{' ' * 90_000}+'}}\n", "drawing"),
    "a start in a wall": ("maze: {}\nstart: {x_m: 0, y_m: 0}\n", "clearance_m"),
    "a start beyond the stars": ("maze: {}\nstart: {x_m: 1.0e+308, y_m: -1.0e+308}\n", "start"),
    "a patch of nothing": (
        "floor: {patches: [{x_m: [1, 1], y_m: [0, 1], friction: 1}]}\n",
        "empty",
    ),
    "2,000 patches": (
        "floor: {patches: [" + "{x_m: [0, 1], y_m: [0, 1], friction: 1}," * 2000 + "]}\n",
        "patches",
    ),
    "a name of 10,000 letters": (f"name: {'n' * 10_000}\n", "200"),
    "an image in another folder": ("image: {file: ../../../../etc/hostname}\n", "hostname"),
    "an image that is a folder": ("image: {file: .}\n", "folder"),
    "a mesh of NUL": ('mesh: {file: "a\\0b.stl"}\n', "mesh"),
    "a mesh with a long name": (f"mesh: {{file: {'a' * 4000}.stl}}\n", "name"),
    "3,000 file names": ("".join(f"k{i}_file: a\n" for i in range(3_000)), "unknown key"),
    "3,000 broken file names": (
        "".join(f'k{i}_file: "\\0"\n' for i in range(3_000)),
        "must lie inside",
    ),
    "a mesh of no kind": ("mesh: {file: /dev/zero}\n", "must lie inside"),
}
"""What is wrong with a world alone."""

CONFIGS: dict[str, tuple[Fill, str]] = {
    "a preset that is itself": (one("a.yaml", "world: a.yaml\n"), "a.yaml"),
    "presets in a ring": (
        several(a__yaml="robot: b.yaml\n", b__yaml="preset: c.yaml\n", c__yaml="preset: b.yaml\n"),
        "start from one another",
    ),
    "a preset that is a list": (one("a.yaml", "robot: {preset: [1]}\n"), "name or path"),
    "a preset that is nowhere": (one("a.yaml", "robot: {preset: ../nowhere}\n"), "nowhere"),
    "a preset that is no YAML": (
        several(a__yaml="robot: b.yaml\n", b__yaml="a: [*b]\n"),
        "alias",
    ),
    "faults of no kind": (one("a.yaml", "faults: [{name: [a]}]\n"), "name"),
    "a seed below zero": (one("a.yaml", "seed: -1\n"), "seed"),
    "wheels of nothing": (one("a.yaml", "robot: {drive_wheels: {radius_m: 0}}\n"), "radius_m"),
    "a sensor of nothing": (one("a.yaml", "sensors: {lidar: {beams: 0}}\n"), "beams"),
}
"""What is wrong with a run's configuration alone; the first file is handed over."""

OTHERS: dict[str, tuple[Read, str, str]] = {
    "recipe of bombs": (doors.recipe, _BOMB, "alias"),
    "recipe of nothing": (doors.recipe, "name: a\n", "missing"),
    "recipe of a list": (doors.recipe, "[]\n", "a mapping"),
    "recipe with a wild name": (doors.recipe, "name: ../../x\nseed: 1\n", "name"),
    "measurements of bombs": (doors.measurements, _MERGES, "merge key"),
    "measurements of nothing": (doors.measurements, "name: a\nfigures: []\n", "figures"),
    "measurements of nowhere": (
        doors.measurements,
        "name: a\nfigures: [{quantity: ramp.x, value: 1, sigma: 0, source: ''}]\n",
        "quantity",
    ),
    "fault of bombs": (doors.fault, _BOMB, "alias"),
    "fault without a kind": (doors.fault, "name: a\n", "kind"),
    "fault whose kind is a list": (doors.fault, "kind: [time_offset]\n", "no kind"),
    "fault whose kind is a mapping": (doors.fault, "kind: {a: 1}\n", "kind"),
    "fault whose kind is long": (doors.fault, f"kind: {'k' * 500_000}\n", "kind"),
    "route of bombs": (doors.route, _BOMB, "alias"),
    "route of both": (doors.route, "poses: [{x_m: 1, y_m: 1}]\ntwists: []\n", ""),
    "route of numbers": (doors.route, "poses: [1, 2]\n", "poses"),
    "route of 45,000": (doors.route, f"poses: [{'{},' * 45_000}]\n", "missing"),
    "route out of time": (
        doors.route,
        "twists: [{t_s: 0, v_m_s: 1, w_rad_s: 0}, {t_s: 0, v_m_s: 0, w_rad_s: 0}]\n",
        "growing",
    ),
    "a world in YAML 1.2": (doors.world, "name: no\nseed: 017\nclearance_m: 6e-1\n", ""),
    "a world with a mark": (doors.world, "\ufeffname: a\r\nmaze: {rows: 2}\r\n", ""),
}
"""Other kinds of YAML: how they are read, and what is wrong with them."""


def _zero(folder: Path) -> None:
    one("a.yaml", "mesh: {file: zero.stl}\n")(folder)
    (folder / "zero.stl").symlink_to("/dev/zero")


def _special() -> Iterator[Hostile]:
    def pipe(folder: Path) -> None:
        os.mkfifo(folder / "a.yaml")

    def link(to: str) -> Fill:
        return lambda folder: (folder / "a.yaml").symlink_to(to)

    world, command = doors.world, ("world",)
    yield Hostile("a pipe", "a.yaml", pipe, world, "pipe", command)
    yield Hostile("a device", "a.yaml", link("/dev/zero"), world, "device", command)
    yield Hostile("a ring of links", "a.yaml", link("a.yaml"), world, "a.yaml", command)
    yield Hostile("a link to nothing", "a.yaml", link("nothing"), world, "a.yaml", command)
    yield Hostile("a folder", ".", lambda _: None, world, "folder", command)
    yield Hostile("a mesh without end", "a.yaml", _zero, world, "must lie inside", command)


def hostile_yaml() -> Iterator[Hostile]:
    """All of it."""
    for number, (name, (text, words)) in enumerate(SYNTAX.items()):
        command = ("world",) if number % 8 == 0 else ()
        yield Hostile(f"YAML: {name}", "a.yaml", one("a.yaml", text), doors.world, words, command)
    for number, (name, (text, words)) in enumerate(WORLDS.items()):
        command = ("world",) if number % 5 == 0 else ()
        yield Hostile(f"world: {name}", "a.yaml", one("a.yaml", text), doors.world, words, command)
    for name, (fill, words) in CONFIGS.items():
        yield Hostile(name, "a.yaml", fill, doors.config, words)
    for name, (read, text, words) in OTHERS.items():
        yield Hostile(name, "a.yaml", one("a.yaml", text), read, words)
    yield from _special()
