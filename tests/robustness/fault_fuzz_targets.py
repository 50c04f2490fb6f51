"""Every loader as a function of the bytes of its file.

None raises anything but SlamsimError, and each asserts that what it reads is sane.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import trimesh
from fault_fuzz import Read, Target, as_file, folder, texts
from fault_fuzz_logs import LOG_TARGETS

from slamsim.config.base import Config
from slamsim.config.bundled import bundled_folder
from slamsim.config.loading import validated, with_presets
from slamsim.config.merging import mount, parse_override
from slamsim.config.robot import RobotConfig
from slamsim.config.run import RunConfig
from slamsim.config.world import WorldConfig
from slamsim.dataset.catalogue.statistics import manifest
from slamsim.dataset.make.identity import Identity, read_identity
from slamsim.dataset.make.shard import made_row
from slamsim.dataset.recipe.model import Recipe
from slamsim.dataset.recipe.sequence import Cell, SequenceSpec
from slamsim.dataset.store.lazy_table import rows_to_parquet, table_from_parquet, table_to_parquet
from slamsim.dataset.store.place import Location
from slamsim.dataset.store.reader import open_dataset
from slamsim.guard.mesh import check_mesh
from slamsim.guard.mesh_file import check_mesh_file
from slamsim.guard.pictures import read_gray_image
from slamsim.guard.seal import SumsDamaged, read_sequence, read_sums, sequence_text, sums_text
from slamsim.guard.urdf import check_urdf
from slamsim.guard.yaml import load_yaml, parse_yaml
from slamsim.io.input_errors import as_input_errors
from slamsim.io.text.keyframes import HEADER, read_keyframes
from slamsim.io.text.relations import read_relations
from slamsim.io.text.tum import read_tum
from slamsim.sim.drive.route_file import read_route
from slamsim.sim.robot.model import build_robot
from slamsim.sim.robot.urdf import read_description
from slamsim.slam.mapping.saved_map import read_saved_map
from slamsim.world.map_server import read_cells


def _bundled(*kinds: str) -> Callable[[], Iterable[bytes]]:
    return lambda: [
        path.read_bytes()
        for kind in kinds
        for path in sorted(bundled_folder(kind).glob("*.yaml"))[:12]  # type: ignore[arg-type]
    ]


def _model(model: type[Config]) -> Callable[[bytes], object]:
    """What the text of a file says, as this model."""

    def run(data: bytes) -> object:
        text = data.decode("utf-8", "replace")
        tree = mount(parse_yaml(text, Path("a.yaml")))
        return validated(model, with_presets(tree) if model is RunConfig else tree)

    return run


MESHES = ("stl", "obj", "ply", "glb")


def _mesh(data: bytes) -> None:
    suffix = MESHES[data[0] % len(MESHES)] if data else "stl"
    path = folder() / f"a.{suffix}"
    path.write_bytes(data[1:])
    check_mesh_file(path)
    with as_input_errors(path, "the library"):
        found = trimesh.load_scene(path, process=False).to_mesh()
        check_mesh(np.array(found.vertices), np.array(found.faces, dtype=np.int64), path)


def _meshes() -> Iterable[bytes]:
    box = trimesh.creation.box((1.0, 2.0, 3.0))
    for number, suffix in enumerate(MESHES):
        data = box.export(file_type=suffix)
        yield bytes([number]) + (data.encode() if isinstance(data, str) else bytes(data))
    ascii_stl = box.export(file_type="stl_ascii")
    yield b"\0" + (ascii_stl.encode() if isinstance(ascii_stl, str) else bytes(ascii_stl))


def _urdf(data: bytes) -> object:
    text = data.decode("utf-8", "replace")
    check_urdf(text, folder() / "r.urdf")
    return read_description(text, "r.urdf", meshes=True)


def _images() -> Iterable[bytes]:
    image = np.arange(20, dtype=np.uint8).reshape(4, 5)
    for suffix in (".png", ".pgm"):
        yield cv2.imencode(suffix, image)[1].tobytes()
    yield b"P2\n# text\n3 2\n255\n0 1 2 3 4 5\n"
    yield cv2.imencode(".png", np.dstack([image] * 4).astype(np.uint16))[1].tobytes()


def _map(path: Path) -> object:
    cv2.imwrite(str(path.parent / "map.pgm"), np.full((4, 5), 254, dtype=np.uint8))
    return read_cells(path)


def _map_texts() -> Iterable[bytes]:
    yield (
        b"image: map.pgm\nresolution: 0.1\norigin: [0.0, 0.0, 0.0]\nnegate: 0\n"
        b"occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )


def _identities() -> Iterable[bytes]:
    yield Identity("d", 1, {"name": "d"}).text().encode()


def _saved_maps() -> Iterable[bytes]:
    file = io.BytesIO()
    np.savez(file, allow_pickle=False, format=np.array([2, 0, 0]), poses=np.zeros((0, 3)))
    yield file.getvalue()


def _finite(read: Callable[[Path], object], *names: str) -> Read:
    def checked(path: Path) -> None:
        found = read(path)
        for name in names:
            assert np.isfinite(getattr(found, name)).all(), name

    return checked


def _sums(data: bytes) -> None:
    for read in (read_sums, read_sequence):
        try:
            found = read(data)
        except SumsDamaged:
            continue
        assert isinstance(found, dict)


def _sums_texts() -> Iterable[bytes]:
    yield sums_text({"a": "0" * 64, "b/c d": "f" * 64}).encode()
    told = {"index": 0, "files": [{"path": "a", "size_bytes": 1, "sha256": "0" * 64}]}
    yield sequence_text(told).encode()


def _override(data: bytes) -> object:
    return parse_override(data.decode("utf-8", "replace"))


def _sequence(data: bytes) -> object:
    return made_row(_spec(), data)


@cache
def _spec() -> SequenceSpec:
    return SequenceSpec(0, "train/000000", "train", 0, RunConfig(), ("parquet",), {})


def _identity(path: Path) -> object:
    return read_identity(Location(str(path.parent)))


def _manifest(path: Path) -> object:
    opened = open_dataset(path.parent)
    return [opened[number] for number in range(min(len(opened), 3))]


def _manifests() -> Iterable[bytes]:
    row: dict[str, Cell] = {
        "index": 0, "name": "train/000000", "split": "train", "world_index": 0, "seed": 0,
        "status": "made", "faults": "", "sha256": "0" * 64, "files": 1, "size_bytes": 1,
        "reason": None, "command": None,
    }  # fmt: skip
    table = manifest([table_from_parquet(rows_to_parquet([row]))], {"slamsim": "0"})
    yield table_to_parquet(table)


_YAML_WORDS = ("preset: ", "file: ", "&a", "*a", "<<", "!!", "---", "{}", "[", "1e999", ".inf", "~")
_URDF_WORDS = ("<link", "<joint", "<mesh", "filename=", "<origin", "nan", "<!DOCTYPE", "xyz=")

_OTHERS = (
    Target("yaml", as_file("a.yaml", load_yaml), _bundled("worlds", "configs"), _YAML_WORDS),
    Target("run", _model(RunConfig), _bundled("configs"), _YAML_WORDS),
    Target("world", _model(WorldConfig), _bundled("worlds"), _YAML_WORDS),
    Target("robot", _model(RobotConfig), _bundled("configs/robots"), _YAML_WORDS),
    Target("recipe", _model(Recipe), _bundled("configs/datasets"), _YAML_WORDS),
    Target("override", _override, texts("a.b=1", "sensors.lidar=lds_01", "=", "a[0]=x")),
    Target("mesh", _mesh, _meshes, ("facet", "endsolid", "end_header", "element", "glTF")),
    Target("urdf", _urdf, lambda: [build_robot(RobotConfig()).urdf.encode()], _URDF_WORDS),
    Target("image", as_file("a.png", read_gray_image), _images, ("IHDR", "IDAT", "P2", "P5")),
    Target("map.yaml", as_file("map.yaml", _map), _map_texts, ("image: ", "mode: raw", "origin")),
    Target(
        "tum",
        as_file("a.tum", _finite(read_tum, "positions_m", "quats_xyzw")),
        texts("# a\n1.0 0 0 0 0 0 0 1\n2.5 1 2 3 0 0 0.6 0.8\n"),
        ("nan", "1e308", "#"),
    ),
    Target(
        "relations",
        as_file("a.relations", _finite(read_relations, "T_from_to")),
        texts("1.0 2.0 0.1 0.2 0 0 0 0.5\n"),
        ("nan", "1e308", "#"),
    ),
    Target(
        "keyframes",
        as_file("keyframes.csv", read_keyframes),
        texts(f"{HEADER}\n1.0,0,0,0,1,0,0,1,0,1\n2.0,1,0,0,1,0,0,1,0,1\n"),
    ),
    Target(
        "route",
        as_file("route.csv", read_route),
        texts("x_m,y_m,yaw_deg\n1,2,3\n", "t_s,v_m_s,w_rad_s\n0,0.1,0\n1,0,0\n"),
    ),
    Target(
        "route.yaml",
        as_file("route.yaml", read_route),
        texts(
            "poses: [{x_m: 1.0, y_m: 1.0}]\n", "twists: [{t_s: 0.0, v_m_s: 1.0, w_rad_s: 0.0}]\n"
        ),
    ),
    Target("saved map", as_file("session.npz", read_saved_map), _saved_maps),
    Target("sums", _sums, _sums_texts, ("SHA256SUMS", "files", "# of the lines above: ")),
    Target("sequence.json", _sequence, _sums_texts, ("files", "index", "quality")),
    Target("dataset.yaml", as_file("dataset.yaml", _identity), _identities, _YAML_WORDS),
    Target("manifest", as_file("manifest.parquet", _manifest), _manifests),
)
TARGETS = {target.name: target for target in (*LOG_TARGETS, *_OTHERS)}
