"""``--set key.path=value``: YAML on the command line, and its mistakes told as they were typed."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest
from config_example import Box, Lidar, Top
from hypothesis import given
from hypothesis import strategies as st

from slamsim.config.loading import load_model
from slamsim.guard.errors import OverrideRefused, SlamsimError


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("lidar.rate_hz=abc", "must be a number, not the text 'abc'"),
        ("lidar.rate_hzz=3", "unknown key 'rate_hzz'; did you mean 'rate_hz'?"),
        ("ldar.rate_hz=3", "unknown key 'ldar'; did you mean 'lidar'?"),
        ("rate_hz=3", "unknown key 'rate_hz' here; it belongs under 'lidar' or 'rear'"),
        ("lidar.rate_hz=-3", "must be greater than 0 and at most 100, not -3"),
        ("lidar.rate_hz.x=1", "must be a number, not a mapping"),
        ("lidar=3", "must be a mapping (key: value), not 3"),
        ("lidar.offset_m=[1, 2]", "must be a list of 3 values, not of 2"),
        ("things.0.body.side_m=-1", "must be greater than 0, not -1"),
        ("things.1.body.side_m=1", "things is a list of 1: '1' is not an index from 0 to 0"),
        ("lidar.rate_hz", "has no '='; write key.path=value"),
        ("=3", "the key path '' has an empty part"),
        ("lidar..rate_hz=3", "the key path 'lidar..rate_hz' has an empty part"),
        (
            "lidar.rate_hz=[1",
            "the value is not YAML: did not find expected ',' or ']' "
            "(while parsing a flow sequence that begins on line 1)",
        ),
        ("lidar.rate_hz=1e999", "the value '1e999' is too large for a number"),
        ("lidar.rate_hz=*a", "the value the alias 'a' is not allowed: write it out"),
        (
            "lidar.rate_hz=",
            "must be a number, not nothing (null); leave the key out for its default",
        ),
        ("low_m=7", "low_m 7.0 is above high_m 1.0"),
    ],
)
def test_overrides_are_named_as_they_were_typed(
    tmp_path: Path, override: str, message: str
) -> None:
    path = tmp_path / "file.yaml"
    path.write_text("lidar: {rate_hz: 5}\nthings:\n- body: {shape: box, side_m: 1}\n")
    with pytest.raises(SlamsimError) as caught:
        load_model(Top, path, [override])
    assert isinstance(caught.value, OverrideRefused)
    assert str(caught.value) == f"--set {override}: {message}"
    assert caught.value.exit_code == 2


def test_overrides_are_yaml_and_the_last_one_wins(tmp_path: Path) -> None:
    path = tmp_path / "file.yaml"
    path.write_text(
        "lidar: {rate_hz: 5, beam_count: 7}\nthings:\n- body: {shape: box, side_m: 1}\n"
    )
    config = load_model(
        Top,
        path,
        ["lidar.rate_hz=1", "lidar.rate_hz=2e1", "lidar.offset_m=[1, 2, 3]", "lidar={flash: true}",
         "rear={}", "name='12'", "things.0.body.side_m=4"],
    )  # fmt: skip
    assert config.lidar == Lidar(rate_hz=20.0, beam_count=7, flash=True, offset_m=(1.0, 2.0, 3.0))
    assert config.rear == Lidar()
    assert config.name == "12"
    assert config.things[0].body == Box(side_m=4.0)


@given(st.text(max_size=30), st.text(max_size=30))
def test_any_override_is_taken_or_refused_in_one_line(key: str, value: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "file.yaml"
        path.write_text("{}")
        try:
            load_model(Top, path, [f"{key}={value}"])
        except SlamsimError as error:
            assert len(str(error).splitlines()) == 1
