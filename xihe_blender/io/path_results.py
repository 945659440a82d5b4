"""Results of a captured camera path, whatever was asked of it. Strict JSON: no NaN and no Infinity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from xihe_blender.io.json_records import Parameters, Plain

Triple = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class PathResults:
    """The part that the results of `xihe placement`, `look` and `budget` have in common."""

    software: dict[str, str]
    machine: dict[str, Plain]
    scene: Annotated[str, "file name"]
    settings: Annotated[Parameters, "of the session, and of what was asked"]
    frames: Annotated[tuple[int, ...], "captured"]
    exposure: Annotated[float, "of the session; errors carry it"]
    notes: Annotated[tuple[str, ...], "what a reader has to know"] = ()
