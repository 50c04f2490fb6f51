"""Mesh files of users: declared sizes are checked against the file before a library reads it.

Twenty-two bytes of GLB made a loader claim 4 GB; a cut PLY came back with made-up vertices.
Only formats that hold everything in one file are read; COLLADA (.dae) only for robots, whose
meshes are copied and shown and never computed with.
"""

from __future__ import annotations

import io
import json
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, ParseError

from defusedxml import DefusedXmlException
from defusedxml.ElementTree import iterparse

from slamsim.guard.errors import InputRefused
from slamsim.guard.files import read_input
from slamsim.guard.limits import LIMITS

_OBJ_ZERO = re.compile(rb"^[ \t]*f[ \t](?:[^\n]*[ \t])?[-+]?0+(?=[/\s]|\Z)", re.MULTILINE)
_STL_HEADER, _STL_TRIANGLE = 84, 50
_GLB_JSON, _GLB_BINARY = 0x4E4F534A, 0x004E4942
_GLB_SIZES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
_GLB_COUNTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_PLY_SIZES = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "int32", "uint32", "float", "float32"), 4),
    **dict.fromkeys(("double", "float64"), 8),
}


WORLD_MESHES = (".stl", ".obj", ".ply", ".glb")


def check_mesh_file(path: Path, suffixes: tuple[str, ...] = WORLD_MESHES) -> None:
    """Raise unless the file is whole by its own counts, and of one of these kinds.

    Raises NotFound, or InputRefused naming what is announced and what is there. What the
    library makes of the file still goes through ``check_mesh``.
    """
    checks: dict[str, Callable[[bytes, Path], None]] = {
        ".stl": _check_stl,
        ".obj": _check_obj,
        ".ply": _check_ply,
        ".glb": _check_glb,
        ".dae": _check_dae,
    }
    suffix = path.suffix.lower()
    if suffix not in suffixes:
        raise InputRefused(path, f"is none of the mesh formats {', '.join(suffixes)}")
    data = read_input(path, "mesh_file_bytes")
    if not data:
        raise InputRefused(path, "is empty")
    checks[suffix](data, path)


def _check_dae(data: bytes, path: Path) -> None:
    """Well-formed XML without entities, read element by element: no tree of it is kept."""
    unfinished, root = list[Element](), ""
    try:
        for event, element in iterparse(io.BytesIO(data), ("start", "end"), forbid_dtd=True):
            root = root or element.tag
            if event == "start":
                unfinished.append(element)
            else:
                unfinished.pop()
                if unfinished:
                    unfinished[-1].clear()
            if len(unfinished) > LIMITS.mesh_depth:
                reason = f"is nested deeper than {LIMITS.mesh_depth} levels"
                raise InputRefused(path, reason, limit="mesh_depth")
    except (ParseError, DefusedXmlException, ValueError) as error:
        raise InputRefused(path, f"is refused as XML: {error}") from None
    if root.rpartition("}")[2] != "COLLADA":
        raise InputRefused(path, f"begins with <{root[:60]}>, a COLLADA file with <COLLADA>")


def _check_stl(data: bytes, path: Path) -> None:
    if data.lstrip()[:5].lower() == b"solid" and b"facet" in data[:4096]:
        facets, ends = data.count(b"endfacet"), data.rstrip()[-4096:].count(b"endsolid")
        if facets == 0 or ends == 0:
            raise InputRefused(path, f"is cut off: {facets} whole facets and no 'endsolid'")
        return
    if len(data) < _STL_HEADER:
        raise InputRefused(path, f"is no STL: {len(data)} bytes, the header alone has 84")
    (count,) = struct.unpack_from("<I", data, _STL_HEADER - 4)
    needed = _STL_HEADER + count * _STL_TRIANGLE
    if len(data) != needed or count == 0:
        reason = f"announces {count:,} triangles ({needed:,} bytes), has {len(data):,} bytes"
        raise InputRefused(path, reason)


def _check_obj(data: bytes, path: Path) -> None:
    if b"\0" in data:
        raise InputRefused(path, "is no OBJ: it holds NUL bytes")
    for kind in (rb"v", rb"f"):
        if not re.search(rb"^[ \t]*" + kind + rb"[ \t]", data, re.MULTILINE):
            what = "vertex (v)" if kind == b"v" else "face (f)"
            raise InputRefused(path, f"is no OBJ, or is cut off: not one line is a {what}")
    longest = LIMITS.mesh_line_bytes
    if long := re.search(rb"[^\n]{%d}" % (longest + 1), data):
        line = data.count(b"\n", 0, long.start()) + 1
        reason = f"a line is longer than {longest:,} bytes"
        raise InputRefused(path, reason, f"line {line}", limit="mesh_line_bytes")
    if zero := _OBJ_ZERO.search(data):
        line = data.count(b"\n", 0, zero.start()) + 1
        raise InputRefused(path, "names the vertex 0, the first one is 1", f"line {line}")


def _check_ply(data: bytes, path: Path) -> None:
    end = re.search(rb"^end_header\r?\n", data[: LIMITS.mesh_header_bytes], re.MULTILINE)
    if not data.startswith(b"ply") or end is None:
        reason = "is no PLY: the header from 'ply' to 'end_header' is not whole"
        limit = "mesh_header_bytes" if len(data) > LIMITS.mesh_header_bytes else ""
        raise InputRefused(path, reason, limit=limit)
    lines = data[: end.start()].decode("ascii", errors="replace").splitlines()
    is_text = any(line.split()[:2] == ["format", "ascii"] for line in lines)
    least, announced = _ply_least_bytes(lines, is_text, path)
    if "vertex" not in announced or "face" not in announced:
        raise InputRefused(
            path, f"has the elements {sorted(announced)}, vertex and face are needed"
        )
    body = data[end.end() :]
    if len(body) < least:
        reason = f"announces {announced}, at least {least:,} bytes, has {len(body):,}"
        raise InputRefused(path, reason)
    rows, needed = body.rstrip().count(b"\n") + 1, sum(announced.values())
    if is_text and rows < needed:
        raise InputRefused(path, f"announces {needed:,} lines of data, has {rows:,}")


def _ply_least_bytes(lines: list[str], is_text: bool, path: Path) -> tuple[int, dict[str, int]]:
    """The fewest bytes that the announced elements need, and how many of each there are."""
    announced: dict[str, int] = {}
    least = row = count = 0
    for line in [*lines, "element end 0"]:
        match line.split():
            case ["element", name, number] if number.isdecimal() and len(number) < 16:
                least += count * row
                row, count = 0, int(number)
                announced[name] = count
            case ["element", *_]:
                raise InputRefused(path, f"the PLY header is damaged: {line[:60]!r}")
            case ["property", "list", count_type, item_type, name]:
                items = 3 if name.startswith("vertex_ind") else 0  # no face has fewer corners
                sizes = (_PLY_SIZES.get(kind, 1) for kind in (count_type, *items * [item_type]))
                row += 2 * (1 + items) if is_text else sum(sizes)
            case ["property", number_type, _]:
                row += 2 if is_text else _PLY_SIZES.get(number_type, 1)
    del announced["end"]
    return max(least - 1, 0) if is_text else least, announced


def _check_glb(data: bytes, path: Path) -> None:
    if len(data) < 20 or data[:4] != b"glTF":
        raise InputRefused(path, "is no GLB: the header is not there")
    version, length, json_length, kind = struct.unpack_from("<IIII", data, 4)
    if version != 2 or length != len(data):
        reason = f"announces version {version} and {length:,} bytes, has {len(data):,} bytes"
        raise InputRefused(path, reason)
    if kind != _GLB_JSON or 20 + json_length > len(data):
        raise InputRefused(path, f"its description of {json_length:,} bytes is not in the file")
    if json_length > LIMITS.mesh_header_bytes:
        reason = f"has a description of {json_length:,} bytes, at most "
        reason += f"{LIMITS.mesh_header_bytes:,} are read"
        raise InputRefused(path, reason, limit="mesh_header_bytes")
    try:
        scene = json.loads(data[20 : 20 + json_length])
        _check_unrolled(scene, path)
        _check_scene(scene, _glb_binary_bytes(data, 20 + json_length), path)
    except (ValueError, RecursionError, KeyError, TypeError, AttributeError, IndexError) as error:
        raise InputRefused(path, f"its description is damaged ({error!r:.80})") from None


def _glb_binary_bytes(data: bytes, offset: int) -> int:
    if offset + 8 > len(data):
        return 0
    length, kind = struct.unpack_from("<II", data, offset)
    return length if kind == _GLB_BINARY and offset + 8 + length <= len(data) else 0


def _check_scene(scene: dict[str, list[dict[str, object]]], binary: int, path: Path) -> None:
    for kind in ("buffers", "images"):
        if any("uri" in entry for entry in scene.get(kind, [])):
            raise InputRefused(path, f"its {kind} lie in another file; one that holds all is read")
    views = scene.get("bufferViews", [])
    for number, view in enumerate(views):
        start, length = (_count(view.get(key, 0)) for key in ("byteOffset", "byteLength"))
        if start + length > binary:
            reason = f"reaches to byte {start + length:,}, there are {binary:,}"
            raise InputRefused(path, reason, f"bufferView {number}")
    for number, accessor in enumerate(scene.get("accessors", [])):
        size = _GLB_SIZES[int(str(accessor["componentType"]))]
        needed = _count(accessor["count"]) * size * _GLB_COUNTS[str(accessor["type"])]
        view_index = accessor.get("bufferView")
        available = 0 if view_index is None else _count(views[_count(view_index)]["byteLength"])
        if needed > available:
            reason = f"announces {needed:,} bytes, its view has {available:,}"
            raise InputRefused(path, reason, f"accessor {number}")
    _check_nodes(scene.get("nodes", []), path)


def _check_unrolled(scene: dict[str, list[dict[str, Any]]], path: Path) -> None:
    """What all nodes hold together: one mesh may stand in many places."""
    accessors = scene.get("accessors", [])
    sizes = []
    for mesh in scene.get("meshes", []):
        parts = vertices = triangles = 0
        for part in mesh["primitives"]:
            corners = _count(accessors[_count(part["attributes"]["POSITION"])]["count"])
            listed = part.get("indices")
            indices = corners if listed is None else _count(accessors[_count(listed)]["count"])
            parts, vertices, triangles = parts + 1, vertices + corners, triangles + indices // 3
        sizes.append((parts, vertices, triangles))
    nodes = scene.get("nodes", [])
    shown = [sizes[_count(node["mesh"])] for node in nodes if "mesh" in node]
    totals = [len(nodes), *(sum(column) for column in zip(*shown, strict=True))]
    for name, total in zip(("parts", "parts", "vertices", "triangles"), totals, strict=False):
        most = getattr(LIMITS, f"mesh_{name}")
        if total > most:
            reason = f"unrolls to {total:,} {name}, at most {most:,} are read"
            raise InputRefused(path, reason, limit=f"mesh_{name}")


def _check_nodes(nodes: list[dict[str, object]], path: Path) -> None:
    """Trees: a ring of nodes, or a node with two parents, would be unrolled for ever."""
    children = [node.get("children", []) for node in nodes]
    below = [[_count(child) for child in own] if isinstance(own, list) else [] for own in children]
    linked = [child for own in below for child in own]
    if len(set(linked)) < len(linked) or max(linked, default=-1) >= len(nodes):
        raise InputRefused(path, "its nodes do not form a tree: one has two parents, or is missing")
    open_ends = list(set(range(len(nodes))) - set(linked))
    reached = 0
    while open_ends:
        open_ends.extend(below[open_ends.pop()])
        reached += 1
    if reached < len(nodes):
        raise InputRefused(path, "its nodes form a ring")


def _count(value: object) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise ValueError(f"{value!r} is not a count")
    return value
