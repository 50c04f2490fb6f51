"""The page of the checker: complete, self-contained, and escaped."""

from __future__ import annotations

import numpy as np

from slamsim.check.findings import CheckReport, Curve, Finding, Measurement, Plot
from slamsim.check.wording import headline, signed_words
from slamsim.report.pages.check import check_page


def report() -> CheckReport:
    x = np.linspace(0.0, 1.0, 5000)
    curve = Curve("turn <rate>", x, np.where(x > 0.5, np.nan, x))
    plot = Plot("Turn rate", "time (s)", "rate (rad/s)", (curve,), (0.3,))
    bad = Finding(
        "laser.rotation",
        "/scan<script>",
        "fault",
        "the scan turns 0.001 times as much as the gyroscope",
        "laser_world_fixed",
        "Take directions relative to the laser frame.",
        Measurement(0.001, 0.002, ""),
        0.02,
        plots=(plot,),
    )
    unknown = Finding("time.offset.imu", "/imu", "inconclusive", "the robot hardly turns")
    fine = Finding("ranges.stuck", "/scan", "ok", "no scan repeats", plots=(plot,))
    return CheckReport("a <b>name</b>", (bad, unknown, fine), {"read": 0.5})


def test_everything_is_on_the_page_and_nothing_is_markup() -> None:
    text = check_page(report())
    assert "<script" not in text
    assert "<b>name" not in text
    for words in ("laser_world_fixed", "hardly turns", "no scan repeats", "Take directions"):
        assert words in text
    assert text.count("<svg") == 2


def test_the_page_fetches_nothing() -> None:
    text = check_page(report())
    assert 'src="http' not in text
    assert "default-src 'none'" in text


def test_the_headline_names_the_fault_or_says_that_there_is_none() -> None:
    assert "rays keep their directions" in headline(report())
    fine = CheckReport("x", report().findings[2:])
    assert headline(fine) == "Nothing is wrong."
    assert "1 question stays open" in headline(CheckReport("x", report().findings[1:]))


def test_a_size_is_told_without_a_sign() -> None:
    words = [signed_words(value, "mm", "too long", "too short") for value in (-40.21, 40.21)]
    assert words == ["40.2 mm too short", "40.2 mm too long"]
