"""What comes of a broken scene: the whole chain on it as small as it gets, and what must come out, as checks."""

import functools
import math
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np
from previs_runs import QuickPrevis, run

from addon_tests.hard_case import Must
from addon_tests.in_blender.hard_cases.broken_scenes import room
from xihe_blender.capture.render import RenderSettings, render_passes
from xihe_blender.capture.scanner import first_layer, open_scanner
from xihe_blender.errors import UserError

TINY = QuickPrevis(preset="draft", size=(16, 12), samples=1, estimator="projection", target="ldr")
STANDING_NOTES = 4
"""How many notes stand in the results of every run."""

WHITE = math.sqrt(4 * math.pi)
"""The constant coefficient of light that is white all round, the most that clipped light can have."""


@dataclass(frozen=True, eq=False)
class Came:
    """Of a run: coefficients by estimation position (K, 9, 3), those of the light probes, faults and notes."""

    lights: np.ndarray
    truths: np.ndarray
    faults: tuple[tuple[str, int], ...]
    said: tuple[str, ...]

    @property
    def is_plausible(self):
        """Finite, nowhere more than white, and not negative on the whole."""
        both = np.concatenate([self.lights, self.truths])
        return bool(np.isfinite(both).all() and (np.abs(both) <= WHITE * 1.01).all() and (both[:, 0] >= 0).all())

    def __str__(self):
        pairs = zip(self.lights, self.truths, strict=True)
        means = ", ".join(f"{light[0].mean():.2g} of {truth[0].mean():.2g}" for light, truth in pairs)
        return "; ".join([means or "no light", *self.said[STANDING_NOTES:]])


def previsualised(changes):
    """The whole chain, to results.json on disk, whose promises are checked."""
    with tempfile.TemporaryDirectory() as folder:
        results = run(room(*several(changes)), Path(folder) / "out", TINY)
        report = (Path(folder) / "out" / "report.html").read_text(encoding="utf-8")
        assert all(escape(fault["said"]) in report for fault in results["scene"]["faults"])
    probes = [probe for entry in results["frames"] for probe in entry["probes"]]
    lights, truths = (np.array([probe[key] for probe in probes]).reshape(-1, 9, 3) for key in ("sh", "sh_truth"))
    faults = tuple((fault["name"], fault["n"]) for fault in results["scene"]["faults"])
    return Came(lights, truths, faults, tuple(results["notes"]))


def several(changes):
    return changes if isinstance(changes, Sequence) else (changes,)


def believed(changes):
    """Naive: one render, whose mean is the light; the scene is not looked at, and nothing is clipped or said."""
    scene = room(*several(changes))
    with open_scanner(scene, RenderSettings((16, 12), samples=1)) as scanner:
        mean = first_layer(render_passes(scanner.scene))[0].astype(np.float64).mean(axis=(0, 1))
    light = np.zeros((1, 9, 3))
    light[0, 0] = mean * WHITE
    return Came(light, light, (), ())


@functools.lru_cache(maxsize=8)
def known(*changes):
    return previsualised(changes)


def lit(n_positions=1):
    """A plausible light at so many positions."""
    says = "a finite light of at most white" + ("" if n_positions == 1 else f" at {n_positions} positions")
    # What a session believes in, at its own exposure, comes with notes; scene radiance has none.
    return Must(says, lambda came: came.is_plausible and len(came.lights) == n_positions and bool(came.said))


def says(words, *, n=0):
    """A plausible light, and a sentence in the results; with `n`, as a fault that is counted."""

    def holds(came):
        is_said = any(words in sentence for sentence in came.said)
        return came.is_plausible and is_said and (n == 0 or n in [number for _, number in came.faults])

    return Must(f"a finite light, and said: {words}", holds)


def same_light(says, *changes, within=1e-9):
    """The light of another scene, which `says` names, in estimates and light probes."""

    def holds(came):
        other = known(*changes)
        pairs = ((came.lights, other.lights), (came.truths, other.truths))
        return came.is_plausible and all(a.shape == b.shape and np.abs(a - b).max() <= within for a, b in pairs)

    return Must(f"the light {says}", holds)


def refused(words):
    """A UserError of one line that says `words`."""

    def holds(error):
        return isinstance(error, UserError) and "\n" not in str(error) and words in str(error)

    return Must(f"refused: {words}", holds, is_refusal=True)
