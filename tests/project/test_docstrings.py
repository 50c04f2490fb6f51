"""What docstrings must say: where numbers come from, shapes of arrays, errors that are raised."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from sources import tree_of

PACKAGE = Path(__file__).parents[2] / "slamsim"


def modules() -> Iterator[tuple[str, ast.Module]]:
    for path in sorted(PACKAGE.rglob("*.py")):
        yield str(path.relative_to(PACKAGE)), tree_of(path)


def is_docstring(node: ast.stmt) -> bool:
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )


def is_constant(node: ast.stmt) -> bool:
    """Whether numbers with decimals get a name; of other tables the keys say what they are."""
    if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
        return False
    target = node.targets[0] if isinstance(node, ast.Assign) else node.target
    if not ast.unparse(target).isupper():
        return False
    makes_object = isinstance(node.value, ast.Call) and ast.unparse(node.value.func)[:1].isupper()
    values = [one.value for one in ast.walk(node.value) if isinstance(one, ast.Constant)]
    is_table = isinstance(node.value, ast.Dict | ast.Set) or any(isinstance(v, str) for v in values)
    return not makes_object and not is_table and any(isinstance(v, float) for v in values)


def unexplained(body: list[ast.stmt]) -> Iterator[str]:
    """Constants below which, or below others right after them, no docstring stands."""
    for number, node in enumerate(body):
        if is_constant(node):
            after = number + 1
            while (
                after < len(body)
                and body[after].lineno == (body[after - 1].end_lineno or 0) + 1
                and (isinstance(body[after], ast.Assign | ast.AnnAssign))
            ):
                after += 1
            if after == len(body) or not is_docstring(body[after]):
                yield ast.unparse(node)[:60]


def test_a_number_says_what_it_is_of_or_where_it_comes_from() -> None:
    found = [f"{name}: {one}" for name, tree in modules() for one in unexplained(tree.body)]
    assert found == []


Function = ast.FunctionDef | ast.AsyncFunctionDef


def public_functions() -> Iterator[tuple[str, Function, str]]:
    """Place, function and all that its docstring and that of its class say, in one line.

    Methods without a docstring have that of what they implement.
    """
    for name, tree in modules():
        classes = [node for node in tree.body if isinstance(node, ast.ClassDef)]
        owners: list[ast.Module | ast.ClassDef] = [tree, *classes]
        for owner in owners:
            if isinstance(owner, ast.ClassDef) and owner.name.startswith("_"):
                continue
            about = ast.get_docstring(owner) if isinstance(owner, ast.ClassDef) else ""
            for node in owner.body:
                if isinstance(node, Function) and not node.name.startswith("_"):
                    told = ast.get_docstring(node)
                    if told is not None or isinstance(owner, ast.Module):
                        yield f"{name}: {node.name}", node, " ".join(f"{told} {about}".split())


ARRAYS = re.compile(r"\b(NDArray|\w*Array)\b")
SHAPES = re.compile(
    r"\((?:\.\.\.|[\w .+*/()-]*\w)\)?,[^()]*\)"  # (n, 3), (count,), (..., 4)
    r"|\(\.\.\.\)|\d ?x ?\d|\d ?x ?\w|\w+ x \d"  # 4 x 4
    r"|[Aa]s (?:in )?``|[Ss]ee ``|\bflat\b|shape|like ``|broadcast"  # or who says it
)


def test_public_functions_tell_the_shapes_of_arrays() -> None:
    silent = []
    for place, node, words in public_functions():
        arguments = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
        types = [*(a.annotation for a in arguments if a.annotation), *filter(None, [node.returns])]
        if any(ARRAYS.search(ast.unparse(one)) for one in types) and not SHAPES.search(words):
            silent.append(place)
    assert silent == []


def raised(body: list[ast.stmt]) -> set[str]:
    """Names of the errors that a function raises itself."""
    found = set()
    waiting: list[ast.AST] = list(body)
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Raise) and node.exc is not None:
            error = node.exc.func if isinstance(node.exc, ast.Call) else node.exc
            found.add(ast.unparse(error).rpartition(".")[2])
        if not isinstance(node, Function | ast.Lambda | ast.ClassDef):
            waiting += ast.iter_child_nodes(node)
    return {name for name in found if name[:1].isupper()} - {
        "AssertionError",
        "NotImplementedError",
    }


def test_public_functions_tell_what_they_raise() -> None:
    """But for commands, whose errors typer shows."""
    silent = [
        place
        for place, node, words in public_functions()
        if not place.startswith("cli/")
        and (errors := raised(node.body))
        and not re.search("[Rr]aise|[Rr]efuse", words)
        and not any(error in words for error in errors)
    ]
    assert silent == []
