"""TUM trajectories, g2o graphs and relation files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from evo.tools import file_interface

from slamsim.core.geometry import xyzw_from_yaw
from slamsim.core.result import GraphEdge, PoseGraph
from slamsim.core.types import PlanarTrajectory, Trajectory
from slamsim.guard.errors import InputRefused, SlamsimError
from slamsim.io.text.g2o import write_g2o
from slamsim.io.text.relations import read_relations
from slamsim.io.text.tum import read_tum, write_tum


def _trajectory(count: int = 20) -> Trajectory:
    rng = np.random.default_rng(3)
    stamps = 1_700_000_000_000_000_001 + np.cumsum(rng.integers(1, 10**9, count))
    quats = rng.normal(size=(count, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    return Trajectory(stamps, rng.normal(size=(count, 3)) * 10, quats)


def test_tum_round_trip_and_evo_reads_it(tmp_path: Path) -> None:
    trajectory = _trajectory()
    path = tmp_path / "trajectory.tum"
    write_tum(path, trajectory)
    again = read_tum(path)
    np.testing.assert_array_equal(again.stamps_ns, trajectory.stamps_ns)
    np.testing.assert_allclose(again.positions_m, trajectory.positions_m, atol=1e-9)
    np.testing.assert_allclose(again.quats_xyzw, trajectory.quats_xyzw, atol=1e-8)
    evo = file_interface.read_tum_trajectory_file(path)
    np.testing.assert_allclose(evo.positions_xyz, trajectory.positions_m, atol=1e-9)
    np.testing.assert_allclose(
        np.roll(evo.orientations_quat_wxyz, -1, axis=1), trajectory.quats_xyzw, atol=1e-8
    )


def test_tum_of_a_planar_trajectory(tmp_path: Path) -> None:
    planar = PlanarTrajectory(np.array([0, 5]), np.array([[1.0, 2.0, 0.5], [3.0, 4.0, -3.0]]))
    write_tum(tmp_path / "t.tum", planar)
    again = read_tum(tmp_path / "t.tum")
    np.testing.assert_allclose(again.planar().poses, planar.poses, atol=1e-8)
    np.testing.assert_allclose(again.quats_xyzw, xyzw_from_yaw(planar.poses[:, 2]), atol=1e-8)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "no pose"),
        ("1.0 1 2 3 0 0 0\n", "line 1"),
        ("1.0 1 2 3 0 0 0 2\n", "quaternion"),
        ("1.0 1 2 nan 0 0 0 1\n", "line 1"),
        ("2 1 2 3 0 0 0 1\n1 1 2 3 0 0 0 1\n", "line 2"),
        ("x 1 2 3 0 0 0 1\n", "line 1"),
    ],
)
def test_tum_refused(tmp_path: Path, text: str, told: str) -> None:
    path = tmp_path / "bad.tum"
    path.write_text(text)
    with pytest.raises(InputRefused, match=told):
        read_tum(path)


def test_g2o_holds_what_the_graph_holds(tmp_path: Path) -> None:
    poses = np.array([[0.0, 0.0, 0.0], [1.0, 0.5, 0.25], [2.0, 1.0, -0.5]])
    covariance = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, 0.002], [0.0, 0.002, 0.01]])
    edges = (
        GraphEdge(0, 0, poses[0], covariance, "prior"),
        GraphEdge(0, 1, poses[1], covariance, "match"),
        GraphEdge(0, 2, poses[2], covariance, "closure", weight=0.5),
        GraphEdge(1, 2, poses[2], covariance, "closure", weight=0.0),
    )
    graph = PoseGraph(PlanarTrajectory(np.arange(3), poses), np.zeros((3, 3, 3)), edges)
    path = tmp_path / "graph.g2o"
    write_g2o(path, graph)
    lines = [line.split() for line in path.read_text().splitlines()]
    assert [words[0] for words in lines].count("VERTEX_SE2") == 3
    match, closure = (words for words in lines if words[0] == "EDGE_SE2")
    assert match[1:3] == ["0", "1"]
    np.testing.assert_allclose(np.array(match[3:6], dtype=float), poses[1])
    information = np.zeros((3, 3))
    information[np.triu_indices(3)] = np.array(match[6:], dtype=float)
    information += np.triu(information, 1).T
    np.testing.assert_allclose(information @ covariance, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(
        np.array(closure[6:], dtype=float) * 2.0, np.array(match[6:], dtype=float), rtol=1e-9
    )


def test_gtsam_reads_our_g2o(tmp_path: Path) -> None:
    gtsam = pytest.importorskip("gtsam")
    poses = np.array([[0.0, 0.0, 0.0], [1.0, 0.5, 0.25]])
    edge = GraphEdge(0, 1, poses[1], np.diag([0.1, 0.2, 0.3]), "match")
    graph = PoseGraph(PlanarTrajectory(np.arange(2), poses), np.zeros((2, 3, 3)), (edge,))
    write_g2o(tmp_path / "graph.g2o", graph)
    factors, values = gtsam.readG2o(str(tmp_path / "graph.g2o"), False)
    assert factors.size() == 1
    assert values.atPose2(1).theta() == pytest.approx(0.25)


def test_g2o_without_information_is_an_error(tmp_path: Path) -> None:
    poses = np.zeros((2, 3))
    edge = GraphEdge(0, 1, poses[1], np.zeros((3, 3)), "match")
    graph = PoseGraph(PlanarTrajectory(np.arange(2), poses), np.zeros((2, 3, 3)), (edge,))
    with pytest.raises(SlamsimError, match="0 -> 1"):
        write_g2o(tmp_path / "graph.g2o", graph)


def test_relations(tmp_path: Path) -> None:
    path = tmp_path / "made.relations"
    path.write_text("# comment\n90.239599 90.719599 0.4 -0.1 0.0 0.0 0.0 0.5\n\n")
    relations = read_relations(path)
    assert (int(relations.from_ns[0]), int(relations.to_ns[0])) == (90239599000, 90719599000)
    np.testing.assert_allclose(relations.planar, [[0.4, -0.1, 0.5]])


@pytest.mark.parametrize("line", ["1 2 3", "a 2 0 0 0 0 0 0", "1 2 0 0 0 0 0 nan"])
def test_bad_relation_lines_are_named(tmp_path: Path, line: str) -> None:
    path = tmp_path / "made.relations"
    path.write_text(f"1 2 0 0 0 0 0 0\n{line}\n")
    with pytest.raises(InputRefused, match="line 2"):
        read_relations(path)
