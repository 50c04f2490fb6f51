"""What docstrings must say: where numbers come from, shapes of arrays, errors that are raised."""

from __future__ import annotations

import ast
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
