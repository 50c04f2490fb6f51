"""Every mistake in a configuration is one sentence: file, line, key, value, what would be right."""

from __future__ import annotations

from pathlib import Path

import pytest
from config_example import Top

from slamsim.config.loading import load_model
from slamsim.guard.errors import InputRefused


def refused(folder: Path, text: str | bytes) -> str:
    path = folder / "file.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputRefused) as caught:
        load_model(Top, path)
    return str(caught.value).removeprefix(f"{path}")


@pytest.mark.parametrize(
    ("text", "where", "reason"),
    [
        # Nearest keys, here and elsewhere.
        ("lidr: {}", "line 1, lidr", "unknown key 'lidr'; did you mean 'lidar'?"),
        (
            "lidar:\n  rate_hzz: 3",
            "line 2, lidar.rate_hzz",
            "unknown key 'rate_hzz'; did you mean 'rate_hz'?",
        ),
        (
            "lidar: {range_max_m: 3}",
            "line 1, lidar.range_max_m",
            "unknown key 'range_max_m'; did you mean 'max_range_m'?",
        ),
        (
            "max_range_m: 3",
            "line 1, max_range_m",
            "unknown key 'max_range_m' here; it belongs under 'lidar' or 'rear'",
        ),
        (
            "lidar: {algorithm: prim}",
            "line 1, lidar.algorithm",
            "unknown key 'algorithm' here; it belongs at the top level",
        ),
        (
            "max_rang_m: 3",
            "line 1, max_rang_m",
            "unknown key 'max_rang_m' here; did you mean 'max_range_m' under 'lidar'?",
        ),
        (
            "lidar: {zzz: 3}",
            "line 1, lidar.zzz",
            "unknown key 'zzz'; the keys here are rate_hz, max_range_m, beam_count, flash, "
            "offset_m",
        ),
        ("LIDAR: {}", "line 1, LIDAR", "unknown key 'LIDAR'; did you mean 'lidar'?"),
        # Types.
        (
            "lidar: {rate_hz: '12'}",
            "line 1, lidar.rate_hz",
            "must be a number, not the text '12'; write it without quotes",
        ),
        (
            "lidar: {rate_hz: 1,5}",
            "line 1, lidar.5",
            "unknown key '5'; the keys here are rate_hz, max_range_m, beam_count, flash, offset_m",
        ),
        (
            "lidar:\n  rate_hz: 1,5",
            "line 2, lidar.rate_hz",
            "must be a number, not the text '1,5'; write 1.5",
        ),
        (
            "lidar: {rate_hz: 1_000}",
            "line 1, lidar.rate_hz",
            "must be a number, not the text '1_000'; write 1000",
        ),
        ("lidar: {rate_hz: true}", "line 1, lidar.rate_hz", "must be a number, not true"),
        ("lidar: {rate_hz: [1]}", "line 1, lidar.rate_hz", "must be a number, not a list of 1"),
        (
            "lidar: {rate_hz: }",
            "line 1, lidar.rate_hz",
            "must be a number, not nothing (null); leave the key out for its default",
        ),
        ("lidar: {beam_count: 2.5}", "line 1, lidar.beam_count", "must be a whole number, not 2.5"),
        (
            "lidar: {beam_count: 1e3}",
            "line 1, lidar.beam_count",
            "must be a whole number, not 1000.0",
        ),
        (
            "lidar: {flash: yes}",
            "line 1, lidar.flash",
            "must be true or false, not the text 'yes'; write true",
        ),
        ("lidar: {flash: 1}", "line 1, lidar.flash", "must be true or false, not 1"),
        ("name: 12", "line 1, name", "must be a text, not 12; put it in quotes"),
        ("name: ''", "line 1, name", "must be a text of at least 1 characters, not the text ''"),
        ("name: {a: 1}", "line 1, name", "must be a text, not a mapping"),
        ("lidar: 3", "line 1, lidar", "must be a mapping (key: value), not 3"),
        (
            "lidar:\nname: x",
            "line 1, lidar",
            "must be a mapping (key: value), not nothing (null); leave the key out for its default",
        ),
        ("labels: {a: x}", "line 1, labels.a", "must be a whole number, not the text 'x'"),
        # Ranges.
        (
            "lidar: {rate_hz: 0}",
            "line 1, lidar.rate_hz",
            "must be greater than 0 and at most 100, not 0",
        ),
        (
            "lidar: {rate_hz: 1e9}",
            "line 1, lidar.rate_hz",
            "must be greater than 0 and at most 100, not 1000000000.0",
        ),
        (
            "rear: {beam_count: -4}",
            "line 1, rear.beam_count",
            "must be at least 1 and at most 10000, not -4",
        ),
        (
            "lidar: {max_range_m: .inf}",
            "line 1, lidar.max_range_m",
            "must be a finite number, not inf",
        ),
        (
            "lidar: {max_range_m: .nan}",
            "line 1, lidar.max_range_m",
            "must be a finite number, not nan",
        ),
        (
            "lidar: {max_range_m: 1e999}",
            "line 1, lidar.max_range_m",
            "'1e999' is too large for a number",
        ),
        (
            "lidar: {beam_count: 99999999999999999999999}",
            "line 1, lidar.beam_count",
            "the whole number is too large (more than 64 bits)",
        ),
        ("low_m: 3", "line 1", "low_m 3.0 is above high_m 1.0"),
        # Choices.
        (
            "algorithm: wilsn",
            "line 1, algorithm",
            "must be 'wilson', 'prim' or 'kruskal', not the text 'wilsn'; did you mean 'wilson'?",
        ),
        ("algorithm: 7", "line 1, algorithm", "must be 'wilson', 'prim' or 'kruskal', not 7"),
        (
            "mode: fsat",
            "line 1, mode",
            "must be 'fast' or 'slow', not the text 'fsat'; did you mean 'fast'?",
        ),
        # Lists and unions.
        (
            "lidar: {offset_m: [1, 2]}",
            "line 1, lidar.offset_m",
            "must be a list of 3 values, not of 2",
        ),
        (
            "lidar: {offset_m: [1, 2, 3, 4]}",
            "line 1, lidar.offset_m",
            "must be a list of 3 values, not of 4",
        ),
        ("lidar: {offset_m: 3}", "line 1, lidar.offset_m", "must be a list of 3 values, not 3"),
        (
            "lidar:\n  offset_m:\n    - 1\n    - x\n    - 3",
            "line 4, lidar.offset_m[1]",
            "must be a number, not the text 'x'",
        ),
        ("things:\n- {}", "line 2, things[0]", "the key 'body' is missing"),
        ("things:\n- body: {shape: box}", "line 2, things[0].body", "the key 'side_m' is missing"),
        (
            "things:\n- body: {shape: box, side_m: -1}",
            "line 2, things[0].body.side_m",
            "must be greater than 0, not -1",
        ),
        (
            "things:\n- body: {shape: ball, radis_m: 1, radius_m: 1}",
            "line 2, things[0].body.radis_m",
            "unknown key 'radis_m'; did you mean 'radius_m'?",
        ),
        (
            "things: [{body: {shape: box, side_m: 1}, size: x}]",
            "line 1, things[0].size",
            "must be a number, not the text 'x'; or must be a list, not the text 'x'",
        ),
        # The file as a whole.
        ("", "", "is empty; {} stands for all defaults"),
        ("# only this\n", "", "is empty; {} stands for all defaults"),
        ("- a", "line 1", "holds a list; a mapping (key: value) is needed"),
        ("12", "line 1", "holds 12; a mapping (key: value) is needed"),
        ("lidar:\n\trate_hz: 3", "line 2", "a tab indents this line; YAML is indented with spaces"),
        (
            b"\xef\xbb\xbfname: x\r\nlidar:\r\n  flsh: true\r\n",
            "line 3, lidar.flsh",
            "unknown key 'flsh'; did you mean 'flash'?",
        ),
        (b"name: \xe9", "line 1", "the byte 0xe9 is not UTF-8; save the file as UTF-8 text"),
    ],
)
def test_one_mistake_one_sentence(
    tmp_path: Path, text: str | bytes, where: str, reason: str
) -> None:
    place = f", {where}: " if where else ": "
    assert refused(tmp_path, text) == place + reason


def test_an_unknown_shape_names_the_known_ones(tmp_path: Path) -> None:
    message = refused(tmp_path, "things: [{body: {shape: bxo, side_m: 1}}]")
    assert message.startswith(", line 1, things[0].body")
    assert "only box, ball; did you mean 'box'?" in message


def test_several_mistakes_are_told_in_the_order_of_the_file(tmp_path: Path) -> None:
    text = "name: 3\nlidar:\n  rate_hz: -1\n  flsh: 1\nmode: x\nlow_m: a\nhigh_m: b\nlabels: 3\n"
    lines = refused(tmp_path, text).splitlines()
    assert [line.split("line ")[1].split(",")[0] for line in lines[:5]] == ["1", "3", "4", "5", "6"]
    assert lines[5:] == ["... and 2 more"]
