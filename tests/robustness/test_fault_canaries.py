"""Faults of the libraries that we guard against, as they are today.

Each is shown in a child, beside the guard that was built for it. One that fails here is good news:
the library was repaired, and the guard named may go. None says anything about our own code.

``pytest -m slow tests/robustness/test_fault_canaries.py``
"""

from __future__ import annotations

import signal
import subprocess
import sys
import textwrap
from dataclasses import dataclass

import pytest

pytestmark = pytest.mark.slow


@dataclass(frozen=True, slots=True)
class Canary:
    """code: prints ``said`` at its end, or is ended by the signal, or hangs.

    guard: where we keep the fault out.
    """

    library: str
    fault: str
    guard: str
    code: str
    ended_by: signal.Signals | None = None
    hangs: bool = False


TETRAHEDRON = """
import numpy as np
corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 500_000_000]])
"""

ROBOT = """
import pybullet
from pathlib import Path
pybullet.connect(pybullet.DIRECT)
def load(text):
    Path("r.urdf").write_text(text)
    return pybullet.loadURDF("r.urdf")
link = '<link name="%s"><inertial><mass value="%s"/><inertia ixx="1" iyy="1" izz="1" ixy="0" '
link += 'ixz="0" iyz="0"/></inertial><collision><geometry><box size="1 1 1"/></geometry>'
link += '</collision></link>'
"""

POSES = """
import gtsam
import numpy as np
noise = gtsam.noiseModel.Isotropic.Sigma(3, 0.1)
def graph(x, tied=True):
    found = gtsam.NonlinearFactorGraph()
    if tied:
        found.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(0, 0, 0), noise))
    found.add(gtsam.BetweenFactorPose2(0, 1, gtsam.Pose2(x, 0, 0), noise))
    return found
start = gtsam.Values()
start.insert(0, gtsam.Pose2(0, 0, 0))
start.insert(1, gtsam.Pose2(0.5, 0, 0))
"""

FULL = """
from pathlib import Path
def full(name):
    Path(name).symlink_to("/dev/full")
    return name
"""

MCAP = """
import struct, sys
from pathlib import Path
import numpy as np
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap.records import Chunk, DataEnd, Footer
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import StoragePlugin, Writer as Writer2
from rosbags.typesys import Stores, get_typestore
types = get_typestore(Stores.ROS2_JAZZY)
def by_rosbags(name):
    with Writer2(Path(name), version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topic = writer.add_connection("/a", "std_msgs/msg/Int32", typestore=types)
        kind = types.types["std_msgs/msg/Int32"]
        for n in range(20):
            data = types.serialize_cdr(kind(n), "std_msgs/msg/Int32")
            writer.write(topic, n, data)
    return next(Path(name).glob("*.mcap"))
"""

CANARIES = (
    Canary(
        "rosbags",
        "writes MCAP whose checksums are all 0",
        "io/mcap/framing.py writes them, io/mcap/reader.py compares them",
        MCAP
        + """
with by_rosbags("bag").open("rb") as file:
    records = list(StreamReader(file, emit_chunks=True).records)
crcs = [r.uncompressed_crc for r in records if isinstance(r, Chunk)]
crcs += [r.data_section_crc for r in records if isinstance(r, DataEnd)]
crcs += [r.summary_crc for r in records if isinstance(r, Footer)]
assert crcs and not any(crcs), crcs
""",
    ),
    Canary(
        "mcap",
        "its reader does not compare checksums unless told to",
        "io/mcap/reader.py",
        MCAP
        + """
with open("a.mcap", "wb") as file:
    writer = Writer(file, compression=CompressionType.NONE)
    writer.start()
    channel = writer.register_channel("/a", "x", writer.register_schema("a", "x", b""))
    writer.add_message(channel, 1, b"right" * 20, 1)
    writer.finish()
data = Path("a.mcap").read_bytes().replace(b"right", b"wrong")
Path("a.mcap").write_bytes(data)
with open("a.mcap", "rb") as file:
    ((_, _, message),) = make_reader(file).iter_messages()
assert message.data == b"wrong" * 20
""",
    ),
    Canary(
        "rosbags",
        "gives no message, and no error, of a chunk whose message index is gone",
        "io/mcap/reader.py counts what is there",
        MCAP
        + """
from rosbags.rosbag2 import Reader
path = by_rosbags("bag")
data = bytearray(path.read_bytes())
at = data.index(b"\\x08", data.rindex(b"\\x0f\\x04"))  # the first chunk index of the summary
length = struct.unpack_from("<Q", data, at + 1)[0]
offsets = at + 9 + 32
(size,) = struct.unpack_from("<I", data, offsets)
assert 0 < size < length
struct.pack_into("<H", data, offsets + 4, 999)  # of another channel
path.write_bytes(data)
with Reader("bag") as reader:
    assert list(reader.messages()) == []
""",
    ),
    Canary(
        "rosbags",
        "recurses without end over a type that holds itself",
        "io/ros/message_types.py: check_definitions",
        """
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
store = get_typestore(Stores.EMPTY)
try:
    store.register(get_types_from_msg("a/msg/A a", "a/msg/A"))
    store.deserialize_cdr(bytes(100), "a/msg/A")
except RecursionError:
    sys.exit(0)
sys.exit(1)
""",
    ),
    Canary(
        "pybullet",
        "dies of a description with two roots",
        "guard/urdf.py: check_urdf",
        ROBOT + """load(f'<robot name="r">{link % ("a", 1)}{link % ("b", 1)}</robot>')\n""",
        ended_by=signal.SIGSEGV,
    ),
    Canary(
        "pybullet",
        "dies of a triangle whose corner does not exist",
        "guard/mesh.py: check_mesh",
        TETRAHEDRON
        + """
import pybullet
pybullet.connect(pybullet.DIRECT)
flags = pybullet.GEOM_FORCE_CONCAVE_TRIMESH
pybullet.createCollisionShape(
    pybullet.GEOM_MESH, vertices=corners.tolist(), indices=faces.ravel().tolist(), flags=flags
)
""",
        ended_by=signal.SIGSEGV,
    ),
    Canary(
        "pybullet",
        "takes a mass that is not a number",
        "guard/urdf.py: check_urdf",
        ROBOT
        + """
body = load(f'<robot name="r">{link % ("a", "nan")}</robot>')
assert not pybullet.getDynamicsInfo(body, -1)[0] > 0.0
heavy = load(f'<robot name="r">{link % ("a", "heavy")}</robot>')
assert not pybullet.getDynamicsInfo(heavy, -1)[0] > 0.0
""",
    ),
    Canary(
        "pybullet",
        "takes a force that is not a number",
        "sim/engine.py looks at what it steps",
        ROBOT
        + """
import math
body = load(f'<robot name="r">{link % ("a", 1)}</robot>')
pybullet.applyExternalForce(body, -1, (math.nan, 0, 0), (0, 0, 0), pybullet.LINK_FRAME)
pybullet.stepSimulation()
assert math.isnan(pybullet.getBasePositionAndOrientation(body)[0][0])
""",
    ),
    Canary(
        "open3d",
        "dies of a triangle whose corner does not exist",
        "guard/mesh.py: check_mesh",
        TETRAHEDRON
        + """
import open3d
mesh = open3d.geometry.TriangleMesh(
    open3d.utility.Vector3dVector(corners), open3d.utility.Vector3iVector(faces.astype(np.int32))
)
mesh.compute_vertex_normals()
""",
        ended_by=signal.SIGSEGV,
    ),
    Canary(
        "open3d",
        "says that it wrote a mesh to a disk that is full",
        "world/model.py makes the bytes, guard/output.py writes them",
        FULL
        + """
import open3d
mesh = open3d.geometry.TriangleMesh.create_sphere(1.0, 4)
assert open3d.io.write_triangle_mesh(full("a.ply"), mesh) is True
""",
    ),
    Canary(
        "opencv",
        "raises nothing where it cannot read or write an image",
        "guard/pictures.py reads, guard/output.py writes",
        FULL
        + """
import cv2, numpy as np
data = cv2.imencode(".png", np.zeros((9, 9), np.uint8))[1].tobytes()
Path("a.png").write_bytes(data[:40])
assert cv2.imread("a.png") is None
assert cv2.imwrite(full("b.png"), np.zeros((9, 9), np.uint8)) in (True, False)
""",
    ),
    Canary(
        "trimesh",
        "reads a cut STL as an empty scene",
        "guard/mesh_file.py: check_mesh_file",
        """
import trimesh
from pathlib import Path
Path("a.stl").write_bytes(trimesh.creation.box().export(file_type="stl")[:60])
try:
    found = trimesh.load_scene("a.stl").geometry
except Exception:
    sys.exit(1)
assert len(found) == 0
""",
    ),
    Canary(
        "gtsam",
        "gives the start for an answer where a measurement is not a number",
        "slam/backend/graph.py: check_edges, and the error after each solution",
        POSES
        + """
solved = gtsam.LevenbergMarquardtOptimizer(graph(np.nan), start).optimize()
assert solved.atPose2(1).x() == 0.5
assert np.isnan(graph(np.nan).error(solved))
""",
    ),
    Canary(
        "gtsam",
        "solves a graph that nothing ties to the map",
        "slam/backend/graph.py names it",
        POSES + "gtsam.LevenbergMarquardtOptimizer(graph(1.0, tied=False), start).optimize()\n",
    ),
    Canary(
        "gtsam",
        "goes on after an update that failed, as if nothing had been",
        "slam/backend/graph.py makes a new one",
        POSES
        + """
isam = gtsam.ISAM2()
try:
    isam.update(graph(1.0, tied=False), start)
    sys.exit(1)
except RuntimeError:
    pass
assert isam.calculateEstimate().size() == 2
""",
    ),
    Canary(
        "gtsam",
        "says nothing where a graph does not fit on the disk",
        "io/text/g2o.py",
        FULL + POSES + """gtsam.writeG2o(graph(1.0), start, full("a.g2o"))\n""",
    ),
    Canary(
        "pyyaml",
        "never ends over keys that are merged again and again",
        "guard/yaml.py refuses them",
        """
import yaml
text = "a0: &a0 {k: v}\\n"
for n in range(1, 9):
    text += f"a{n}: &a{n}\\n  <<: [{', '.join([f'*a{n - 1}'] * 9)}]\\n"
yaml.safe_load(text)
""",
        hangs=True,
    ),
    Canary(
        "pyyaml",
        "takes the last of two equal keys, no for false, 1e3 for a text",
        "guard/yaml.py",
        """
import yaml
assert yaml.safe_load("{a: 1, a: 2}") == {"a": 2}
assert yaml.safe_load("[no, 1e3, 017]") == [False, "1e3", 15]
""",
    ),
    Canary(
        "pyarrow",
        "reads damaged pages unless told to compare their checksums",
        "io/parquet/file.py: read_table",
        """
import pyarrow as pa, pyarrow.parquet as pq
from pathlib import Path
table = pa.table({"a": [b"right" * 50]})
pq.write_table(table, "a.parquet", compression="none", use_dictionary=False,
               write_statistics=False, write_page_checksum=True)
Path("a.parquet").write_bytes(Path("a.parquet").read_bytes().replace(b"right", b"wrong"))
assert pq.read_table("a.parquet")["a"][0].as_py() == b"wrong" * 50
""",
    ),
    Canary(
        "numba",
        "fails where its cache is damaged",
        "jit.py compares a checksum",
        """
import os, subprocess
from pathlib import Path
Path("m.py").write_text(
    "import numba\\n@numba.njit(cache=True)\\ndef f(x):\\n    return x + 1\\nprint(f(1))\\n"
)
here = {**os.environ, "NUMBA_CACHE_DIR": str(Path.cwd() / "cache")}
assert subprocess.run([sys.executable, "m.py"], env=here).returncode == 0
(index,) = Path("cache").rglob("*.nbi")
index.write_bytes(index.read_bytes()[:-20])
assert subprocess.run([sys.executable, "m.py"], env=here, stderr=-3).returncode != 0
""",
    ),
    Canary(
        "numba",
        "fails where no folder for its cache can be written",
        "jit.py takes a folder of its own",
        """
import os
from numba.core import caching
def read_only(self):
    raise OSError("read-only")
for locator in (caching.InTreeCacheLocator, caching.UserWideCacheLocator):
    locator.ensure_cache_path = read_only
import numba
try:
    numba.njit(cache=True)(lambda x: x)
except RuntimeError as error:
    assert "no locator available" in str(error)
    sys.exit(0)
sys.exit(1)
""",
    ),
)


@pytest.mark.parametrize("canary", CANARIES, ids=lambda canary: f"{canary.library} {canary.fault}")
def test_the_fault_is_still_there(canary: Canary, tmp_path_factory: pytest.TempPathFactory) -> None:
    code = f"import sys\n{textwrap.dedent(canary.code)}"
    command = [sys.executable, "-c", code]
    here = tmp_path_factory.mktemp("canary")
    repaired = f"{canary.library} no longer {canary.fault}; the guard: {canary.guard}"
    try:
        done = subprocess.run(
            command,
            cwd=here,
            capture_output=True,
            text=True,
            timeout=5 if canary.hangs else 60,
            check=False,
        )
    except subprocess.TimeoutExpired:
        assert canary.hangs, "took longer than a minute"
        return
    expected = 0 if canary.ended_by is None else -canary.ended_by
    assert not canary.hangs, repaired
    assert done.returncode == expected, f"{repaired}\n{done.stderr[-2000:]}"
