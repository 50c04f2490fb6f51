"""Meshes from outside: nothing reaches an engine that would crash it or be taken for empty."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from fault_corpus_meshes import glb
from limited_child import run_limited
from lowered_limits import lowered
from numpy.typing import NDArray

from slamsim.guard.errors import InputRefused, NotFound
from slamsim.guard.mesh import check_mesh
from slamsim.guard.mesh_file import check_mesh_file

HERE = Path("world.stl")
CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def changed(array: NDArray[Any], index: tuple[int, int], value: float) -> NDArray[Any]:
    copy = array.copy()
    copy[index] = value
    return copy


def test_a_tetrahedron_passes() -> None:
    check_mesh(CORNERS, FACES, HERE)
    check_mesh(CORNERS.astype(np.float32), FACES.astype(np.uint32), HERE)


@pytest.mark.parametrize(
    ("vertices", "triangles", "words"),
    [
        (CORNERS, changed(FACES, (2, 1), 4), "triangle 2: names the vertices [0, 4, 2]"),
        (CORNERS, changed(FACES, (1, 0), -7), "triangle 1"),
        (changed(CORNERS, (3, 2), np.nan), FACES, "vertex 3: 1 vertices are not finite"),
        (changed(CORNERS, (0, 0), np.inf), FACES, "vertex 0"),
        (changed(CORNERS, (1, 0), 1e30), FACES, "vertex 1: lies 1e+30 m out"),
        (CORNERS[:0], FACES[:0], "0 vertices and 0 triangles"),
        (CORNERS, FACES[:0], "4 vertices and 0 triangles"),
        (CORNERS[:, :2], FACES, "shape (4, 2)"),
        (CORNERS, FACES.ravel(), "shape (12,)"),
        (CORNERS, FACES.astype(float), "whole numbers"),
        (np.zeros((4, 3)), FACES, "lines or points"),
        (CORNERS * [1, 0, 0], FACES, "lines or points"),
    ],
)
def test_what_would_crash_an_engine_is_refused(
    vertices: NDArray[Any], triangles: NDArray[Any], words: str
) -> None:
    with pytest.raises(InputRefused) as caught:
        check_mesh(vertices, triangles, HERE)
    assert words in str(caught.value)


def test_a_mesh_has_a_size_limit() -> None:
    with pytest.raises(InputRefused, match="4 triangles, at most 3"), lowered(mesh_triangles=3):
        check_mesh(CORNERS, FACES, HERE)


def exported(kind: str, **options: str) -> bytes:
    mesh = trimesh.Trimesh(CORNERS, FACES, process=False)
    data = mesh.export(file_type=kind, **options)
    assert isinstance(data, str | bytes)
    return data.encode() if isinstance(data, str) else data


SAMPLES: dict[str, Callable[[], bytes]] = {
    "binary.stl": lambda: exported("stl"),
    "text.stl": lambda: exported("stl_ascii"),
    "mesh.obj": lambda: exported("obj"),
    "binary.ply": lambda: exported("ply"),
    "text.ply": lambda: exported("ply", encoding="ascii"),
    "mesh.glb": lambda: exported("glb"),
}


@pytest.mark.parametrize("name", SAMPLES)
def test_whole_files_pass(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(SAMPLES[name]())
    check_mesh_file(path)


@pytest.mark.parametrize("name", [name for name in SAMPLES if name != "mesh.obj"])
def test_cut_files_are_refused(tmp_path: Path, name: str) -> None:
    path, data = tmp_path / name, SAMPLES[name]()
    for end in range(0, len(data) - 16, 7):
        path.write_bytes(data[:end])
        with pytest.raises(InputRefused):
            check_mesh_file(path)


VIEW = {"buffer": 0, "byteOffset": 0, "byteLength": 36}
ACCESSOR = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}
FLOOD = b"ply\nformat binary_little_endian 1.0\nelement vertex 2000000000\nproperty float x\n"


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("a.stl", b"", "is empty"),
        ("a.stl", b"\0" * 80 + struct.pack("<I", 2**32 - 1), "announces 4,294,967,295 triangles"),
        ("a.stl", b"\0" * 84, "announces 0 triangles"),
        ("a.obj", b"v 0 0 0\n", "not one line is a face"),
        ("a.obj", b"\0\0\0", "NUL"),
        ("a.ply", FLOOD + b"element face 1\nproperty list uchar int i\nend_header\n", "bytes, has"),
        ("a.ply", FLOOD + b"end_header\n", "vertex and face are needed"),
        ("a.ply", b"ply\nelement vertex -3\nend_header\n", "header is damaged"),
        ("a.ply", b"plx", "is no PLY"),
        ("a.glb", b"glTF" + struct.pack("<II", 2, 0xFFFFFFF0) + b"12", "is no GLB"),
        ("a.glb", glb({}, length=0xFFFFFFF0), "announces version 2 and 4,294,967,280 bytes"),
        ("a.glb", glb({"buffers": [{"uri": "../x.bin"}]}), "lie in another file"),
        ("a.glb", glb({"images": [{"uri": "file:///etc/passwd"}]}), "lie in another file"),
        ("a.glb", glb({"bufferViews": [VIEW]}, b"\0" * 32), "bufferView 0: reaches to byte 36"),
        (
            "a.glb",
            glb({"bufferViews": [VIEW], "accessors": [{**ACCESSOR, "count": 4}]}, b"\0" * 36),
            "accessor 0: announces 48 bytes, its view has 36",
        ),
        (
            "a.glb",
            glb({"accessors": [{"componentType": 5126, "count": 400_000_000, "type": "VEC3"}]}),
            "accessor 0: announces 4,800,000,000 bytes",
        ),
        ("a.glb", glb({"nodes": [{"children": [1]}, {"children": [0]}]}), "form a ring"),
        ("a.glb", glb({"nodes": [{}, {"children": [1]}]}), "form a ring"),
        ("a.glb", glb({"nodes": [{"children": [1, 1]}, {}]}), "do not form a tree"),
        ("a.glb", glb({"nodes": [{"children": [9]}]}), "do not form a tree"),
        ("a.glb", glb([1, 2]), "damaged"),
        ("a.glb", glb({"accessors": [{"count": "many"}]}), "damaged"),
        ("a.off", b"OFF", "none of the mesh formats"),
        ("a.gltf", b"{}", "none of the mesh formats"),
    ],
)
def test_announced_and_absent(tmp_path: Path, name: str, data: bytes, words: str) -> None:
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(InputRefused) as caught:
        check_mesh_file(path)
    assert words in str(caught.value)


def test_missing_and_oversized_files(tmp_path: Path) -> None:
    with pytest.raises(NotFound):
        check_mesh_file(tmp_path / "absent.stl")
    path = tmp_path / "a.obj"
    path.write_bytes(exported("obj"))
    with pytest.raises(InputRefused, match="at most 10 are read"), lowered(mesh_file_bytes=10):
        check_mesh_file(path)


def test_mutated_files_pass_or_are_refused_and_never_flood(tmp_path: Path) -> None:
    dice = random.Random(11)
    for name, sample in SAMPLES.items():
        data = sample()
        for number in range(40):
            broken = bytearray(data)
            for _ in range(dice.randrange(1, 8)):
                broken[dice.randrange(len(data))] = dice.randrange(256)
            (tmp_path / f"{number}_{name}").write_bytes(broken)
    (tmp_path / "deep.glb").write_bytes(
        b"glTF" + struct.pack("<IIII", 2, 20 + 400_000, 400_000, 0x4E4F534A) + b"[" * 400_000
    )
    done = run_limited(
        """
        import sys
        from pathlib import Path
        from slamsim.guard.errors import InputRefused
        from slamsim.guard.mesh_file import check_mesh_file
        for path in sorted(Path(sys.argv[1]).iterdir()):
            try:
                check_mesh_file(path)
                print("passed")
            except InputRefused:
                print("refused")
        """,
        str(tmp_path),
    )
    assert len(done.stdout.split()) == 40 * len(SAMPLES) + 1
