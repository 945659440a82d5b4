"""Words for numbers: the one place where a number, a share, a duration or a size becomes text that people read.

Pages, terminals and Blender's panels all take the words from here, so the spaces are plain ones; a page keeps a number
and its unit on one line itself (see `xihe_blender.report.document`). Rejected: the locale's own formats, since the same
results would then make other pages elsewhere.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Collection, Iterable, Sequence

DASH = "\N{EN DASH}"
MINUS = "\N{MINUS SIGN}"


def format_number(value: float | None, digits: int = 3) -> str:
    """`value` with so many significant digits, without an exponent from 0.0001 to ten million; a dash for None.

    Like all words here it has a true minus.
    """
    if value is None:
        return DASH
    if value == 0:
        return "0"
    # Of the rounded value: 0.09996 is 0.100.
    exponent = int(f"{value:.{digits - 1}e}".partition("e")[2])
    if not -5 < exponent < 7:
        return with_minus(f"{value:.{digits - 1}e}")
    return with_minus(f"{value:,.{max(0, digits - 1 - exponent)}f}")


def with_minus(number: str) -> str:
    """A number as Python writes it, with a true minus, and none before 0."""
    digits = number.removeprefix("-")
    is_zero = not any(digit in "123456789" for digit in digits)
    return digits if is_zero or digits == number else MINUS + digits


def format_signed(value: float | None) -> str:
    """A difference with its sign, a true minus: "+0.021"."""
    if value is None:
        return DASH
    return f"{'+' if value > 0 else MINUS if value < 0 else ''}{format_number(abs(value), 2)}"


def format_quantity(value: float | None, unit: str, digits: int = 3) -> str:
    """`value` and its unit: "4.12 ms"; a dash alone for None."""
    return DASH if value is None else f"{format_number(value, digits)} {unit}"


def format_percent(share: float | None, digits: int | None = None) -> str:
    """A share of 1 as a percentage; without `digits`, which are significant, one decimal where it is below 10 %."""
    if share is None:
        return DASH
    if digits is not None:
        return format_quantity(100 * share, "%", digits)
    return with_minus(f"{100 * share:.{0 if abs(share) >= 0.0995 or share == 0 else 1}f} %")


def format_position(position_m: Sequence[float]) -> str:
    """In metres, by the centimetre: "0.50, 1.20, 0.80"."""
    return ", ".join(with_minus(f"{metres:.2f}") for metres in position_m)


def format_milliseconds(time_ms: float) -> str:
    """A time that was measured: "4.12 ms", "1.3 s", "128 s"."""
    if time_ms < 999.5:
        return f"{time_ms:.3g} ms"
    return f"{time_ms / 1000:.2g} s" if time_ms < 99_500 else f"{time_ms / 1000:,.0f} s"


def format_duration(seconds: float) -> str:
    """A time to wait, rounded: "8 s", "1 min 20 s", "12 min", "2 h 5 min"."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 600:
        return f"{whole // 60} min {whole % 60} s" if whole % 60 else f"{whole // 60} min"
    minutes = round(seconds / 60)
    if minutes < 60:
        return f"{minutes} min"
    return f"{minutes // 60} h {minutes % 60} min" if minutes % 60 else f"{minutes // 60} h"


def format_bytes(n_bytes: float | None, digits: int = 3) -> str:
    """A size in bytes, kB, MB or GB (1 kB is 1,000 bytes)."""
    if n_bytes is None:
        return DASH
    for unit, factor in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if n_bytes >= factor:
            return format_quantity(n_bytes / factor, unit, digits)
    return f"{n_bytes:.0f} bytes"


def format_count(number: int, noun: str) -> str:
    """`number` and its noun: "no frames", "1 frame", "24 frames"."""
    return f"{number or 'no'} {noun}{'' if number == 1 else 's'}"


def format_list(words: Sequence[str]) -> str:
    """`words` as a list in a sentence: "a, b and c"."""
    return " and ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))


def format_names(names: Iterable[str]) -> str:
    """Names with commas between, as the command line takes them: one with a comma, or a space at an end, in quotes."""
    return ", ".join(_quoted(name) if "," in name or name != name.strip().lstrip('"') else name for name in names)


def as_spelled(wanted: Iterable[str], known: Collection[str]) -> list[str]:
    """Names that somebody typed, each as it is in `known`: "é" may be one character or two. Unknown ones stay."""
    spelled = {unicodedata.normalize("NFC", name): name for name in known}
    return [name if name in known else spelled.get(unicodedata.normalize("NFC", name), name) for name in wanted]


def _quoted(name: str) -> str:
    doubled = name.replace('"', '""')
    return f'"{doubled}"'


def format_runs(numbers: Sequence[int]) -> str:
    """Ascending whole numbers with runs of three or more drawn together: "1, 4-9, 12"."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return ", ".join(f"{run[0]}{DASH}{run[-1]}" if len(run) > 2 else ", ".join(map(str, run)) for run in runs)


def format_frames(numbers: Sequence[int]) -> str:
    """Frames by their numbers, ascending: "frame 3", "frames 1, 4-9"."""
    return f"frame{'' if len(numbers) == 1 else 's'} {format_runs(numbers)}"


def format_setting(value: bool | float | str) -> str:
    """The value of an effect's setting: "on", "8,000,000", "0.0019"; a word as it is."""
    if isinstance(value, bool):
        return "on" if value else "off"
    if not isinstance(value, int | float):
        return str(value)
    return f"{value:,.0f}" if float(value).is_integer() else f"{value:,.6g}"
