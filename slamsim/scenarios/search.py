"""Where something begins to fail, found with few trials."""

from __future__ import annotations

from collections.abc import Callable, Sequence

IN_A_ROW = 2
"""So many neighbours must hold before the border is believed: near it the two kinds mix."""


def smallest_failing(fails: Callable[[int], bool], most: int) -> int | None:
    """The smallest number that fails with the ``IN_A_ROW`` numbers below it holding, or None.

    By halving from 1, which is taken to hold, to ``most``; if that holds the answer is None. Then
    downwards until so many hold in a row, for failing need not be monotone. ``fails`` is asked
    once for a number.
    """
    known: dict[int, bool] = {1: False}

    def failing(number: int) -> bool:
        if number not in known:
            known[number] = fails(number)
        return known[number]

    if not failing(most):
        return None
    holding, found = 1, most
    while found - holding > 1:
        middle = (holding + found) // 2
        if failing(middle):
            found = middle
        else:
            holding = middle
    below = found - 1
    while below > max(found - 1 - IN_A_ROW, 0):
        if failing(below):
            found = below
        below -= 1
    return found


def largest_passing(passes: Callable[[float], bool], ascending: Sequence[float]) -> float | None:
    """The largest value that passes with the next ``IN_A_ROW - 1`` below it, or None.

    From the largest down: at the ends of the list as many as there are must pass.
    """
    in_a_row = 0
    for at in reversed(range(len(ascending))):
        in_a_row = in_a_row + 1 if passes(ascending[at]) else 0
        if in_a_row == IN_A_ROW or (in_a_row and at == 0):
            return ascending[at + in_a_row - 1]
    return None
