"""Estimators as shipped, in rooms that nobody here made: how good are they? In coefficients, and in pictures.

    xihe train cache --all-rooms --data ROOM --out SAMPLED      # for each room
    python addon_tests/bench/foreign_rooms.py SAMPLED/clouds_sphere_1280_test ... [--also xihenet]

A room's error is the root mean square over its clouds of the SHC RMSE, from one view and from all of them merged;
every room counts as much. "Over" an estimator is the sum of errors over that one's, with the 90 % interval of a
bootstrap over rooms; wins are rooms in which an error is below `projection`'s and `ambient`'s.

Pictures are those of `xihenet.training.scores`: three spheres under the whole light. Grey is the median over clouds of
how bright the grey sphere is, over its true brightness.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from given import given, words

from xihenet import estimators
from xihenet.codec import facing_of_codes
from xihenet.training.dataset import CloudSet, open_split
from xihenet.training.scores import sphere_errors

VIEWS: dict[str, Callable[[np.ndarray], np.ndarray]] = {"one view": lambda n: n == 1, "merged": lambda n: n > 1}
PICTURES = ("rmse", "si_rmse", "angular_deg")
L00 = 0


class Case(NamedTuple):
    """One room from one view or from all."""

    clouds: CloudSet
    rows: np.ndarray
    lights: dict[str, np.ndarray]  # (M, 9, 3) by estimator and target

    def error(self, name: str, target: str) -> float:
        light = self.lights[f"{name} {target}"]
        return float(np.sqrt(np.mean((light - self.clouds.truth(target)[self.rows]) ** 2)))

    def pictures(self, name: str) -> dict[str, float]:
        """Mean over the three spheres of each error under the whole light, and the grey sphere's brightness."""
        truth = self.clouds.truth("hdr")[self.rows].astype(np.float64)
        spheres = sphere_errors(self.lights[name], truth).values()
        means = {part: float(np.mean([getattr(one, part) or 0 for one in spheres])) for part in PICTURES}
        brightness = self.lights[name][:, L00].mean(axis=1) / truth[:, L00].mean(axis=1)
        return means | {"grey": float(np.median(brightness))}


def lights_of(clouds: CloudSet, names: list[str]) -> dict[str, np.ndarray]:
    """Of every cloud, by estimator and target."""
    srgb, known, facing = clouds.srgb_u8 / np.float32(255), clouds.is_set, facing_of_codes(clouds.facing_i8)
    distance_m = np.linalg.norm(np.asarray(clouds.points_m, np.float32), axis=2) * known
    ambient = np.zeros((len(clouds), 9, 3))
    ambient[:, L00] = clouds.ambient * np.sqrt(4 * np.pi)
    lights = {f"ambient {target}": ambient for target in ("ldr", "hdr")}
    for name in names:
        for target in ("ldr", "hdr"):
            estimator = estimators.load(name, known.shape[1], target)
            lights[f"{name} {target}"] = estimator.estimate_batch(srgb, distance_m, known, facing=facing)
    return lights


def over(cases: list[Case], name: str, base: str, target: str) -> str:
    """The ratio of two estimators' errors with its interval."""
    errors = np.array([[case.error(name, target), case.error(base, target)] for case in cases])
    drawn = errors[np.random.default_rng(0).integers(0, len(errors), (2000, len(errors)))].sum(axis=1)
    low, high = np.percentile(drawn[:, 0] / drawn[:, 1], [5, 95])
    wins = int((errors[:, 0] < errors[:, 1]).sum())
    mean = np.exp(np.mean(np.log(errors[:, 0] / errors[:, 1])))
    ratio = errors[:, 0].sum() / errors[:, 1].sum()
    return f"{ratio:.3f} ({low:.2f} to {high:.2f}), geometric mean {mean:.3f}, wins {wins} of {len(errors)}"


def main() -> None:
    options = given(__doc__, "sampled+", also=(words, []))
    names = ["projection", "lattice", *options.also]
    by_views: dict[str, list[Case]] = {views: [] for views in VIEWS}
    for folder in options.sampled:
        clouds = open_split(folder, "test")
        lights = lights_of(clouds, names)
        for views, chosen in VIEWS.items():
            rows = np.flatnonzero(chosen(np.asarray(clouds.n_views)))
            case = Case(clouds, rows, {name: light[rows] for name, light in lights.items()})
            by_views[views].append(case)
            errors = (f"{name} {target} {case.error(name, target):.4f}" for target in ("ldr", "hdr") for name in
                      ("ambient", *names))  # fmt: skip
            print(f"{folder.parent.name:28s} {views:8s}", *errors, sep="  ")
    for views, cases in by_views.items():
        for target in ("ldr", "hdr"):
            for name in names[1:]:
                for base in ("ambient", *(base for base in names if base != name)):
                    print(f"{views}, {target}: {name} over {base} {over(cases, name, base, target)}")
        shown = {name: [case.pictures(name) for case in cases] for name in cases[0].lights}
        for name, rooms in shown.items():
            means = "  ".join(f"{part} {np.mean([one[part] for one in rooms]):.3f}" for part in PICTURES)
            grey = np.median([one["grey"] for one in rooms])
            print(f"{views}, pictures: {name:16s} {means}  grey {grey:.2f}")
        for target in ("ldr", "hdr"):
            wins = {
                part: sum(
                    min(shown[base][i][part] for base in ("projection ldr", "ambient ldr"))
                    > shown[f"lattice {target}"][i][part]
                    for i in range(len(cases))
                )
                for part in PICTURES
            }
            print(f"{views}, pictures: lattice {target} beats projection and ambient in", wins, f"of {len(cases)}")


if __name__ == "__main__":
    main()
