"""Single lamps: how far is the reference light off under one, where light is known by a formula?

    python addon_tests/bench/lamps.py [--presets draft,balanced,accurate] [--seeds 20]

`hdr`: six lamps, each alone 2 m away in 26 directions, against the coefficients of its disc, or, for area lamps, of a
sum over 200 x 200 pieces. Then a glowing disc of 0.1, 0.25 and 0.6 m radius 2 m above the position, in an otherwise
black scene, by every preset and seed: whole and clipped light against its solid angle.
"""

from __future__ import annotations

import itertools
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from given import given, words

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "addon_tests" / "in_blender")]

from test_reference_probe import (  # noqa: E402
    DISTANCE_M,
    GLOW,
    LAMPS,
    POSITION,
    add_lamp,
    dark_scene,
    measured,
    of_a_disc,
    scene_with_a_glowing_disc,
)

from xihe_blender.io.blender_output import only_our_output  # noqa: E402
from xihe_blender.previs.presets import PRESETS  # noqa: E402
from xihe_blender.previs.settings import PrevisSettings  # noqa: E402
from xihenet.sh import basis  # noqa: E402

DIRECTIONS = [np.array(d) / np.linalg.norm(d) for d in itertools.product((-1, 0, 1), repeat=3) if any(d)]
AREAS_M, PIECES = (0.5, 10.0), 200


def axes_of_an_area(direction):
    """(3, 3) the axes of a square lamp that faces the position from `direction`, as columns."""
    across = np.cross(direction, (0, 0, 1) if abs(direction[2]) < 0.9 else (1, 0, 0))
    across /= np.linalg.norm(across)
    return np.stack([across, np.cross(direction, across), direction], axis=1)


def of_an_area(power, size_m, direction):
    """(9, 3) coefficients of a square lamp that faces the position: a sum over pieces of it."""
    steps = ((np.arange(PIECES) + 0.5) / PIECES - 0.5) * size_m
    u, v = (plane.ravel() for plane in np.meshgrid(steps, steps))
    points = np.stack([u, v, np.full(len(u), DISTANCE_M)], axis=1) @ axes_of_an_area(direction).T
    far = np.linalg.norm(points, axis=1)
    solid_angles = (size_m / PIECES) ** 2 * (DISTANCE_M / far) / far**2
    radiance = power / (math.pi * size_m**2)
    sums = basis(points / far[:, None], 2).T @ (radiance * solid_angles)
    return np.repeat(sums[:, None], 3, axis=1)


def lamps(settings):
    """Print mean and most of the relative errors of each lamp over DIRECTIONS."""
    off = {name: [] for name in [*LAMPS, *(f"area of {size} m" for size in AREAS_M)]}
    for direction in DIRECTIONS:
        for name, (values, at_position, half_angle) in LAMPS.items():
            scene = dark_scene()
            add_lamp(scene, direction=direction, **values)
            off[name].append((measured(scene, settings).hdr, of_a_disc(at_position, direction, half_angle)))
        for size in AREAS_M:
            scene = dark_scene()
            lamp = add_lamp(scene, "AREA", direction, energy=100.0, size=size)
            matrix = np.eye(4)
            matrix[:3, :3], matrix[:3, 3] = axes_of_an_area(direction), POSITION + DISTANCE_M * direction
            lamp.matrix_world = matrix.T.tolist()
            off[f"area of {size} m"].append((measured(scene, settings).hdr, of_an_area(100.0, size, direction)))
    for name, pairs in off.items():
        errors = [np.linalg.norm(found - light) / np.linalg.norm(light) for found, light in pairs]
        print(f"{name}: {100 * np.mean(errors):.2f} % on average, {100 * np.max(errors):.2f} % at most", flush=True)


def discs(preset, n_seeds):
    """Print how far whole and clipped light of a glowing disc above are off, over the seeds."""
    for radius_m in (0.1, 0.25, 0.6):
        scene = scene_with_a_glowing_disc(radius_m)
        # A polygon of 64 corners has 0.9984 of its circle's area.
        solid_angle = 2 * math.pi * (1 - math.cos(math.atan(radius_m / DISTANCE_M))) * 0.9984
        settings = PrevisSettings(preset=preset).reference
        found = [measured(scene, replace(settings, seed=seed)) for seed in range(n_seeds)]
        whole = np.array([light.hdr[0, 0] for light in found]) * np.sqrt(4 * np.pi) / (GLOW * solid_angle) - 1
        clipped = np.array([light.ldr[0, 0] for light in found]) * np.sqrt(4 * np.pi) / solid_angle - 1
        print(
            f"{preset}, disc of {radius_m} m: whole {100 * np.abs(whole).max():.1f} % at most; clipped, mean of "
            f"{n_seeds} seeds {100 * clipped.mean():+.1f} %, each {100 * np.abs(clipped).max():.1f} % at most "
            f"(promise {100 * PRESETS[preset].noise_target:g} %)",
            flush=True,
        )


def main():
    options = given(__doc__, presets=(words, list(PRESETS)), seeds=20)
    lamps(PrevisSettings(preset=options.presets[0]).reference)
    for preset in options.presets:
        discs(preset, options.seeds)


if __name__ == "__main__":
    with only_our_output():
        main()
