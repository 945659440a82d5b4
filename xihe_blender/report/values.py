"""Values as the reports of a run, a batch and a frontier show them: text is escaped where it enters the page.

Rejected: a template library, which the add-on would have to bundle for one page.
"""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Mapping

from xihe_blender.io.run_results import Metrics
from xihenet.formats import format_count, format_percent

FEW_PIXELS = 100
"""Of fewer pixels of an object than this, more than a third are its edge."""


def escape(value: object) -> str:
    """`value` as HTML text, safe inside an element and inside a quoted attribute."""
    return html.escape(str(value), quote=True)


def code(value: object) -> str:
    """A name that the user can type: a method, a file, a setting."""
    return f"<code>{escape(value)}</code>"


def mean(values: Iterable[float | None]) -> float | None:
    """Of those that are finite numbers; None where there are none."""
    numbers = [value for value in values if value is not None and math.isfinite(value)]
    return math.fsum(numbers) / len(numbers) if numbers else None


def rmse_of(comparison: Mapping[str, Metrics], method: str) -> float | None:
    """None for a method that was not compared or has no value."""
    return comparison[method].rmse if method in comparison else None


def too_small_to_judge(object_pixels: float | None) -> str | None:
    """Said of virtual objects that cover only `object_pixels` of a picture on average; None where they cover enough."""
    if object_pixels is None or not 0 < object_pixels < FEW_PIXELS:
        return None
    pixels = format_count(max(1, round(object_pixels)), "pixel")
    return f"the virtual objects cover only {pixels} of a picture, too few to judge by"


def closeness(comparison: Mapping[str, Metrics], method: str) -> float | None:
    """How much closer to the ground truth `method` is than `ambient`: 1 - rmse / rmse of `ambient`.

    1 is a perfect match, 0 as close as `ambient`, negative is further away. None where one of the two is None, or
    where `ambient` matches exactly, so that nothing can be closer.
    """
    own, ambient = rmse_of(comparison, method), rmse_of(comparison, "ambient")
    return None if own is None or not ambient else 1.0 - own / ambient


def format_closeness(closer: float) -> str:
    """`closeness` as the middle of a sentence: "31 % closer", "12 % further", "3.1 times the error", "as close"."""
    if abs(closer) < 0.0005:
        return "as close"
    if closer < -1:
        return f"{1 - closer:.1f} times the error"
    return f"{format_percent(abs(closer))} {'closer' if closer > 0 else 'further'}"
