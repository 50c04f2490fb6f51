"""A format of recordings is one module that registers itself; each is read once and as a whole."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from slamsim.check.check import check_recording
from slamsim.guard.errors import InputRefused
from slamsim.io import formats
from slamsim.io.copy.recording import copy_recording
from slamsim.io.open import checked_recording, open_recording, read_log, read_recording, read_truth

LINES = ["-1.5707963,0.0174533,30", *(f"{10 + 0.1 * i:.1f},{0.05 * i},0,0.1" for i in range(40))]
RANGES = [f"{1.0 + 0.01 * beam:.2f}" if beam % 7 else "" for beam in range(180)]


@pytest.fixture
def csv(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file of ranges, while its format is registered."""
    formats.formats()  # the package's own stay registered afterwards
    monkeypatch.setattr(formats, "_REGISTERED", dict(formats._REGISTERED))
    import range_csv

    formats.register(range_csv.RANGE_CSV)
    path = tmp_path / "drive.csv"
    rows = [LINES[0], *(f"{line},{','.join(RANGES)}" for line in LINES[1:])]
    path.write_text("\n".join(rows) + "\n")
    return path


def test_a_csv_of_ranges_is_a_format_in_one_module(csv: Path) -> None:
    log = read_log(csv)

    assert len(log.scans) == 40
    scan = next(iter(log.scans))
    assert scan.stamp_ns == 10_000_000_000
    np.testing.assert_array_equal(np.isinf(scan.ranges_m), [word == "" for word in RANGES])
    assert log.odometry is not None
    np.testing.assert_allclose(log.odometry.poses[:, 0], 0.05 * np.arange(40))
    np.testing.assert_allclose(log.odometry.poses[:, 2], 0.1)
    np.testing.assert_array_equal(log.T_base_laser, np.eye(4))
    assert read_truth(csv) is None
    assert checked_recording(csv) == "nothing: the format has no checksums"


def test_it_is_packed_checked_and_copied_as_all_others_are(csv: Path, tmp_path: Path) -> None:
    packed = tmp_path / "packed.csv.gz"
    packed.write_bytes(gzip.compress(csv.read_bytes()))
    recording = read_recording(packed)
    np.testing.assert_array_equal(
        recording.scans[0].stamps_ns, read_recording(csv).scans[0].stamps_ns
    )

    assert not any(each.check.startswith("check.") for each in check_recording(recording).findings)
    told = copy_recording(csv, recording, recording, tmp_path / "copy")

    assert told.attached == ("drive.csv",)
    copied = read_log(tmp_path / "copy")
    assert [scan.stamp_ns for scan in copied.scans] == recording.scans[0].stamps_ns.tolist()


def test_a_bad_line_of_it_is_named(csv: Path) -> None:
    csv.write_text(csv.read_text().replace("10.2", "soon", 1))
    with pytest.raises(InputRefused, match="line 4"):
        read_log(csv)


def test_without_its_module_it_is_no_known_kind(tmp_path: Path) -> None:
    for name, told in ("drive.csv", r"\.csv"), ("drive", "a name without a suffix"):
        path = tmp_path / name
        path.write_text(LINES[0])
        with pytest.raises(InputRefused, match=f"{told} is not a known log format"):
            open_recording(path)
