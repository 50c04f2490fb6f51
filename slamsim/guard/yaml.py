"""Reads YAML files of users: size and depth limits, YAML 1.2 rules, the line of every key.

libyaml's event stream is read directly, so that limits hold before anything is built:
aliases and merge keys (the bombs), tags, duplicate keys and endless nesting are refused.
``no``, ``on`` and ``190:20:30`` are texts, ``017`` is 17 and ``1e3`` is a number, as the core
schema of YAML 1.2 has it (https://yaml.org/spec/1.2.2/#103-core-schema).
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import yaml

from slamsim.guard.errors import InputRefused, shown
from slamsim.guard.files import read_input
from slamsim.guard.limits import LIMITS

KeyPath = tuple[str | int, ...]

_NULL = frozenset(("", "~", "null", "Null", "NULL"))
_BOOL = {"true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False}
_INT = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?")
_INFINITE = re.compile(r"([-+]?)\.(?:inf|Inf|INF)")
_NAN = frozenset((".nan", ".NaN", ".NAN"))
_FORBIDDEN = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x84\x86-\x9f\ud800-\udfff\ufffe\uffff]")
_IN_OTHER_WORDS = {  # the frequent ones; libyaml speaks to its authors
    "did not find expected key": "no key is where one must be: check indentation and quotes",
    "could not find expected ':'": "a key without a ':'",
    "mapping values are not allowed in this context": (
        "a ':' where none may be: check the indentation, or put the text in quotes"
    ),
}
_SHOWN_KEY = 120
_MAX_INT, _MIN_INT, _MAX_DIGITS = 2**64 - 1, -(2**63), 22

if not hasattr(yaml, "CSafeLoader"):  # the pure Python parser hangs on input libyaml shrugs off
    raise ImportError("PyYAML was built without libyaml; install a binary wheel of pyyaml")


@dataclass(frozen=True, slots=True)
class YamlDocument:
    """data: dicts, lists, str, int, float, bool, None. lines: 1-based, per path of keys."""

    path: Path
    data: object
    lines: dict[KeyPath, int]

    def line_of(self, key_path: KeyPath) -> int:
        """The line where the key stands, or else its nearest parent that is there."""
        while key_path and key_path not in self.lines:
            key_path = key_path[:-1]
        return self.lines.get(key_path, 1)


def key_text(key_path: KeyPath) -> str:
    """``("rooms", 0, "width_m")`` as ``rooms[0].width_m``."""
    parts = (f"[{key}]" if isinstance(key, int) else f".{key}" for key in key_path)
    text = "".join(parts).removeprefix(".")
    text = text if text.isprintable() else repr(text)
    return text if len(text) <= _SHOWN_KEY else f"{text[:_SHOWN_KEY]}..."


def load_yaml(path: Path) -> YamlDocument:
    """Read one YAML document; raises NotFound, or InputRefused naming line and key."""
    return parse_yaml(_decode(read_input(path, "yaml_bytes"), path), path)


def parse_yaml(text: str, path: Path) -> YamlDocument:
    """As ``load_yaml``, for a text at hand; ``path`` only names it in messages.

    Raises InputRefused, too.
    """
    if bad := _FORBIDDEN.search(text):
        line = text.count("\n", 0, bad.start()) + 1
        reason = f"the character U+{ord(bad.group()):04X} has no place in a text file"
        raise InputRefused(path, reason, f"line {line}")
    builder = _Builder(path)
    try:
        for event in yaml.parse(text, Loader=yaml.CSafeLoader):
            builder.take(event)
    except yaml.MarkedYAMLError as error:
        raise _syntax_error(error, text, path) from None
    except yaml.YAMLError as error:
        raise InputRefused(path, f"is not YAML: {' '.join(str(error).split())}") from None
    return YamlDocument(path, builder.data, builder.lines)


def _decode(raw: bytes, path: Path) -> str:
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputRefused(path, "is UTF-16 text; save it as UTF-8")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        reason = f"the byte 0x{raw[error.start]:02x} is not UTF-8; save the file as UTF-8 text"
        raise InputRefused(path, reason, f"line {line}") from None


def _syntax_error(error: yaml.MarkedYAMLError, text: str, path: Path) -> InputRefused:
    mark = error.problem_mark or error.context_mark
    line = 1 if mark is None else mark.line + 1
    lines = text.split("\n")
    content = lines[min(line, len(lines)) - 1]
    if "\t" in content[: len(content) - len(content.lstrip())]:
        reason = "a tab indents this line; YAML is indented with spaces"
    else:
        problem = _IN_OTHER_WORDS.get(str(error.problem), error.problem)
        context = f" ({error.context})" if error.context else ""
        if context and error.context_mark is not None and error.context_mark.line + 1 != line:
            context = f"{context[:-1]} that begins on line {error.context_mark.line + 1})"
        reason = f"is not YAML: {problem}{context}"
    return InputRefused(path, reason, f"line {line}")


class _Builder:
    """Turns parser events into data, on its own stack, one limit after the other."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.data: object = None
        self.lines: dict[KeyPath, int] = {}
        self._documents = self._nodes = 0
        self._stack: list[dict[str, object] | list[object]] = []
        self._keys: list[str | None] = []  # per open mapping the key that waits for its value
        self._at: list[str | int] = []

    def take(self, event: yaml.Event) -> None:
        match event:
            case yaml.DocumentStartEvent():
                self._documents += 1
                if self._documents > 1:
                    raise self._refuse(event, "a second document ('---') begins; one is read")
            case yaml.AliasEvent():
                raise self._refuse(
                    event, f"the alias {shown(event.anchor)} is not allowed: write it out"
                )
            case yaml.ScalarEvent():
                self._scalar(event)
            case yaml.MappingStartEvent():
                self._open({}, event)
            case yaml.SequenceStartEvent():
                self._open([], event)
            case yaml.CollectionEndEvent():
                self._stack.pop()
                self._keys.pop()
                self._leave()

    @staticmethod
    def _line(event: yaml.Event) -> int:
        return 1 if event.start_mark is None else event.start_mark.line + 1

    def _refuse(self, event: yaml.Event, reason: str, limit: str = "") -> InputRefused:
        where = f"line {self._line(event)}"
        if self._at:
            where += f", {key_text(tuple(self._at))}"
        return InputRefused(self.path, reason, where, limit=limit)

    def _count(self, event: yaml.ScalarEvent | yaml.CollectionStartEvent) -> None:
        self._nodes += 1
        if self._nodes > LIMITS.yaml_nodes:
            reason = f"more than {LIMITS.yaml_nodes:,} values"
            raise self._refuse(event, reason, "yaml_nodes")
        if event.tag is not None:
            raise self._refuse(event, f"the tag {shown(event.tag)} is not allowed: remove it")

    def _scalar(self, event: yaml.ScalarEvent) -> None:
        if self._waits_for_key():
            self._key(event)
            return
        plain = event.style is None or event.style == ""
        self._count(event)
        self._enter(event)
        self._place(self._resolve(event) if plain else event.value)
        self._leave()

    def _waits_for_key(self) -> bool:
        return bool(self._stack) and isinstance(self._stack[-1], dict) and self._keys[-1] is None

    def _key(self, event: yaml.ScalarEvent) -> None:
        self._count(event)
        key, mapping = event.value, self._stack[-1]
        if len(key) > (most := LIMITS.yaml_key_characters):
            reason = f"a key of {len(key):,} characters, at most {most:,} are read"
            raise self._refuse(event, reason, "yaml_key_characters")
        if key == "<<" and event.implicit[0]:
            raise self._refuse(event, "the merge key '<<' is not allowed: write the keys out")
        if key in mapping:
            first = self.lines[(*self._at, key)]
            raise self._refuse(
                event, f"the key {shown(key)} stands here twice (first on line {first})"
            )
        self._keys[-1] = key
        self.lines[(*self._at, key)] = self._line(event)

    def _open(
        self, value: dict[str, object] | list[object], event: yaml.CollectionStartEvent
    ) -> None:
        if self._waits_for_key():
            raise self._refuse(event, "a list or mapping cannot be a key")
        self._count(event)
        if len(self._stack) >= LIMITS.yaml_depth:
            reason = f"nested deeper than {LIMITS.yaml_depth} levels"
            raise self._refuse(event, reason, "yaml_depth")
        self._enter(event)
        self._place(value)
        self._stack.append(value)
        self._keys.append(None)

    def _enter(self, event: yaml.Event) -> None:
        if not self._stack:
            self.lines[()] = self._line(event)
        elif isinstance(top := self._stack[-1], list):
            self._at.append(len(top))
            self.lines[tuple(self._at)] = self._line(event)
        else:
            self._at.append(str(self._keys[-1]))

    def _place(self, value: object) -> None:
        if not self._stack:
            self.data = value
        elif isinstance(top := self._stack[-1], list):
            top.append(value)
        else:
            top[str(self._keys[-1])] = value
            self._keys[-1] = None

    def _leave(self) -> None:
        if self._at:
            self._at.pop()

    def _resolve(self, event: yaml.ScalarEvent) -> object:
        text = event.value
        if text in _NULL:
            return None
        if text in _BOOL:
            return _BOOL[text]
        if _INT.fullmatch(text):
            return self._integer(event)
        if _FLOAT.fullmatch(text):
            number = float(text)
            if math.isinf(number):
                raise self._refuse(event, f"{shown(text)} is too large for a number")
            return number
        if infinite := _INFINITE.fullmatch(text):
            return float(f"{infinite[1]}inf")
        return math.nan if text in _NAN else text

    def _integer(self, event: yaml.ScalarEvent) -> int:
        text = event.value
        base = {"0o": 8, "0x": 16}.get(text[:2], 10)
        digits = text.lstrip("+-0ox")
        number = int(digits or "0", base) if len(digits) <= _MAX_DIGITS else _MAX_INT + 1
        if text.startswith("-"):
            number = -number
        if not _MIN_INT <= number <= _MAX_INT:
            raise self._refuse(event, "the whole number is too large (more than 64 bits)")
        return number
