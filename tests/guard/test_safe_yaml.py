"""YAML from outside: YAML 1.2 values, the line of every key, and no bomb goes off."""

from __future__ import annotations

import json
import math
import os
import string
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from limited_child import run_limited
from lowered_limits import lowered

from slamsim.guard.errors import InputRefused, NotFound
from slamsim.guard.yaml import key_text, load_yaml, parse_yaml

HERE = Path("file.yaml")


def value_of(text: str) -> object:
    data = parse_yaml(f"key: {text}", HERE).data
    assert isinstance(data, dict)
    return data["key"]


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("no", "no"),
        ("on", "on"),
        ("Yes", "Yes"),
        ("017", 17),
        ("0o17", 15),
        ("0x1F", 31),
        ("190:20:30", "190:20:30"),
        ("2026-11-21", "2026-11-21"),
        ("1_000", "1_000"),
        ("1e3", 1000.0),
        ("-2.5E-3", -0.0025),
        (".5", 0.5),
        ("5.", 5.0),
        ("+12", 12),
        ("-0", 0),
        ("-.inf", -math.inf),
        ("true", True),
        ("~", None),
        ("", None),
        ("'12'", "12"),
        ('"true"', "true"),
        ("12a", "12a"),
        ("0x", "0x"),
        ("18446744073709551615", 2**64 - 1),
        ("-9223372036854775808", -(2**63)),
        ("0" * 5000 + "7", 7),
    ],
)
def test_plain_values_follow_yaml_1_2(text: str, value: object) -> None:
    found = value_of(text)
    assert found == value
    assert type(found) is type(value)


def test_nan_is_read_as_such() -> None:
    found = value_of(".nan")
    assert isinstance(found, float)
    assert math.isnan(found)


def test_keys_are_always_texts() -> None:
    assert parse_yaml("no: 1\n12: 2\nnull: 3", HERE).data == {"no": 1, "12": 2, "null": 3}


def test_every_key_knows_its_line() -> None:
    document = parse_yaml("# top\na: 1\nb:\n  - {x: 1,\n     y: 2}\n  -\n    z: 3\n", HERE)
    assert [
        document.line_of(path)
        for path in [(), ("a",), ("b",), ("b", 0), ("b", 0, "y"), ("b", 1, "z")]
    ] == [2, 2, 3, 4, 5, 7]


def test_an_absent_key_has_the_line_of_its_parent() -> None:
    document = parse_yaml("a:\n  b: 1\n", HERE)
    assert document.line_of(("a", "gone", 3)) == 1


def test_key_text() -> None:
    assert key_text(("rooms", 0, "width_m")) == "rooms[0].width_m"


ALIASES = "a: &a [x, x]\n" + "".join(
    f"{b}: &{b} [*{a}, *{a}]\n" for a, b in zip("abcd", "bcde", strict=True)
)


@pytest.mark.parametrize(
    ("text", "where", "word"),
    [
        (ALIASES, "line 2", "alias"),
        ("a: &a {k: 1}\nb: {<<: *a}", "line 2, b", "merge key"),
        ("a: &a [*a]", "line 1", "alias"),
        ("a: 1\nb: 2\na: 3", "line 3", "twice (first on line 1)"),
        ("a: !!python/object/apply:os.system [ls]", "line 1", "tag"),
        ("a: 1\n---\nb: 1", "line 2", "second document"),
        ("a:\n\tb: 1", "line 2", "tab"),
        ("a: 1e999", "line 1, a", "too large"),
        ("a: " + "9" * 5000, "line 1, a", "64 bits"),
        ("a: 18446744073709551616", "line 1, a", "64 bits"),
        ("a: \x00", "line 1", "U+0000"),
        ("a: [1, 2", "line 2", "begins on line 1"),
        ("a: 'x\nb: 1", "line 2", "quoted scalar that begins on line 1"),
        ("? [1]\n: 2", "line 1", "cannot be a key"),
        ("a: b: c", "line 1", "check the indentation"),
        ("- " * 40 + "1", "line 1", "deeper than 32"),
    ],
)
def test_what_is_refused_is_named_with_its_line(text: str, where: str, word: str) -> None:
    with pytest.raises(InputRefused) as caught:
        parse_yaml(text, HERE)
    assert caught.value.where.startswith(where)
    assert word in caught.value.reason
    assert "\n" not in str(caught.value)


def test_limits_on_nodes_and_bytes(tmp_path: Path) -> None:
    with pytest.raises(InputRefused, match="more than 10 values"), lowered(yaml_nodes=10):
        parse_yaml("[" + "1, " * 20 + "1]", HERE)
    path = tmp_path / "big.yaml"
    path.write_text("a: " + "x" * 100)
    with pytest.raises(InputRefused, match="103 bytes long, at most 50"), lowered(yaml_bytes=50):
        load_yaml(path)


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        (b"a: 1\nb: \xe9", "line 2: the byte 0xe9 is not UTF-8"),
        ("a: 1".encode("utf-16"), "UTF-16"),
        (b"\x7fELF\x02\x01\x01\x00\x00", "U+007F"),
    ],
)
def test_other_encodings_are_named(tmp_path: Path, raw: bytes, message: str) -> None:
    path = tmp_path / "file.yaml"
    path.write_bytes(raw)
    with pytest.raises(InputRefused) as caught:
        load_yaml(path)
    assert message in str(caught.value)


def test_windows_line_ends_and_byte_order_mark(tmp_path: Path) -> None:
    path = tmp_path / "file.yaml"
    path.write_bytes(b"\xef\xbb\xbfa: 1\r\nb:\r\n  c: x\r\n")
    document = load_yaml(path)
    assert document.data == {"a": 1, "b": {"c": "x"}}
    assert document.line_of(("b", "c")) == 3


def test_what_is_not_a_file(tmp_path: Path) -> None:
    with pytest.raises(NotFound, match="no such file"):
        load_yaml(tmp_path / "absent.yaml")
    with pytest.raises(InputRefused, match="is a folder"):
        load_yaml(tmp_path)
    with pytest.raises(InputRefused, match="pipe or device"):
        load_yaml(Path("/dev/zero"))


def test_a_pipe_without_a_writer_does_not_block(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.yaml")
    with pytest.raises(InputRefused, match="pipe or device"):
        load_yaml(tmp_path / "pipe.yaml")


_KEYS = st.text(string.ascii_lowercase, min_size=1, max_size=5)
# YAML folds Unicode's line ends inside quotes, where JSON keeps them.
_TEXTS = st.text(st.characters(exclude_categories=("C", "Zl", "Zp")), max_size=20)
_LEAVES = st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | _TEXTS
_TREES = st.recursive(
    _LEAVES,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(_KEYS, inner, max_size=3),
    max_leaves=15,
)


@given(_TREES)
def test_json_is_read_as_json_reads_it(tree: object) -> None:
    assert parse_yaml(json.dumps(tree, ensure_ascii=False), HERE).data == tree


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_floats_survive_their_shortest_text(number: float) -> None:
    assert value_of(repr(number)) == number


@given(st.text(alphabet="ab:-[]{}&*!|>'\"%@#,?\n\t 01.e", max_size=60))
def test_any_text_is_read_or_refused(text: str) -> None:
    try:
        parse_yaml(text, HERE)
    except InputRefused as error:
        assert error.where.startswith("line ")


def test_bombs_neither_hang_nor_eat_memory(tmp_path: Path) -> None:
    bombs = {
        "alias": "a: &a [1,1,1,1,1,1,1,1,1,1]\n"
        + "".join(f"b{i}: &b{i} [{', '.join([f'*b{i - 1}'] * 10)}]\n" for i in range(1, 11)),
        "merge": "a: &a {x: 1}\n"
        + "".join(f"b{i}: &b{i} {{<<: [{', '.join(['*a'] * 9)}]}}\n" for i in range(1, 9)),
        "deep": "[" * 1_000_000,
        "deep_block": "- " * 500_000,
        "digits": "a: " + "9" * 1_000_000,
        "keys": "".join(f"k{i}: 1\n" for i in range(130_000)),
        "string": "a: '" + "x" * 1_000_000 + "'",
        "huge": "a: " + "x" * 50_000_000,
        "anchors": "".join(f"- &a{i} 1\n" for i in range(40_000)),
        "quotes": '"' * 1_000_000,
        "braces": "{" * 500_000 + "}" * 500_000,
    }
    for name, text in bombs.items():
        (tmp_path / name).write_text(text)
    done = run_limited(
        """
        import sys, time
        from pathlib import Path
        from slamsim.guard.errors import InputRefused
        from slamsim.guard.yaml import load_yaml
        for path in sorted(Path(sys.argv[1]).iterdir()):
            try:
                load_yaml(path)
                print(path.name, "read")
            except InputRefused:
                print(path.name, "refused")
        """,
        str(tmp_path),
        memory_bytes=512 << 20,
        seconds=20,
    )
    read = [line.split()[0] for line in done.stdout.splitlines() if line.endswith("read")]
    assert len(done.stdout.splitlines()) == len(bombs)
    assert sorted(read) == ["anchors", "string"]
