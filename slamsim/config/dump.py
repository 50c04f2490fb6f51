"""Writes a configuration as commented YAML that reads back equal."""

from __future__ import annotations

import ast
import inspect
import json
import re
import sys
import textwrap
from collections.abc import Collection, Iterator, Mapping, Sequence
from enum import Enum
from functools import cache, lru_cache
from itertools import pairwise
from pathlib import Path
from typing import TypeGuard

from pydantic import BaseModel

from slamsim.config.base import Config

_WIDTH = 96
_PLAIN = re.compile(r"[A-Za-z_/][A-Za-z0-9_/.-]*")
_BREAKS = re.compile("[\x7f-\xa0\u2028\u2029\ufeff]")
_UNTOLD = frozenset(("additional", "sinks", "looks"))
"""Left out while they are as by default: files of before they were there stay as they were."""
# Also what YAML 1.1 takes for something else than text: other readers still speak it.
_WORDS = frozenset(("null", "true", "false", "yes", "no", "on", "off", "y", "n"))


def dump_commented_yaml(config: Config, *, untold: Collection[str] = _UNTOLD) -> str:
    """The whole configuration, each key under its description; loads back to an equal one.

    untold: keys that are left out while they are as by default. Numbers are written in the
    shortest form that gives the same bits.
    """
    return "\n".join(_model_lines(config, "", untold)) + "\n"


def _model_lines(model: BaseModel, indent: str, untold: Collection[str]) -> Iterator[str]:
    for name, field in type(model).model_fields.items():
        value = getattr(model, name)
        if name in untold and value == field.default:
            continue
        yield from _comment(_told(type(model)).get(name) or field.description, value, indent)
        yield from _entry(f"{indent}{name}:", value, indent, untold)


@cache
def _told(model: type[BaseModel]) -> Mapping[str, str]:
    """What stands below each field of a model, its own and those that it inherits.

    Read where it is written down alone: pydantic's ``use_attribute_docstrings`` looks for it in
    every model at every start, a ninth of the time that ``map`` takes to load.
    """
    told: dict[str, str] = {}
    for each in reversed(model.__mro__):
        own = _told_in(each.__module__).get(each.__name__, {})
        anew = vars(each).get("__annotations__", {})
        told = {name: text for name, text in told.items() if name not in anew} | dict(own)
    return told


@cache
def _told_in(module: str) -> Mapping[str, Mapping[str, str]]:
    """By class, then by field: the texts below the fields of all classes of a module."""
    try:
        tree = ast.parse(inspect.getsource(sys.modules[module]))
    except (KeyError, OSError, TypeError):  # it has no source, as in a notebook
        return {}
    classes = [node for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
    return {each.name: dict(_below(each.body)) for each in classes}


def _below(body: Sequence[ast.stmt]) -> Iterator[tuple[str, str]]:
    for field, text in pairwise(body):
        match field, text:
            case (
                ast.AnnAssign(target=ast.Name(id=name)),
                ast.Expr(value=ast.Constant(value=str(words))),
            ):
                yield name, words


def _comment(text: str | None, value: object, indent: str) -> Iterator[str]:
    if not text and isinstance(value, BaseModel):
        text = (inspect.getdoc(type(value)) or "").split("\n\n")[0]
    if text:
        yield from (f"{indent}# {line}" for line in _wrapped(text, _WIDTH - len(indent)))


@lru_cache(maxsize=1024)
def _wrapped(text: str, width: int) -> tuple[str, ...]:
    return tuple(textwrap.wrap(" ".join(text.split()), width))


def _entry(head: str, value: object, indent: str, untold: Collection[str]) -> Iterator[str]:
    inner = indent + "  "
    if isinstance(value, BaseModel) and type(value).model_fields:
        yield head
        yield from _model_lines(value, inner, untold)
    elif isinstance(value, Mapping) and value:
        yield head
        for key, item in value.items():
            yield from _entry(f"{inner}{_text(str(key))}:", item, inner, untold)
    elif _is_list(value) and any(isinstance(item, BaseModel | Mapping) for item in value):
        yield head
        for item in value:
            yield from _entry(f"{inner}-", item, inner, untold)
    elif isinstance(value, str) and (block := _block(value, inner)):
        yield f"{head} {block[0]}"
        yield from block[1:]
    else:
        yield f"{head} {_flow(value)}"


def _is_list(value: object) -> TypeGuard[Collection[object]]:
    return isinstance(value, Sequence | set | frozenset) and not isinstance(value, str | bytes)


def _flow(value: object) -> str:
    if isinstance(value, BaseModel | Mapping):
        return "{}"
    if _is_list(value):
        return f"[{', '.join(_flow(item) for item in value)}]"
    if isinstance(value, Enum):
        return _flow(value.value)
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return _float(value)
    return _text(str(value)) if isinstance(value, str | Path) else str(value)


def _float(value: float) -> str:
    text = repr(value)
    if "inf" in text or "nan" in text:
        return f"{text[: text.find('inf')]}.inf" if "inf" in text else ".nan"
    mantissa, e, exponent = text.partition("e")
    # YAML 1.1 wants a point before the exponent, or takes 1e-05 for a text.
    return f"{mantissa}.0e{exponent}" if e and "." not in mantissa else text


def _text(value: str) -> str:
    if _PLAIN.fullmatch(value) and value.lower() not in _WORDS:
        return value
    quoted = json.dumps(value, ensure_ascii=False)
    return _BREAKS.sub(lambda found: f"\\u{ord(found.group()):04x}", quoted)


def _block(value: str, inner: str) -> list[str] | None:
    """A drawing of several lines as the lines it is; None where that would not read back."""
    body = value.removesuffix("\n")
    lines = body.split("\n")
    if len(lines) < 2 or body.endswith("\n") or not all(line.isprintable() for line in lines):
        return None
    return ["|2" if value.endswith("\n") else "|2-", *(inner + line for line in lines)]
