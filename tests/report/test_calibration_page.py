"""What the first line of a page of calibrated cameras says."""

from __future__ import annotations

from pathlib import Path

import pytest

from slamsim.report.pages.calibration import CalibratedView, write_calibration_report


@pytest.mark.parametrize(
    ("numbers", "told"),
    [
        ((("1", "ok"), ("2", "ok")), "all is as claimed."),
        ((("1", "fault"), ("2", "ok")), "1 of 2 numbers are not as claimed."),
        ((("1", "fault"), ("", "inconclusive")), "1 of 2 numbers are not as claimed, 1 inconclusi"),
        ((("1", "ok"), ("2", "inconclusive")), "1 of 2 numbers are as claimed, 1 inconclusive."),
        ((("1", "inconclusive"),), "0 of 1 numbers are as claimed, 1 inconclusive."),
        ((("", "measured"), ("", "inconclusive")), "nothing was claimed, 1 inconclusive."),
        ((), "nothing was claimed."),
    ],
)
def test_what_is_inconclusive_is_not_said_to_be_as_claimed(
    numbers: tuple[tuple[str, str], ...], told: str, tmp_path: Path
) -> None:
    rows = [("x", "1 mm", claimed, verdict, "") for claimed, verdict in numbers]
    page = tmp_path / "report.html"
    write_calibration_report(page, [CalibratedView("/camera", {}, rows, {})], {}, ())
    text = page.read_text()
    assert told in text
    assert ("all is as claimed" in text) == (told == "all is as claimed.")
