"""A hard case: input that breaks mathematics if it can be broken, what must come out, and what a naive version gives.

A case is a row of a parametrised test, and its id reads like a sentence after the stage of its module. `comes_out`
asserts that the code which ships is right and that the naive version, the way one would write it in a hurry, is not, so
that the case is known to be able to fail. A refusal has no naive version: whatever answers fails it. Warnings are
errors here as in all tests. `pytest --catalogue` prints the cases that ran as a table.
"""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from xihe_blender.errors import UserError

REFUSALS = (ValueError, UserError)
WAYS_TO_FAIL = (*REFUSALS, ArithmeticError, IndexError, RuntimeWarning)
"""What numbers can do to code. Anything else is a mistake in a case, and is not caught."""

SHOWN_NUMBERS = 4
WIDTHS = {"stage": 14, "case": 66, "what must come out": 40, "what came": 44, "the naive version": 32, "ok": 3}


@dataclass(frozen=True, eq=False)
class Must:
    """What must come out: in words for the table, and as a check, which for a refusal is given the error."""

    says: str
    holds: Callable[[Any], bool]
    is_refusal: bool = False


def case(name: str, *values: Any) -> Any:
    """A row of a parametrised test."""
    return pytest.param(*values, id=name)


def row(name: str, given: Any, ask: Callable[[Any], Any], must: Must, naive: Callable[[Any], Any] | None = None) -> Any:
    """A row of a test that takes all that `comes_out` does."""
    return case(name, given, ask, must, naive)


def each(rows: Iterable[Any]) -> Any:
    """The test of such rows, for a module to give a name to."""

    @pytest.mark.parametrize(("given", "ask", "must", "naive"), rows)
    def test(given: Any, ask: Any, must: Must, naive: Any, comes_out: Any) -> None:
        assert comes_out(given, ask, must, naive)

    return test


@pytest.fixture
def comes_out(request):
    """True where `ask(given)` is what must come out and the naive answer is not; else AssertionError says what came."""

    def check(given: Any, ask: Callable[[Any], Any], must: Must, naive: Callable[[Any], Any] | None = None) -> bool:
        came, is_right = tried(given, ask, must)
        instead, is_naive_right = tried(given, naive, must) if naive else ("", False)
        words = [request.module.STAGE, case_name(request.node), must.says, came, instead]
        is_ok = "yes" if is_right and not is_naive_right else "NO"
        request.node.user_properties.append(("hard_case", [*words, is_ok]))
        assert is_right, f"expected {must.says}, got {came}"
        assert not is_naive_right, f"this case cannot fail: the naive version gives {instead} as well"
        return True

    return check


def case_name(item: Any) -> str:
    """The id of a row, or the sentence that a test's name is."""
    is_row = hasattr(item, "callspec")
    return item.callspec.id if is_row else item.name.removeprefix("test_").replace("_", " ")


def tried(given: Any, ask: Callable[[Any], Any], must: Must) -> tuple[str, bool]:
    """What came, in words, and whether it is what must."""
    try:
        came = ask(given)
    except WAYS_TO_FAIL as error:
        is_right = must.is_refusal and isinstance(error, REFUSALS) and must.holds(error)
        return f"{type(error).__name__}: {error}", is_right
    return shown(came), not must.is_refusal and bool(must.holds(came))


# ------------------------------------------------------------------------------------------------- what must come out


def equal(value: Any) -> Must:
    """Exactly `value`, of its shape."""
    return Must(
        shown(value), lambda came: np.shape(came) == np.shape(value) and bool(np.all(came == np.asarray(value)))
    )


def near(value: ArrayLike, within: float) -> Must:
    """Numbers no farther than `within` from `value`."""
    wanted = np.asarray(value, float)
    says = f"{shown(wanted)} within {within:g}"
    return Must(says, lambda came: bool(np.all(np.abs(np.asarray(came, float) - wanted) <= within)))


def at_most(bound: float) -> Must:
    """Numbers from 0 to `bound`: an error, mostly."""
    return Must(f"0 to {bound:g}", lambda came: bool(np.all((np.asarray(came) >= 0) & (np.asarray(came) <= bound))))


def refused(words: str) -> Must:
    """A ValueError that says `words`."""
    return Must(f"refused: {words}", lambda error: words in str(error), is_refusal=True)


def that(says: str, holds: Callable[[Any], bool]) -> Must:
    """Whatever `holds` says."""
    return Must(says, holds)


# ------------------------------------------------------------------------------------------------------- the catalogue


def table(cases: Sequence[Sequence[str]]) -> Iterable[str]:
    """Lines: a row for each case, cells that are too long shortened, and how many there are of each stage."""
    for cells in (list(WIDTHS), ["-" * width for width in WIDTHS.values()], *cases):
        fitted = (
            textwrap.shorten(cell, width, placeholder="...").ljust(width)
            for cell, width in zip(cells, WIDTHS.values(), strict=True)
        )
        yield " | ".join(fitted).rstrip()
    stages = Counter(cells[0] for cells in cases)
    yield ""
    yield ", ".join(f"{stage} {n}" for stage, n in stages.items())
    yield f"{len(cases)} cases, {sum(cells[-1] == 'NO' for cells in cases)} wrong"


def shown(value: Any) -> str:
    """Short, for a cell of the table."""
    if isinstance(value, tuple):
        return ", ".join(map(shown, value))
    if isinstance(value, float | np.floating):
        return f"{value:.4g}"
    if isinstance(value, np.ndarray):
        if value.size <= SHOWN_NUMBERS:
            return "[" + ", ".join(shown(number) for number in value.ravel().tolist()) + "]"
        return f"{value.dtype} {value.shape}, {shown(value.min())} to {shown(value.max())}"
    return str(value)
