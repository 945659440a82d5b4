"""How does a value of results.json become words in the report?

Every value may be null, so each is read through `finite`, `mapping` or `items`, and shown through one of the formats
here; nothing else in the report turns a number into text. Text from the results is escaped where it enters the page.
Rejected: a template library, which the add-on would have to bundle for one page.
"""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

DASH = "\N{EN DASH}"
MINUS = "\N{MINUS SIGN}"
_SPACE = "\N{NARROW NO-BREAK SPACE}"


def escape(value: object) -> str:
    """`value` as HTML text, safe inside an element and inside a quoted attribute."""
    return html.escape(str(value), quote=True)


def code(value: object) -> str:
    """A name that the user can type: a method, a file, a setting."""
    return f"<code>{escape(value)}</code>"


def finite(value: Any) -> float | None:
    """`value` as a float; None for null, NaN, infinity and everything that is not a number."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)


def finite_only(values: Iterable[Any]) -> list[float]:
    """The numbers among `values`."""
    return [number for number in map(finite, values) if number is not None]


def mean(values: Iterable[Any]) -> float | None:
    """Mean of the numbers among `values`, None where there are none."""
    numbers = finite_only(values)
    return math.fsum(numbers) / len(numbers) if numbers else None


def mapping(source: Any, key: str) -> Mapping[str, Any]:
    """The object at `key`; empty where it is missing or null."""
    value = source.get(key)
    return value if isinstance(value, Mapping) else {}


def items(source: Any, key: str) -> Sequence[Any]:
    """The list at `key`; empty where it is missing or null."""
    value = source.get(key)
    return value if isinstance(value, list | tuple) else ()


def significant(value: float | None, digits: int = 3) -> str:
    """`value` with so many significant digits, without an exponent from 0.0001 to ten million; a dash for None."""
    if value is None:
        return DASH
    if value == 0:
        return "0"
    exponent = math.floor(math.log10(abs(value)))
    if not -5 < exponent < 7:
        return f"{value:.{digits - 1}e}"
    return f"{value:,.{max(0, digits - 1 - exponent)}f}"


def percent(share: float | None) -> str:
    """A share of 1 as a percentage, with one decimal where it is below 10 %."""
    if share is None:
        return DASH
    decimals = 0 if abs(share) >= 0.0995 or share == 0 else 1
    return f"{100 * share:.{decimals}f}{_SPACE}%"


def with_unit(value: float | None, unit: str, digits: int = 3) -> str:
    """`value` and its unit on one line; a dash alone for None."""
    return DASH if value is None else f"{significant(value, digits)}{_SPACE}{unit}"


def byte_size(n_bytes: float | None) -> str:
    """A size in bytes, kB or MB (1 kB is 1,000 bytes)."""
    if n_bytes is None:
        return DASH
    for unit, factor in (("MB", 1e6), ("kB", 1e3)):
        if n_bytes >= factor:
            return with_unit(n_bytes / factor, unit)
    return f"{n_bytes:.0f}{_SPACE}bytes"


def counted(number: int, noun: str) -> str:
    """`number` and its noun: "no frames", "1 frame", "24 frames"."""
    return f"{number or 'no'} {noun}{'' if number == 1 else 's'}"


def listed(words: Sequence[str]) -> str:
    """`words` as a list in a sentence: "a, b and c"."""
    return " and ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))


def number_runs(numbers: Sequence[int]) -> str:
    """Ascending whole numbers with runs of three or more drawn together: "1, 4-9, 12"."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return ", ".join(f"{run[0]}{DASH}{run[-1]}" if len(run) > 2 else ", ".join(map(str, run)) for run in runs)


def frames_told(numbers: Sequence[int]) -> str:
    """Frames by their numbers, ascending: "frame 3", "frames 1, 4-9"."""
    return f"frame{'' if len(numbers) == 1 else 's'} {number_runs(numbers)}"


def closeness(comparison: Mapping[str, Any], method: str) -> float | None:
    """How much closer to the ground truth `method` is than `ambient`: 1 - rmse / rmse of `ambient`.

    1 is a perfect match, 0 as close as `ambient`, negative is further away. None where one of the two is null, or
    where `ambient` matches exactly, so that nothing can be closer.
    """
    own, ambient = (finite(mapping(comparison, name).get("rmse")) for name in (method, "ambient"))
    return None if own is None or not ambient else 1.0 - own / ambient


def closeness_in_words(closer: float) -> str:
    """`closeness` as the middle of a sentence: "31 % closer", "12 % further", "3.1 times as far", "as close"."""
    if abs(closer) < 0.0005:
        return "as close"
    if closer < -1:
        return f"{1 - closer:.1f} times as far"
    return f"{percent(abs(closer))} {'closer' if closer > 0 else 'further'}"
