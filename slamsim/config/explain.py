"""What pydantic found wrong, told with place, key, given value and what would be right."""

from __future__ import annotations

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from slamsim.config.layers import Tree
from slamsim.config.model_keys import Spot, find_spot, suggest
from slamsim.safe.errors import SlamsimError, shown
from slamsim.safe.yaml import KeyPath, key_text

_MAX_TOLD = 5
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
    faults: dict[KeyPath, list[str]] = {}
    for detail in _told_once(error.errors(include_url=False)):
        keys, reason = _sentence(model_type, detail, tree)
        told = faults.setdefault(keys, [])
        if reason not in told:
            told.append(reason)
    in_order = sorted(faults, key=lambda keys: tree.place_of(keys).line)
    refusals = [
        tree.place_of(keys).refusal(keys, "; or ".join(faults[keys]))
        for keys in in_order[:_MAX_TOLD]
    ]
    also = [str(other) for other in refusals[1:]]
    if len(faults) > _MAX_TOLD:
        also.append(f"... and {len(faults) - _MAX_TOLD} more")
    first = in_order[0]
    return tree.place_of(first).refusal(first, "; or ".join(faults[first]), tuple(also))


def _told_once(details: list[ErrorDetails]) -> list[ErrorDetails]:
    """Without lists that are too short only because pydantic left a faulty value out."""
    inside = {detail["loc"][:k] for detail in details for k in range(len(detail["loc"]))}
    return [
        detail for detail in details if detail["type"] != "too_short" or detail["loc"] not in inside
    ]


def _sentence(root: type[BaseModel], detail: ErrorDetails, tree: Tree) -> tuple[KeyPath, str]:
    """The key path that the fault is told for, and the fault."""
    kind, loc = detail["type"], detail["loc"]
    spot = find_spot(root, loc, tree.data)
    keys = spot.keys
    if kind == "extra_forbidden":
        return keys, suggest(root, spot.owner, keys, tree.place_of(keys).mount)
    if kind == "missing":
        parent = tree.get(keys[:-1])
        if isinstance(parent, list):
            length = find_spot(root, loc[:-1], tree.data).length
            return keys[:-1], f"must be a list of {length} values, not of {len(parent)}"
        return keys[:-1], f"the key {key_text(keys[-1:])!r} is missing"
    if kind == "value_error" and isinstance(tree.get(keys), dict):
        # Several keys do not fit together: what was typed last is what to look at first.
        keys = tree.option_below(keys) or keys
    return keys, _reason(spot, detail, tree.get(keys))


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
    if kind in ("value_error", "assertion_error"):
        return str(context.get("error", detail["msg"]))
    message = detail["msg"]
    return f"{message[:1].lower()}{message[1:]} (given: {_given(given)})"


def _choice_reason(spot: Spot, context: dict[str, object], given: object) -> str:
    near = spot.nearest_choice(given)
    meant = f"; did you mean {near!r}?" if near else ""
    return f"must be {spot.choices_text() or context.get('expected')}, not {_given(given)}{meant}"


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
