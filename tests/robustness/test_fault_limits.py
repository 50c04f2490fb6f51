"""Every field of the one table of limits refuses something, and the refusal names it."""

from __future__ import annotations

import gzip
import json
import struct
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import trimesh
from bag_data import ROS1, ROS2, Robot, as_mcap, as_ros1, as_rosbag2
from lowered_limits import lowered
from mcap.writer import CompressionType, Writer

from slamsim.config.layout import ImageLayout
from slamsim.guard.errors import InputRefused
from slamsim.guard.files import read_input
from slamsim.guard.limits import LIMITS, Limits
from slamsim.guard.mesh import check_mesh
from slamsim.guard.mesh_file import check_mesh_file
from slamsim.guard.pictures import read_gray_image
from slamsim.guard.seal import require_as_written, sums_text
from slamsim.guard.unpacking import open_lines, unpack
from slamsim.guard.urdf import check_urdf
from slamsim.guard.yaml import load_yaml
from slamsim.io.bag1.reader import index_bag1
from slamsim.io.bag2.sqlite import index_sqlite
from slamsim.io.input_errors import as_input_errors
from slamsim.io.mcap.reader import index_mcap, mcap_attachments
from slamsim.io.parquet.file import read_table
from slamsim.io.ros.message_types import check_definitions
from slamsim.sim.drive.route_file import read_route
from slamsim.slam.mapping.saved_map import read_saved_map
from slamsim.world.map_server import image_prisms

pytestmark = pytest.mark.fault

Excess = Callable[[Path], object]
CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
LINK = '<link name="a"><inertial><mass value="9"/></inertial></link>'

TURNING = (
    '<link name="b"/><joint name="j" type="continuous"><parent link="a"/><child link="b"/></joint>'
)


def put(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def packed_bag(folder: Path) -> None:
    path = put(folder / "a.bag.gz", gzip.compress(bytes(100)))
    unpack(path, folder / "a.bag")


def yaml(text: str) -> Excess:
    return lambda folder: load_yaml(put(folder / "a.yaml", text.encode()))


def text(data: bytes) -> Excess:
    return lambda folder: list(open_lines(put(folder / "a.log", data)))


def image(folder: Path) -> object:
    data = cv2.imencode(".png", np.zeros((8, 8, 3), np.uint8))[1].tobytes()
    return read_gray_image(put(folder / "a.png", data))


def map_image(folder: Path) -> object:
    walls = np.full((8, 8), 255, np.uint8)
    walls[2:6, 2:6], walls[3:5, 3:5] = 0, 255
    put(folder / "map.png", cv2.imencode(".png", walls)[1].tobytes())
    described = "resolution: 1.0\norigin: [0, 0, 0]\nnegate: 0\n"
    thresholds = "occupied_thresh: 0.6\nfree_thresh: 0.2\n"
    text = f"image: map.png\n{described}{thresholds}"
    path = put(folder / "map.yaml", text.encode())
    return image_prisms(ImageLayout(file=str(path)), 1.0)


def mesh(folder: Path) -> None:
    check_mesh(CORNERS, FACES, folder / "a.stl")


def mesh_file(folder: Path) -> None:
    scene = json.dumps({"asset": {"version": "2.0"}}).encode()
    head = struct.pack("<4sIIII", b"glTF", 2, 20 + len(scene), len(scene), 0x4E4F534A)
    check_mesh_file(put(folder / "a.glb", head + scene))


def obj(folder: Path) -> None:
    check_mesh_file(put(folder / "a.obj", b"v 0 0 0\n" * 3 + b"f 1 2 3 1 2 3\n"))


def collada(folder: Path) -> None:
    path = put(folder / "a.dae", b"<COLLADA><a><b/></a></COLLADA>")
    check_mesh_file(path, (".dae",))


def unrolled(folder: Path) -> None:
    scene = trimesh.Scene([trimesh.Trimesh(CORNERS, FACES) for _ in range(5)])
    data = scene.export(file_type="glb")  # type: ignore[no-untyped-call]
    check_mesh_file(put(folder / "a.glb", bytes(data)))


def urdf(folder: Path) -> None:
    check_urdf(f'<robot name="r">{LINK}{TURNING}</robot>', folder / "a.urdf")


def chunk(folder: Path) -> object:
    path = as_mcap(folder / "a.mcap", Robot(ROS2).drive(), CompressionType.ZSTD)
    return index_mcap(path)


def attachment(folder: Path) -> object:
    path = folder / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.add_attachment(0, 0, "notes.txt", "text/plain", bytes(100))
        writer.finish()  # type: ignore[no-untyped-call]
    with as_input_errors(path, "attachments"):
        return list(mcap_attachments(index_mcap(path)))


def table(folder: Path) -> object:
    path = folder / "a.parquet"
    pq.write_table(pa.table({"a": np.zeros(10_000)}), path, compression="zstd")
    with as_input_errors(path, "its columns"):
        return read_table(path)


def definition(text: str) -> Excess:
    def check(folder: Path) -> None:
        with as_input_errors(folder, "message definitions"):
            check_definitions([("a/msg/B", text)])

    return check


def sums(folder: Path) -> None:
    put(folder / "SHA256SUMS", sums_text({}).encode())
    require_as_written(put(folder / "map.pgm", b"P5"))


def many_rows(folder: Path) -> object:
    rows = "1,2\n" * (LIMITS.route_rows + 1)
    return read_route(put(folder / "a.csv", f"x_m,y_m\n{rows}".encode()))


PACKED = gzip.compress(b"0" * 99 + b"\n" * 5000)
BOMB = gzip.compress(b"\n" * 100_000)

EXCESS: dict[str, tuple[Excess, dict[str, float]]] = {
    "yaml_bytes": (yaml("a: 1"), {"yaml_bytes": 3}),
    "yaml_depth": (yaml("[[[]]]"), {"yaml_depth": 2}),
    "yaml_nodes": (yaml("[1, 2, 3]"), {"yaml_nodes": 3}),
    "yaml_key_characters": (yaml("abc: 1"), {"yaml_key_characters": 2}),
    "text_line_bytes": (text(b"12345\n"), {"text_line_bytes": 4}),
    "text_total_bytes": (text(b"12345\n"), {"text_total_bytes": 5}),
    "text_ratio": (text(PACKED), {"text_ratio": 5, "text_ratio_floor_bytes": 1000}),
    "text_ratio_floor_bytes": (text(PACKED), {"text_ratio_floor_bytes": 10, "text_ratio": 1}),
    "text_lines_per_byte": (text(BOMB), {"text_lines_per_byte": 9, "text_lines_floor": 999}),
    "text_lines_floor": (text(BOMB), {"text_lines_floor": 999}),
    "image_file_bytes": (image, {"image_file_bytes": 20}),
    "image_pixels": (image, {"image_pixels": 63}),
    "image_decoded_bytes": (image, {"image_decoded_bytes": 191}),
    "image_corners": (map_image, {"image_corners": 7}),
    "mesh_file_bytes": (mesh_file, {"mesh_file_bytes": 19}),
    "mesh_header_bytes": (mesh_file, {"mesh_header_bytes": 9}),
    "mesh_line_bytes": (obj, {"mesh_line_bytes": 8}),
    "mesh_vertices": (mesh, {"mesh_vertices": 3}),
    "mesh_triangles": (mesh, {"mesh_triangles": 3}),
    "mesh_parts": (unrolled, {"mesh_parts": 4}),
    "mesh_depth": (collada, {"mesh_depth": 2}),
    "mesh_coordinate_m": (mesh, {"mesh_coordinate_m": 0.5}),
    "urdf_bytes": (urdf, {"urdf_bytes": 20}),
    "urdf_depth": (urdf, {"urdf_depth": 2}),
    "urdf_elements": (urdf, {"urdf_elements": 3}),
    "urdf_links": (urdf, {"urdf_links": 0}),
    "urdf_moving_joints": (urdf, {"urdf_moving_joints": 0}),
    "urdf_name_characters": (urdf, {"urdf_name_characters": 0}),
    "urdf_number": (urdf, {"urdf_number": 8.5}),
    "sums_bytes": (sums, {"sums_bytes": 20}),
    "route_rows": (many_rows, {}),
    "saved_map_bytes": (
        lambda folder: read_saved_map(put(folder / "map.npz", bytes(9))),
        {"saved_map_bytes": 8},
    ),
    "json_bytes": (
        lambda folder: read_input(put(folder / "a.json", bytes(9)), "json_bytes"),
        {"json_bytes": 8},
    ),
    "attachment_bytes": (attachment, {"attachment_bytes": 99}),
    "unpacked_file_bytes": (packed_bag, {"unpacked_file_bytes": 99}),
    "bag_chunk_bytes": (chunk, {"bag_chunk_bytes": 3000}),
    "bag_ratio": (chunk, {"bag_ratio": 1, "bag_ratio_floor_bytes": 0}),
    "bag_ratio_floor_bytes": (chunk, {"bag_ratio_floor_bytes": 999, "bag_ratio": 1}),
    "bag_record_bytes": (
        lambda folder: index_bag1(as_ros1(folder / "a", Robot(ROS1).drive())),
        {"bag_record_bytes": 60},
    ),
    "table_ratio": (table, {"table_ratio": 1, "table_ratio_floor_bytes": 0}),
    "table_ratio_floor_bytes": (table, {"table_ratio_floor_bytes": 99, "table_ratio": 1}),
    "bag_definition_characters": (definition("int8 a\n"), {"bag_definition_characters": 6}),
    "bag_definition_fields": (definition("int8 a\nint8 b\n"), {"bag_definition_fields": 1}),
    "bag_array_elements": (definition("int8[8] a\n"), {"bag_array_elements": 7}),
}
FLOORS = {
    "text_ratio_floor_bytes": "text_ratio",
    "text_lines_floor": "text_lines_per_byte",
    "bag_ratio_floor_bytes": "bag_ratio",
    "table_ratio_floor_bytes": "table_ratio",
}


def test_each_field_of_the_table_is_exceeded_here() -> None:
    assert set(EXCESS) == {field.name for field in fields(Limits)}


@pytest.mark.parametrize("name", EXCESS)
def test_a_refusal_names_the_limit(name: str, tmp_path: Path) -> None:
    exceed, lower = EXCESS[name]
    with pytest.raises(InputRefused) as caught, lowered(**lower):
        exceed(tmp_path)
    assert caught.value.limit == FLOORS.get(name, name)


@pytest.mark.parametrize("name", sorted(EXCESS.keys() - {"route_rows", "saved_map_bytes"}))
def test_within_the_limits_the_same_is_no_excess(name: str, tmp_path: Path) -> None:
    try:
        EXCESS[name][0](tmp_path)
    except InputRefused as refusal:
        assert refusal.limit == ""


def test_sqlite_messages_have_the_same_limit(tmp_path: Path) -> None:
    path = next(as_rosbag2(tmp_path / "a", Robot(ROS2).drive()).glob("*.db3"))
    with pytest.raises(InputRefused) as caught, lowered(bag_record_bytes=50):
        index_sqlite(path)
    assert caught.value.limit == "bag_record_bytes"
