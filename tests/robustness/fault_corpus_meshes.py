"""Hostile meshes, each as the world of a robot."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Iterator
from typing import Any

import fault_doors as doors
import numpy as np
import trimesh
from fault_corpus_base import Data, Hostile, several
from fault_corpus_images import _zeros, png
from numpy.typing import NDArray


def _at(place: tuple[float, float, float]) -> NDArray[np.float64]:
    T = np.eye(4)
    T[:3, 3] = place
    return T


def hall() -> trimesh.Trimesh:
    """Four walls of 6 by 6 m, 1 m high, and nothing else."""
    walls = [
        trimesh.creation.box((6.2, 0.2, 1.0), _at(place))
        for place in ((0.0, 3.0, 0.5), (0.0, -3.0, 0.5))
    ]
    walls += [
        trimesh.creation.box((0.2, 5.8, 1.0), _at(place))
        for place in ((3.0, 0.0, 0.5), (-3.0, 0.0, 0.5))
    ]
    joined = trimesh.util.concatenate(walls)
    assert isinstance(joined, trimesh.Trimesh)
    return joined


def exported(kind: str, **options: Any) -> bytes:
    """The hall as a file of this kind."""
    data = hall().export(file_type=kind, **options)
    return data.encode() if isinstance(data, str) else bytes(data)


STL, OBJ, PLY, GLB = (exported(kind) for kind in ("stl", "obj", "ply", "glb"))
TEXT_STL, TEXT_PLY = exported("stl_ascii"), exported("ply", encoding="ascii")


def glb(scene: object, binary: bytes = b"", length: int | None = None) -> bytes:
    """A GLB of a description and what it points to."""
    text = json.dumps(scene).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<II", len(text), 0x4E4F534A) + text
    if binary:
        body += struct.pack("<II", len(binary), 0x004E4942) + binary
    return b"glTF" + struct.pack("<II", 2, 12 + len(body) if length is None else length) + body


def glb_parts(data: bytes = GLB) -> tuple[dict[str, Any], bytes]:
    """The description of a GLB and what it points to."""
    (length,) = struct.unpack_from("<I", data, 12)
    return json.loads(data[20 : 20 + length]), data[28 + length :]


def _scene(**changes: Any) -> bytes:
    scene, binary = glb_parts()
    return glb({**scene, **changes}, binary)


def _accessor(number: int, **changes: Any) -> bytes:
    scene, binary = glb_parts()
    scene["accessors"][number].update(changes)
    return glb(scene, binary)


def _instances(count: int) -> bytes:
    """One mesh at so many places."""
    scene, binary = glb_parts()
    nodes = [{"children": list(range(1, count + 1))}, *({"mesh": 0} for _ in range(count))]
    return glb({**scene, "nodes": nodes, "scenes": [{"nodes": [0]}], "scene": 0}, binary)


def _primitives(count: int) -> bytes:
    scene, binary = glb_parts()
    scene["meshes"][0]["primitives"] *= count
    return glb(scene, binary)


def _chain(count: int) -> bytes:
    scene, binary = glb_parts()
    nodes: list[dict[str, Any]] = [{"children": [i + 1]} for i in range(count)]
    nodes.append({"mesh": 0})
    return glb({**scene, "nodes": nodes, "scenes": [{"nodes": [0]}], "scene": 0}, binary)


def _textured() -> bytes:
    """The hall under a picture of 900 million pixels."""
    scene, binary = glb_parts()
    picture = png(30_000, 30_000, _zeros(900))
    view = {"buffer": 0, "byteOffset": len(binary), "byteLength": len(picture)}
    binary += picture + bytes(-len(picture) % 4)
    scene["bufferViews"].append(view)
    scene["buffers"][0]["byteLength"] = len(binary)
    scene["images"] = [{"bufferView": len(scene["bufferViews"]) - 1, "mimeType": "image/png"}]
    scene["textures"] = [{"source": 0}]
    scene["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
    scene["meshes"][0]["primitives"][0]["material"] = 0
    return glb(scene, binary)


def _ply(vertices: int, faces: int, form: str = "binary_little_endian", body: bytes = b"") -> bytes:
    lines = [f"ply\nformat {form} 1.0\nelement vertex {vertices}"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"element face {faces}\nproperty list uchar int vertex_indices\nend_header\n"]
    return "\n".join(lines).encode() + body


def _stl_vertex(value: float) -> bytes:
    data = bytearray(STL)
    struct.pack_into("<f", data, 84 + 12 + 50 * 3, value)
    return bytes(data)


_CORNERS = b"".join(struct.pack("<fff", *v) for v in ((0, 0, 0), (1, 0, 0), (0, 0, 1)))
_FACE = struct.pack("<Biii", 3, 0, 1, 2)


def _below() -> bytes:
    sunk = hall()
    sunk.apply_translation((0, 0, -5))
    data = sunk.export(file_type="stl")
    assert isinstance(data, bytes)
    return data


def _glb_text(text: bytes) -> bytes:
    return b"glTF" + struct.pack("<IIII", 2, 20 + len(text), len(text), 0x4E4F534A) + text


MESHES: dict[str, tuple[str, Data, str]] = {
    "STL cut off": ("m.stl", STL[: len(STL) // 2], "announces"),
    "STL of 4 billion triangles": ("m.stl", bytes(80) + b"\xff" * 4, "announces 4,294,967,295"),
    "STL of none": ("m.stl", bytes(84), "announces 0"),
    "STL of one byte": ("m.stl", b"s", "no STL"),
    "STL, empty": ("m.stl", b"", "is empty"),
    "STL with nan": ("m.stl", _stl_vertex(float("nan")), "not finite"),
    "STL with inf": ("m.stl", _stl_vertex(float("-inf")), "not finite"),
    "STL beyond the stars": ("m.stl", _stl_vertex(3e38), "m out"),
    "STL with the least number": ("m.stl", _stl_vertex(1e-45), ""),
    "STL flat as a line": ("m.stl", STL[:80] + struct.pack("<I", 2) + bytes(100), "lines or"),
    "STL with a tail": ("m.stl", STL + b"x" * 1000, "announces"),
    "STL in words, cut off": ("m.stl", TEXT_STL[: len(TEXT_STL) // 2], "cut off"),
    "STL in words, with nan": (
        "m.stl",
        TEXT_STL.replace(b"3.", b"nan", 1) if b"3." in TEXT_STL else TEXT_STL,
        "m.stl",
    ),
    "STL in words, a facet of 4": (
        "m.stl",
        TEXT_STL.replace(b"endloop", b"vertex 0 0 0\nendloop", 1),
        "m.stl",
    ),
    "STL under the floor": ("m.stl", _below, "below the floor"),
    "OBJ cut off": ("m.obj", OBJ[: OBJ.index(b"\nf ")], "face"),
    "OBJ with a corner too high": ("m.obj", OBJ + b"f 1 2 99999\n", "m.obj"),
    "OBJ with a corner of -7": ("m.obj", OBJ + b"f -999999 1 2\n", "m.obj"),
    "OBJ with corner 0": ("m.obj", OBJ + b"f 0 1 2\n", "vertex 0"),
    "OBJ with a corner of 10^30": ("m.obj", OBJ + b"f 1 2 " + b"9" * 30 + b"\n", "m.obj"),
    "OBJ with nan": ("m.obj", b"v nan nan nan\n" + OBJ, "not finite"),
    "OBJ with 1e999": ("m.obj", b"v 1e999 0 0\n" + OBJ, "not finite"),
    "OBJ with words": ("m.obj", b"v one two three\n" + OBJ, "m.obj"),
    "OBJ of two dimensions": (
        "m.obj",
        b"v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n",
        "shape (3, 2)",
    ),
    "OBJ with NUL": ("m.obj", OBJ + b"\0", "NUL"),
    "OBJ with materials elsewhere": (
        "m.obj",
        b"mtllib ../../../../etc/passwd\nmtllib /etc/passwd\nusemtl a\n" + OBJ,
        "",
    ),
    "OBJ with a long line": ("m.obj", OBJ + b"f" + b" 1" * 500_000 + b"\n", "a line is longer"),
    "OBJ with a face of 400 corners": (
        "m.obj",
        OBJ + b"f" + b"".join(b" %d" % (1 + i % 32) for i in range(400)) + b"\n",
        "",
    ),
    "OBJ with 200,000 groups": ("m.obj", OBJ + b"g a\nusemtl b\n" * 100_000, ""),
    "OBJ that continues its lines": ("m.obj", OBJ + b"f 1 2 \\\n 3\n", ""),
    "PLY of 2 billion corners": ("m.ply", _ply(2_000_000_000, 1), "announces"),
    "PLY of 10^15 corners": ("m.ply", _ply(10**15, 1), "header is damaged"),
    "PLY of 10^40 corners": ("m.ply", _ply(10**40, 1), "header is damaged"),
    "PLY of -1 corners": ("m.ply", _ply(-1, 1), "header is damaged"),
    "PLY cut off": ("m.ply", PLY[:-40], "announces"),
    "PLY in words, cut off": ("m.ply", TEXT_PLY[: -len(TEXT_PLY) // 3], "announces"),
    "PLY with a face of 255 corners": (
        "m.ply",
        _ply(3, 1, body=_CORNERS + b"\xff" + _FACE[1:]),
        "m.ply",
    ),
    "PLY with a corner out of range": (
        "m.ply",
        _ply(3, 1, body=_CORNERS + struct.pack("<Biii", 3, 0, 1, 3)),
        "m.ply",
    ),
    "PLY with a corner of -1": (
        "m.ply",
        _ply(3, 1, body=_CORNERS + struct.pack("<Biii", 3, 0, 1, -1)),
        "m.ply",
    ),
    "PLY of an unknown type": (
        "m.ply",
        PLY.replace(b"property float x", b"property quad x", 1),
        "m.ply",
    ),
    "PLY without an end": ("m.ply", b"ply\nformat ascii 1.0\n" + b"comment x\n" * 99, "end_header"),
    "PLY with a header of 20 MB": (
        "m.ply",
        lambda: b"ply\n" + b"comment x\n" * 2_000_000,
        "header",
    ),
    "PLY with 100,000 properties": (
        "m.ply",
        PLY.replace(b"property float x", b"property float x\n" + b"property char a\n" * 100_000, 1),
        "m.ply",
    ),
    "PLY with its axes twice": (
        "m.ply",
        PLY.replace(b"property float y", b"property float x", 1),
        "m.ply",
    ),
    "GLB of 22 bytes that says 4 GB": (
        "m.glb",
        b"glTF" + struct.pack("<II", 2, 0xFFFFFFF0) + bytes(10),
        "announces",
    ),
    "GLB cut off": ("m.glb", GLB[:-40], "announces"),
    "GLB of version 1": ("m.glb", b"glTF\1\0\0\0" + GLB[8:], "version 1"),
    "GLB of 400,000 brackets": ("m.glb", lambda: _glb_text(b"[" * 400_000), "damaged"),
    "GLB that is a number": ("m.glb", glb(7), "damaged"),
    "GLB of nothing": ("m.glb", glb({"asset": {"version": "2.0"}}), "m.glb"),
    "GLB of 400 million zeros": ("m.glb", _accessor(0, count=400_000_000), "unrolls"),
    "GLB of sparse zeros": (
        "m.glb",
        glb({"accessors": [{"componentType": 5126, "count": 10**9, "type": "VEC3", "sparse": {}}]}),
        "announces",
    ),
    "GLB whose view starts late": ("m.glb", _accessor(1, byteOffset=10**9), "m.glb"),
    "GLB of an unknown number": ("m.glb", _accessor(1, componentType=7), "damaged"),
    "GLB of words": ("m.glb", _accessor(1, type="WORDS"), "damaged"),
    "GLB in another file": ("m.glb", _scene(buffers=[{"uri": "../x.bin"}]), "another file"),
    "GLB with a file of the machine": (
        "m.glb",
        _scene(images=[{"uri": "file:///etc/passwd"}]),
        "another file",
    ),
    "GLB with an address": ("m.glb", _scene(images=[{"uri": "http://a.b/c"}]), "another file"),
    "GLB with data in its description": (
        "m.glb",
        _scene(buffers=[{"uri": "data:," + base64.b64encode(bytes(99)).decode()}]),
        "another file",
    ),
    "GLB of nodes in a ring": (
        "m.glb",
        _scene(nodes=[{"children": [1]}, {"children": [0]}]),
        "ring",
    ),
    "GLB of 1,000 nodes in a chain": ("m.glb", _chain(1000), ""),
    "GLB of one mesh 100,000 times": ("m.glb", lambda: _instances(100_000), "parts"),
    "GLB of one part 50,000 times": ("m.glb", lambda: _primitives(50_000), "parts"),
    "GLB under a large picture": ("m.glb", _textured, ""),
    "GLB with a node of nan": (
        "m.glb",
        _scene(nodes=[{"mesh": 0, "matrix": [float("nan")] * 16}], scenes=[{"nodes": [0]}]),
        "m.glb",
    ),
    "GLB with a node of 10^300": (
        "m.glb",
        _scene(nodes=[{"mesh": 0, "translation": [1e300, 0, 0]}], scenes=[{"nodes": [0]}]),
        "m out",
    ),
    "GLB with a node of words": (
        "m.glb",
        _scene(nodes=[{"mesh": 0, "matrix": "round"}], scenes=[{"nodes": [0]}]),
        "m.glb",
    ),
    "glTF in words": ("m.gltf", json.dumps(glb_parts()[0]), "none of the mesh formats"),
    "OFF": ("m.off", "OFF\n999999999 1 0\n", "none of the mesh formats"),
    "COLLADA": ("m.dae", "<COLLADA/>", "none of the mesh formats"),
}


def hostile_meshes() -> Iterator[Hostile]:
    """All of them."""
    for number, (name, (file, data, words)) in enumerate(MESHES.items()):
        fill = several(a__yaml=f"mesh: {{file: {file}}}\n", **{file.replace(".", "__"): data})
        command = ("world",) if number % 9 == 0 else ()
        yield Hostile(name, "a.yaml", fill, doors.driven_world, words, command)
