"""Attempts of maps, meshes and robots to reach outside their folder."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path

import cv2
import trimesh
from fault_paths import Action, Reference, Scene, attempt, ways, written
from test_world_import import ROOM, write_map

from slamsim.config.loading import load_run_config, load_world_config
from slamsim.config.robot import RobotConfig
from slamsim.sim.robot.model import build_robot
from slamsim.world.build import build_world
from slamsim.world.map_server import read_map


def _stl(folder: Path, name: str = "box.stl") -> Path:
    trimesh.creation.box((4.0, 4.0, 1.0)).export(folder / name)
    return folder / name


def _world(text: str, scene: Scene) -> Action:
    path = written(scene.inputs / "world.yaml", text)
    return lambda: build_world(load_world_config(path), 0)


@ways("the image of a map", "relative", "absolute", "winding", "link", "linked folder", "URL")
def _(scene: Scene, way: Reference) -> Action:
    write_map(scene.outside, ROOM)
    path = write_map(scene.inputs, ROOM, image=way(scene, "map.pgm"))
    return lambda: read_map(path)


@ways("the map of a world", "relative", "absolute", "link")
def _(scene: Scene, way: Reference) -> Action:
    write_map(scene.outside, ROOM)
    return _world(f"image: {{file: '{way(scene, 'map.yaml')}'}}\n", scene)


@ways("the mesh of a world", "relative", "absolute", "winding", "link", "linked folder")
def _(scene: Scene, way: Reference) -> Action:
    _stl(scene.outside)
    return _world(f"mesh: {{file: '{way(scene, 'box.stl')}'}}\n", scene)


@attempt("the map beside an image is a link")
def _(scene: Scene) -> Action:
    cv2.imwrite(str(scene.inputs / "map.png"), ROOM)
    write_map(scene.outside, ROOM)
    (scene.inputs / "map.yaml").symlink_to(scene.outside / "map.yaml")
    return lambda: build_world(load_world_config(str(scene.inputs / "map.png")), 0)


@ways("the description of a robot", "relative", "absolute", "link")
def _(scene: Scene, way: Reference) -> Action:
    written(scene.outside / "r.urdf", build_robot(RobotConfig()).urdf)
    path = written(scene.inputs / "run.yaml", f"robot: {{urdf_file: '{way(scene, 'r.urdf')}'}}\n")
    return lambda: build_robot(load_run_config(None, path).robot)


@ways("the mesh of a link of a robot", "relative", "absolute", "winding", "link", "URL")
def _(scene: Scene, way: Reference) -> Action:
    _stl(scene.outside)
    shape = f'<visual><geometry><mesh filename="{way(scene, "box.stl")}"/></geometry></visual>'
    text = build_robot(RobotConfig()).urdf
    path = scene.inputs / "r.urdf"
    path.write_text(text.replace("</link>", f"{shape}</link>", 1))
    return lambda: build_robot(RobotConfig(urdf_file=str(path)))


@attempt("an entity of a robot's XML")
def _(scene: Scene) -> Action:
    secret = scene.outside / "secret"
    secret.write_text("secret")
    text = build_robot(RobotConfig()).urdf.replace("<?xml version='1.0'?>", "")
    document = f'<!DOCTYPE robot [<!ENTITY x SYSTEM "file://{secret}">]>'
    path = scene.inputs / "r.urdf"
    path.write_text(f"{document}{text.replace('</robot>', '&x;</robot>')}")
    return lambda: build_robot(RobotConfig(urdf_file=str(path)))


@attempt("an inclusion of a robot's XML")
def _(scene: Scene) -> Action:
    (scene.outside / "part.xml").write_text("<link name='other'/>")
    namespace = "http://www.w3.org/2001/XInclude"
    include = f'<xi:include xmlns:xi="{namespace}" href="{scene.outside}/part.xml"/>'
    text = build_robot(RobotConfig()).urdf.replace("</robot>", f"{include}</robot>")
    path = scene.inputs / "r.urdf"
    path.write_text(text)
    return lambda: build_robot(RobotConfig(urdf_file=str(path)))


def _box_obj(lines: str) -> str:
    corners = ((0, 0, 0), (4, 0, 0), (0, 4, 0), (0, 0, 2))
    points = "".join(f"v {x} {y} {z}\n" for x, y, z in corners)
    return f"{lines}{points}vt 0 0\nf 1/1 3/1 2/1\nf 1/1 2/1 4/1\nf 1/1 4/1 3/1\nf 2/1 3/1 4/1\n"


@ways("the material library of an OBJ", "relative", "absolute", "link")
def _(scene: Scene, way: Reference) -> Action:
    (scene.outside / "m.mtl").write_text("newmtl a\nKd 1 0 0\n")
    text = _box_obj(f"mtllib {way(scene, 'm.mtl')}\nusemtl a\n")
    path = written(scene.inputs / "box.obj", text)
    return lambda: build_world(load_world_config(path), 0)


@ways("the texture of an OBJ", "relative", "absolute", "link")
def _(scene: Scene, way: Reference) -> Action:
    cv2.imwrite(str(scene.outside / "t.png"), ROOM)
    (scene.inputs / "m.mtl").write_text(f"newmtl a\nmap_Kd {way(scene, 't.png')}\n")
    path = written(scene.inputs / "box.obj", _box_obj("mtllib m.mtl\nusemtl a\n"))
    return lambda: build_world(load_world_config(path), 0)


@ways("the texture of a PLY", "relative", "absolute")
def _(scene: Scene, way: Reference) -> Action:
    cv2.imwrite(str(scene.outside / "t.png"), ROOM)
    header = "\n".join(
        (
            "ply",
            "format ascii 1.0",
            f"comment TextureFile {way(scene, 't.png')}",
            "element vertex 4",
            *(f"property float {name}" for name in ("x", "y", "z", "s", "t")),
            "element face 4",
            "property list uchar int vertex_indices",
            "end_header",
        )
    )
    points = "0 0 0 0 0\n4 0 0 1 0\n0 4 0 0 1\n0 0 2 1 1\n"
    faces = "3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"
    path = written(scene.inputs / "box.ply", f"{header}\n{points}{faces}")
    return lambda: build_world(load_world_config(path), 0)


def _glb(path: Path, change: Callable[[dict[str, object]], object]) -> Path:
    """A box whose JSON part was changed."""
    data = bytes(trimesh.creation.box((4.0, 1.0, 4.0)).export(file_type="glb"))
    (length,) = struct.unpack_from("<I", data, 12)
    tree, rest = json.loads(data[20 : 20 + length]), data[20 + length :]
    change(tree)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<II", len(text), 0x4E4F534A) + text + rest
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)
    return path


@ways("a buffer of a GLB", "relative", "absolute", "URL")
def _(scene: Scene, way: Reference) -> Action:
    (scene.outside / "b.bin").write_bytes(bytes(4096))
    buffers = [{"byteLength": 4096, "uri": way(scene, "b.bin")}]
    path = _glb(scene.inputs / "box.glb", lambda tree: tree.update(buffers=buffers))
    return lambda: build_world(load_world_config(str(path)), 0)


@ways("an image of a GLB", "relative", "absolute", "URL")
def _(scene: Scene, way: Reference) -> Action:
    cv2.imwrite(str(scene.outside / "t.png"), ROOM)

    def change(tree: dict[str, object]) -> None:
        tree.update(
            images=[{"uri": way(scene, "t.png")}],
            textures=[{"source": 0}],
            materials=[{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        )

    path = _glb(scene.inputs / "box.glb", change)
    return lambda: build_world(load_world_config(str(path)), 0)
