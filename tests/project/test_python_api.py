"""The package as it is used from Python and from notebooks."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import slamsim
from slamsim.guard.errors import NotFound, OverrideRefused
from slamsim.io.open import read_truth

pytestmark = pytest.mark.usefixtures("drives_here", "undrawn_figures")
PACKAGE = Path(slamsim.__file__).parent
SHORT = {"drive.route.max_duration_s": 4, "sensors.lidar": "lds_01"}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> slamsim.Run:
    folder = tmp_path_factory.mktemp("api") / "run"
    return slamsim.map("tiny", seed=3, settings=SHORT, out=folder, quiet=True)


def test_the_stub_tells_the_names_that_there_are() -> None:
    stub = ast.parse((PACKAGE / "__init__.pyi").read_text())
    told = {
        alias.asname for one in stub.body if isinstance(one, ast.ImportFrom) for alias in one.names
    }
    assert told | {"__version__"} == set(slamsim.__all__)
    assert set(slamsim.__all__) <= set(dir(slamsim))
    assert callable(slamsim.dataset.open)
    with pytest.raises(AttributeError, match="no attribute 'maps'"):
        getattr(slamsim, "maps")  # noqa: B009


def test_a_run_gives_what_its_files_say(run: slamsim.Run) -> None:
    folder = run.folder
    assert run.report == json.loads((folder / "report.json").read_text())
    rows = np.loadtxt(folder / "trajectory.tum")
    np.testing.assert_allclose(run.trajectory.poses[:, :2], rows[:, 1:3], atol=1e-9)
    assert len(run.odometry) == len(rows) == run.report["scans_used"]
    truth = read_truth(run.recording)
    assert truth is not None and len(run.truth) == len(truth)
    rows_columns = run.grid.occupancy.shape
    assert (folder / "map.pgm").read_bytes().split()[1:3] == [b"%d" % n for n in rows_columns[::-1]]
    assert repr(slamsim.Run(folder)) == f"Run({str(folder)!r})"


def picture(run: slamsim.Run) -> ElementTree.Element:
    html = run._repr_html_()
    return ElementTree.fromstring(html[html.index("<svg") : html.index("</svg>") + 6])


def test_the_picture_of_a_run_lays_its_paths_over_its_map(run: slamsim.Run) -> None:
    svg = picture(run)
    image = svg.find("image")
    assert image is not None
    left, top, width, height = (float(image.attrib[name]) for name in ("x", "y", "width", "height"))
    cells = run.grid
    size_m = np.array(cells.occupancy.shape[::-1]) * cells.resolution_m
    np.testing.assert_allclose([width, height], size_m, atol=1e-3)
    np.testing.assert_allclose([left, -top - height], cells.origin_m, atol=2e-3)
    estimate = svg.findall("polyline")[1].attrib["points"].split()
    first_m = np.array(estimate[0].split(","), dtype=float) * [1, -1]
    np.testing.assert_allclose(first_m, run.trajectory.poses[0, :2], atol=0.006)
    row, column = (run.trajectory.poses[0, 1::-1] - cells.origin_m[::-1]) / cells.resolution_m
    assert cells.occupancy[int(row), int(column)] == 0.0


def test_a_simulated_run_has_a_recording_and_no_map(tmp_path: Path) -> None:
    made = slamsim.simulate("tiny", settings=SHORT, out=tmp_path / "made", quiet=True)
    assert len(picture(made).findall("polyline")) == 1
    with pytest.raises(NotFound, match=r"this run has no map\.yaml"):
        _ = made.grid
    report = slamsim.check_recording(made.recording, quick=True, quiet=True)
    assert report.faults == () and "no fault" in repr(report)


def test_a_fault_is_shown_in_a_notebook(tmp_path: Path) -> None:
    made = slamsim.simulate(
        "tiny", settings=SHORT, faults=["imu_upside_down"], out=tmp_path / "f", quiet=True
    )
    report = slamsim.check_recording(made.recording, quick=True, quiet=True)
    assert report.faults
    assert all(finding.fault in report._repr_html_() for finding in report.faults if finding.fault)


def test_a_folder_that_is_not_there_is_no_run(tmp_path: Path) -> None:
    with pytest.raises(NotFound, match="no such run"):
        slamsim.Run(tmp_path / "nothing")


def test_the_package_is_a_command() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "slamsim", "--version"],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert done.stdout == f"slamsim {slamsim.__version__}\n"


def test_heights_of_clouds_are_refused_as_typed_ones_are(tmp_path: Path) -> None:
    recording, wrong = tmp_path / "no.mcap", (0.8, 0.1)
    with pytest.raises(OverrideRefused, match="the lower one first"):
        slamsim.map(recording, cloud_height=wrong, quiet=True)
    with pytest.raises(OverrideRefused, match="the lower one first"):
        slamsim.check_recording(recording, cloud_height=wrong, quiet=True)
