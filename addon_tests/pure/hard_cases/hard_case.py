"""What is a hard case, and how is it seen that one can fail?

A case is data: the stage, a name that reads like a sentence, the input, what is asked of it, and what must come out.
With it comes a naive version of the same question, the way one would write it in a hurry; it must fail the case, so
that every case is known to be able to fail. Both are run with warnings as errors: a NumPy warning is a wrong answer.

Chosen over one test function per case, so that the same cases run as tests and are printed as a table.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from xihe_blender.errors import UserError

REFUSALS = (ValueError, UserError)
WAYS_TO_FAIL = (*REFUSALS, ArithmeticError, IndexError, RuntimeWarning)
"""What numbers can do to code. Anything else is a mistake in the catalogue, and is not caught."""

SHOWN_NUMBERS = 4


@dataclass(frozen=True, eq=False)
class Must:
    """What must come out: in words for the table, and as a check.

    Parameters
    ----------
    says : what must come out
    holds : whether what came is that
    is_refusal : a ValueError or a UserError must come out, and `holds` is given the error
    """

    says: str
    holds: Callable[[Any], bool]
    is_refusal: bool = False


@dataclass(frozen=True, eq=False)
class HardCase:
    """One input that breaks mathematics if it can be broken.

    Parameters
    ----------
    stage : the word of the chain, or the branch of mathematics under it
    name : reads like a sentence after its stage
    given : the input
    ask : what is asked, of `given`, of the code that ships
    must : what must come out
    naive : the same question, answered in a hurry; fails
    """

    stage: str
    name: str
    given: Any
    ask: Callable[[Any], Any]
    must: Must
    naive: Callable[[Any], Any]

    def __str__(self) -> str:
        return f"{self.stage}: {self.name}"


@dataclass(frozen=True)
class Outcome:
    """What came out of a case, in words, and whether it is what must."""

    came: str
    is_ok: bool


def tried(case: HardCase, ask: Callable[[Any], Any]) -> Outcome:
    """What `ask`, the case's own or its naive one, makes of the case."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            came = ask(case.given)
    except WAYS_TO_FAIL as error:
        is_ok = case.must.is_refusal and isinstance(error, REFUSALS) and case.must.holds(error)
        return Outcome(f"{type(error).__name__}: {error}", is_ok)
    return Outcome(shown(came), not case.must.is_refusal and bool(case.must.holds(came)))


def assert_right(case: HardCase) -> None:
    """What comes out is what must."""
    outcome = tried(case, case.ask)
    assert outcome.is_ok, f"expected {case.must.says}, got {outcome.came}"


def assert_can_fail(case: HardCase) -> None:
    """Its naive version does fail."""
    outcome = tried(case, case.naive)
    assert not outcome.is_ok, f"this case cannot fail: the naive version gives {outcome.came} as well"


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
