"""Explains validation errors of pydantic: place, key, given value and nearest valid value."""

from __future__ import annotations

from typing import NamedTuple

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from slamsim.config.kinds import missing_kinds
from slamsim.config.merging import Tree
from slamsim.config.model_keys import Spot, find_spot, suggest
from slamsim.guard.errors import SlamsimError, did_you_mean, shown
from slamsim.guard.yaml import KeyPath, key_text

_MAX_TOLD = 5
_MAX_JUDGED = 1000  # a file may have faults by the ten thousand
_NEEDED = {
    "float_type": "a number",
    "float_parsing": "a number",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "string_type": "a text",
    "list_type": "a list",
    "tuple_type": "a list",
    "set_type": "a list",
    "dict_type": "a mapping (key: value)",
    "model_type": "a mapping (key: value)",
    "model_attributes_type": "a mapping (key: value)",
    "path_type": "a file name",
    "none_required": "null",
}
_SWITCHES = {"yes": "true", "on": "true", "no": "false", "off": "false"}
_RANGE = {"greater_than", "greater_than_equal", "less_than", "less_than_equal"}


def refusal(model_type: type[BaseModel], tree: Tree, error: ValidationError) -> SlamsimError:
    """The exception to raise; its message has a line for each faulty key."""
    faults: dict[KeyPath, list[_ConfigError]] = {}
    details = error.errors(include_url=False)
    for detail in _told_once(details[:_MAX_JUDGED]):
        fault = _ConfigError(find_spot(model_type, detail["loc"], tree.data), detail)
        faults.setdefault(fault.told_for(tree), []).append(fault)
    in_order = sorted(faults, key=lambda keys: tree.place_of(keys).line)
    told = {
        keys: "; or ".join(dict.fromkeys(f.sentence(model_type, tree) for f in faults[keys]))
        for keys in in_order[:_MAX_TOLD]
    }
    first, *others = told
    also = [str(tree.place_of(keys).refusal(keys, told[keys])) for keys in others]
    if (more := len(faults) - len(told) + len(details[_MAX_JUDGED:])) > 0:
        also.append(f"... and {more} more")
    return tree.place_of(first).refusal(first, told[first], tuple(also))


def _told_once(details: list[ErrorDetails]) -> list[ErrorDetails]:
    """Without lists that are too short only because pydantic left a faulty value out."""
    inside = {detail["loc"][:k] for detail in details for k in range(len(detail["loc"]))}
    return [
        detail for detail in details if detail["type"] != "too_short" or detail["loc"] not in inside
    ]


class _ConfigError(NamedTuple):
    """One thing that pydantic found wrong, and where."""

    spot: Spot
    detail: ErrorDetails

    def told_for(self, tree: Tree) -> KeyPath:
        """The key path whose line is to be looked at."""
        kind, keys = self.detail["type"], self.spot.keys
        if kind == "missing":
            return keys[:-1]
        if kind == "value_error" and isinstance(tree.get(keys), dict):
            # Several keys do not fit together: what was typed last is what to look at first.
            return tree.option_below(keys) or keys
        return keys

    def sentence(self, root: type[BaseModel], tree: Tree) -> str:
        """What is wrong and what would be right."""
        keys = self.spot.keys
        if self.detail["type"] == "extra_forbidden":
            return suggest(root, self.spot.owner, keys, tree.place_of(keys).mount)
        if self.detail["type"] == "missing":
            parent = tree.get(keys[:-1])
            if isinstance(parent, list):
                length = find_spot(root, self.detail["loc"][:-1], tree.data).length
                return f"must be a list of {length} values, not of {len(parent)}"
            return f"the key {key_text(keys[-1:])!r} is missing"
        return _reason(self.spot, self.detail, tree.get(self.told_for(tree)))


def _reason(spot: Spot, detail: ErrorDetails, given: object) -> str:
    kind, context = detail["type"], detail.get("ctx", {})
    if kind in _NEEDED:
        length = f" of {spot.length} values" if spot.length and _NEEDED[kind] == "a list" else ""
        return f"must be {_NEEDED[kind]}{length}, not {_given(given)}{_hint(kind, given)}"
    if kind in _RANGE:
        return f"must be {spot.range_text() or detail['msg']}, not {_given(given)}"
    if kind == "finite_number":
        return f"must be a finite number, not {_given(given)}"
    if kind in ("literal_error", "enum"):
        return _choice_reason(spot, context, given)
    if kind.endswith(("too_short", "too_long")):
        return _length_reason(spot, context, given)
    if kind == "union_tag_not_found":
        return f"the key {context['discriminator']} is missing"
    if kind == "union_tag_invalid":
        return _tag_reason(context)
    if kind == "string_pattern_mismatch":
        return f"must match {context['pattern']}, not {_given(given)}"
    if kind in ("value_error", "assertion_error"):
        return str(context.get("error", detail["msg"]))
    message = detail["msg"]
    return f"{message[:1].lower()}{message[1:]} (given: {_given(given)})"


def _choice_reason(spot: Spot, context: dict[str, object], given: object) -> str:
    meant = spot.meant_choice(given)
    if spot.keys[-1:] == ("type",):
        meant += _left_out()
    return f"must be {spot.choices_text() or context.get('expected')}, not {_given(given)}{meant}"


def _tag_reason(context: dict[str, object]) -> str:
    """Of an entry whose ``type`` is none of the kinds that there are."""
    tag, kinds = str(context["tag"]), str(context["expected_tags"]).replace("'", "").split(", ")
    meant = did_you_mean(tag, kinds)
    name = str(context["discriminator"]).strip("'")
    return f"there is no {name} {shown(tag)}, only {', '.join(kinds)}{meant}{_left_out()}"


def _left_out() -> str:
    missing = missing_kinds()
    return f"; {missing}" if missing else ""


def _length_reason(spot: Spot, context: dict[str, object], given: object) -> str:
    if spot.length:
        needed = f"{spot.length}"
    elif "min_length" in context:
        needed = f"at least {context['min_length']}"
    else:
        needed = f"at most {context.get('max_length')}"
    if isinstance(given, str):
        return f"must be a text of {needed} characters, not {_given(given)}"
    return f"must be a list of {needed} values, not of {context.get('actual_length')}"


def _given(value: object) -> str:
    match value:
        case None:
            return "nothing (null)"
        case bool():
            return str(value).lower()
        case str():
            return f"the text {shown(value)}"
        case dict():
            return "a mapping"
        case list():
            return f"a list of {len(value)}"
        case _:
            return shown(value)


def _hint(kind: str, value: object) -> str:
    """What the writer probably meant."""
    if value is None:
        return "; leave the key out for its default"
    if kind == "string_type" and isinstance(value, int | float):
        return "; put it in quotes"
    if not isinstance(value, str):
        return ""
    if kind.startswith("bool"):
        meant = _SWITCHES.get(value.lower())
        return f"; write {meant}" if meant else ""
    if kind.startswith(("float", "int")):
        if _is_number(value):
            return "; write it without quotes"
        for mark, what in ((",", "."), ("_", "")):
            if _is_number(value.replace(mark, what)) and mark in value:
                return f"; write {value.replace(mark, what)}"
    return ""


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text
