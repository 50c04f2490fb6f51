"""The page of the checker: complete, self-contained, and escaped."""

from __future__ import annotations

import re

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from slamsim.check.findings import CheckReport, Curve, Finding, Measurement, Plot
from slamsim.check.wording import headline, signed_words, taken_off
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


def test_advice_adds_what_is_too_small() -> None:
    assert taken_off(0.04, "s", "its stamps") == "Subtract 0.04 s from its stamps"
    assert taken_off(-0.04, "", "every range") == "Add 0.04 to every range"


def test_a_size_is_told_without_a_sign() -> None:
    words = [signed_words(value, "mm", "too long", "too short") for value in (-40.21, 40.21)]
    assert words == ["40.2 mm too short", "40.2 mm too long"]
    for nothing in (0.0, -0.0, -0.04, 0.04):
        assert signed_words(nothing, "%", "too long", "too short", 1) == "0 % too long"


def test_sentences_wrap_and_each_cell_says_its_column_on_a_narrow_screen() -> None:
    text = check_page(report())
    tables = re.findall(r"<table[^>]*>.*?</table>", text, re.S)
    assert tables and all('class="words"' in one for one in tables)
    for one in tables:
        names = re.findall(r"<th>(.*?)</th>", one)
        cells = re.findall(r'<td data-name="(.*?)">', one)
        assert cells == names * (len(cells) // len(names)) and cells
    style = text[: text.index("</style>")]
    assert ".words td { text-align: left;" in style.replace(".words th, ", "")
    assert "@media (max-width: 720px)" in style and "attr(data-name)" in style


@settings(max_examples=40)
@given(
    value=st.floats(-1e6, 1e6),
    sigma=st.floats(0.0, 1e5),
    limit=st.one_of(st.none(), st.floats(0, 1e6)),
)
def test_a_size_without_a_plot_is_drawn_beside_its_limit(
    value: float, sigma: float, limit: float | None
) -> None:
    size = Measurement(value, sigma, "mm")
    finding = Finding("ranges.offset", "/scan", "ok", "a size", estimate=size, limit=limit)
    (drawn,) = re.findall(
        r'<svg class="gauge".*?</svg>', check_page(CheckReport("x", (finding,))), re.S
    ) or [""]
    places = [float(one) for one in re.findall(r'(?:x1|x2|cx)="(.*?)"', drawn)]
    assert all(-0.1 <= one <= 200.1 for one in places)
    assert bool(drawn) == (max(abs(size.interval[0]), abs(size.interval[1])) > 0.0)


def test_a_size_that_is_no_number_is_not_drawn() -> None:
    size = Measurement(float("nan"), float("inf"), "mm")
    finding = Finding("ranges.offset", "/scan", "ok", "a size", estimate=size, limit=1.0)
    assert "gauge" not in check_page(CheckReport("x", (finding,))).split("</style>")[1]
