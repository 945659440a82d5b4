"""The key light of an estimate: its dominant light as a direction that casts a shadow, and the light that is left.

A key light is a disc of even radiance far away. Its coefficients are its irradiance, on a surface that faces it, times
the basis in its direction times (2 / (1 + c), 1, c) for l = 0, 1, 2, with c the cosine of its angular radius (the
integral of Legendre's polynomials over the disc). What is left is the estimate without them, so that both together are
the estimate, exactly.

Where is it? Bright patches of the sphere that the phone has seen come first: nobody doubts a lamp in the picture, while
bands 1 and 2 of an estimate point beside it as soon as there are two. A picture says how strong a patch is, too, unless
it is clipped; only then may it be as much stronger as the estimate has it. What the pictures do not show, or show far
too weak for what the estimate says, is looked for in the estimate: the two directions that explain its bands best,
found in turns, each in what the other leaves. How strong each is, least squares say, drawn to what was seen.

There is none in flat light, in the dark, and where a second light elsewhere is as strong within a tenth. A key light
stays where it was as long as what is there is nearly as strong as the strongest, or explains the estimate nearly as
well: it does not jump between two lamps.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from xihenet.colour import LUMINANCE, srgb_to_linear
from xihenet.records import ArrayBool, ArrayF64, KeyLight, ObjectLight, UnitSphereCloud
from xihenet.sh_basis import checked_sh
from xihenet.sphere import AnchorLattice

BRIGHT_OF_BRIGHTEST, BRIGHT_OF_MEDIAN = 0.5, 2.5
"""An anchor belongs to a bright patch from these shares of the brightest and of the median of what was seen on."""

MOST_PATCHES = 6
WIDEST_PATCH = float(np.radians(30))
"""Larger ones cast no shadow worth the name: a sunlit floor, a wall beside a lamp."""

SAME_LIGHT_COSINE = float(np.cos(np.radians(25)))
"""Two patches nearer than this are one light: lamps of one chandelier, panes of one window."""

MOST_MIDDLES = 300
N_SHIFTS = 4
BELL = 1 / (1 - math.cos(math.radians(15)))
WHITE = 0.95
"""An anchor with a channel from this on, encoded, may be brighter than a picture shows."""

MOST_OF_SEEN = 1.5
"""As many times what was seen of it is a patch that is not clipped, at most: small ones are caught by few anchors."""

SEEN_COUNTS, UNSEEN_COUNTS = 0.3, 0.6
"""How much what was seen of a light counts against what the estimate says, and that nothing was."""

SURE_FROM = 0.4
"""Certainty of a key light from which on metal shows all of its light. Measured in docs/reflections.md."""

SEEN_IS_ENOUGH = 0.6
"""Patches that explain this share of what the estimate's own directions explain are taken for them."""

LAMP_SHOWS = 0.015
"""A clipped patch that shows this share of all light, or more, is a lamp, wherever the estimate points."""

EQUAL = 0.9
LEAST_FLUX = 0.08
"""Share of all light that has to come from the key light: less is flat light."""

STAYS_FROM = 0.5
UNSEEN_WEIGHS = 2 / 3
"""A light that only the estimate implies is the key light if it is half as strong again as one that was seen."""

EXPLAINS_AS_WELL = 0.8
N_TURNS = 40
N_ASCENT, N_STEPS = 40, 3
SWEEPS = 60
UNSEEN_RADIUS = float(np.radians(20))
"""Of a light that only the estimate implies: nobody knows how large it is, and smaller ones draw glints that are not
there (docs/key_light.md)."""

SMALLEST_RADIUS, LARGEST_RADIUS = float(np.radians(0.25)), float(np.radians(40))


@dataclass(frozen=True, eq=False)
class _Candidate:
    """Of a patch that was seen, `irradiance` is what it showed on a surface that faces it."""

    direction: ArrayF64
    angular_radius: float
    is_seen: bool
    irradiance: float = 0.0
    may_be_brighter: bool = True


def find_key_light(
    sh_radiance: ArrayLike,
    cloud: UnitSphereCloud | None = None,
    lattice: AnchorLattice | None = None,
    previous: KeyLight | None = None,
    *,
    is_exposed: bool = True,
    expected_error: float | None = None,
) -> KeyLight | None:
    """The key light of an estimate; None in flat light, in the dark, and for two lights of one strength.

    Parameters
    ----------
    sh_radiance : (9, 3) radiance coefficients, linear
    cloud, lattice : what was seen from the position, if anything was; the lattice is the cloud's. A fine one knows
        better where a lamp is, see `xihenet.light.reflections`
    previous : the key light of the estimate before, which stays while it is at least half as strong as the strongest;
        what was not seen counts two thirds
    is_exposed : whether the cloud carries the exposure of the coefficients; else its ratios alone count
    expected_error : SHC RMSE that the estimator expects of itself, for the key light's certainty; None if it says none

    ValueError for coefficients that are not finite or not of order 2, and for a cloud without its lattice.
    """
    coefficients, order = checked_sh(sh_radiance)
    if order != 2:
        raise ValueError(f"find_key_light: expected coefficients of order 2, got order {order}")
    if cloud is not None and (lattice is None or len(lattice) != len(cloud)):
        raise ValueError(f"find_key_light: expected the lattice of the cloud's {len(cloud)} anchors")
    luminance = coefficients @ LUMINANCE
    if luminance[0] <= 0 or not np.any(luminance[1:]):
        return None
    candidates = _candidates(luminance, cloud, lattice, previous, is_exposed)
    strengths = _strengths(luminance, candidates)
    chosen = _chosen(candidates, strengths, previous)
    if chosen is None:
        return None
    key = _fitted(coefficients, candidates[chosen], strengths[chosen])
    flux = sh_of_key_light(key)[0] @ LUMINANCE
    stays = previous is not None and _is_same(key.direction, previous.direction)
    if flux < LEAST_FLUX * luminance[0] * (STAYS_FROM if stays else 1):
        return None
    return replace(key, certainty=certainty_of(key, expected_error))


def sh_of_key_light(key: KeyLight | None) -> ArrayF64:
    """Its radiance coefficients, (9, 3); zeros for None."""
    if key is None:
        return np.zeros((9, 3))
    return _of_disc(key.direction, key.angular_radius)[:, None] * key.irradiance


def certainty_of(key: KeyLight, expected_error: float | None) -> float:
    """0 to 1: the square of its size over that and the square of the SHC RMSE that the estimator expects; 1 for None.

    Its size is the root mean square of its coefficients of bands 1 and 2. By so much is a signal with noise of that
    size to be multiplied to be right in the mean square (Wiener's filter).
    """
    if expected_error is None:
        return 1.0
    size = math.hypot(*sh_of_key_light(key)[1:].flat) / math.sqrt(24)  # Its squares may not fit float64.
    error_of_size = expected_error / size if size else math.inf
    return 1 / (1 + error_of_size * error_of_size)


def sure_share(key: KeyLight) -> float:
    """0 to 1: the share of a key light that mirrors show, which rises with its certainty."""
    return min(key.certainty / SURE_FROM, 1.0)


def sure_part(key: KeyLight) -> KeyLight:
    """A key light with as much of its light as rough metal shows: all of one that was seen, else that share."""
    return key if key.is_seen else brighter(key, sure_share(key))


def brighter(key: KeyLight, gain: float | ArrayF64) -> KeyLight:
    """The key light times a gain, one number or (3,)."""
    return replace(key, irradiance=key.irradiance * gain)


def rest_of(light: ObjectLight) -> ArrayF64:
    """(9, 3) radiance coefficients of what is left of a light without its key light."""
    return light.sh - sh_of_key_light(light.key)


def mean_light(lights: Sequence[ObjectLight]) -> ObjectLight:
    """One light for an object that has several positions.

    Its key light is the strongest of theirs together with those from the same direction, as strong as it is in the
    mean; the others are a part of what is left. ValueError for no light.
    """
    if not lights:
        raise ValueError("mean_light: expected at least one light")
    if len(lights) == 1:
        return ObjectLight(lights[0].sh, lights[0].key)
    sh = np.mean([light.sh for light in lights], axis=0)
    keys = [light.key for light in lights if light.key is not None]
    if not keys:
        return ObjectLight(sh)
    strongest = max(keys, key=lambda key: float(key.irradiance @ LUMINANCE))
    same = [key for key in keys if _is_same(key.direction, strongest.direction)]
    weights = np.array([max(float(key.irradiance @ LUMINANCE), 1e-12) for key in same])
    direction = _unit(weights @ np.array([key.direction for key in same]))
    radius = float(np.average([key.angular_radius for key in same], weights=weights))
    irradiance = np.sum([key.irradiance for key in same], axis=0) / len(lights)
    most = np.maximum(sh[0], 0) / _of_disc(direction, radius)[0]
    is_seen, certainty = any(key.is_seen for key in same), np.average([key.certainty for key in same], weights=weights)
    return ObjectLight(sh, KeyLight(direction, np.minimum(irradiance, most), radius, is_seen, float(certainty)))


def with_positions(
    light: ObjectLight, places_m: Mapping[str, ArrayF64], each: Mapping[str, ObjectLight]
) -> ObjectLight:
    """`light`, the mean of `each` at the positions `places_m` ((3,) world, metres) of one object, and each of them.

    What is reflected is the mean's everywhere.
    """
    reflected = {name: replace(one, reflections=light.reflections) for name, one in each.items()}
    return replace(light, at=tuple((places_m[name], reflected[name]) for name in places_m))


def _of_disc(direction: ArrayF64, angular_radius: float) -> ArrayF64:
    """(9,) coefficients of a disc whose irradiance is 1."""
    c = math.cos(angular_radius)
    column = np.concatenate([[_Y0 * 2 / (1 + c)], _of_point(direction)])
    column[4:] *= c
    return column


def _candidates(
    luminance: ArrayF64,
    cloud: UnitSphereCloud | None,
    lattice: AnchorLattice | None,
    previous: KeyLight | None,
    is_exposed: bool,
) -> list[_Candidate]:
    """Where the key light may be: bright patches that were seen, or else what the estimate implies."""
    seen = [] if cloud is None or lattice is None else bright_patches(cloud, lattice, is_exposed)
    shows = [one.irradiance for one in seen if is_exposed and one.may_be_brighter]
    if shows and max(shows) >= LAMP_SHOWS * float(luminance[0]) / _Y0:
        return seen
    implied = _implied(luminance, previous)
    if not seen:
        return implied
    if _explained(luminance, seen) >= SEEN_IS_ENOUGH * _explained(luminance, implied):
        return seen
    return seen + [one for one in implied if not any(_is_same(one.direction, other.direction) for other in seen)]


def _implied(luminance: ArrayF64, previous: KeyLight | None) -> list[_Candidate]:
    """Lights that explain the estimate; the one before, if that was one of them and explains it nearly as well."""
    free, *kept = (
        [_Candidate(direction, UNSEEN_RADIUS, False) for direction in _two_directions(luminance, held)]
        for held in (None, *([] if previous is None or previous.is_seen else [previous.direction]))
    )
    if kept and _explained(luminance, kept[0]) >= EXPLAINS_AS_WELL * _explained(luminance, free):
        return kept[0]
    return free


def bright_patches(cloud: UnitSphereCloud, lattice: AnchorLattice, is_exposed: bool = True) -> list[_Candidate]:
    """Bright patches of what was seen, those with most light near their middle first: lamps, windows.

    Bright anchors near each other are one light, and what is wide is none. Of a cloud that is not exposed as the
    estimate, any may be brighter.
    """
    if not cloud.is_set.any():
        return []
    seen = srgb_to_linear(cloud.srgb[cloud.is_set].astype(np.float64)) @ LUMINANCE
    shown = np.zeros(len(cloud))
    shown[cloud.is_set] = seen
    least = max(BRIGHT_OF_BRIGHTEST * seen.max(), BRIGHT_OF_MEDIAN * float(np.median(seen)))
    solid_angle = 4 * np.pi / len(cloud)
    is_lamp = np.zeros(len(cloud), bool)
    for patch in _patches(cloud.is_set & (shown >= least) & (shown > 0), lattice):
        is_lamp[patch] = _radius_of(len(patch) * solid_angle) <= WIDEST_PATCH
    left = np.flatnonzero(is_lamp)
    found: list[_Candidate] = []
    while len(left) and len(found) < MOST_PATCHES:
        middle = _middle(lattice.directions[left], shown[left])
        cosine = lattice.directions[left] @ middle
        of_it = left[cosine > SAME_LIGHT_COSINE]
        radius = float(np.clip(_radius_of(len(of_it) * solid_angle), SMALLEST_RADIUS, LARGEST_RADIUS))
        irradiance = float(shown[of_it] @ cosine[cosine > SAME_LIGHT_COSINE]) * solid_angle
        is_clipped = not is_exposed or bool((cloud.srgb[of_it] >= WHITE).any())
        found.append(_Candidate(middle, radius, True, irradiance, is_clipped))
        left = left[cosine <= SAME_LIGHT_COSINE]
    return found


def _middle(directions: ArrayF64, shown: ArrayF64) -> ArrayF64:
    """(3,) the middle of the light with most light in it, of directions (N, 3) that show some."""
    tried = directions[:: -(-len(directions) // MOST_MIDDLES)]
    # A bell, which has its peak in the middle of an even patch, where a cap has it anywhere.
    near = np.exp((tried @ directions.T - 1) * BELL)
    middle: ArrayF64 = tried[np.argmax(near @ shown)]
    for _ in range(N_SHIFTS):
        is_near = directions @ middle > SAME_LIGHT_COSINE
        middle = _unit(shown[is_near] @ directions[is_near])
    return middle


def _patches(is_bright: ArrayBool, lattice: AnchorLattice) -> list[list[int]]:
    """Indices of the anchors of each connected patch."""
    neighbours, left, patches = lattice.neighbours(min(7, len(lattice))), set(np.flatnonzero(is_bright)), []
    while left:
        patch, open_ones = [], [left.pop()]
        while open_ones:
            anchor = open_ones.pop()
            patch.append(int(anchor))
            around = left.intersection(neighbours[anchor])
            left -= around
            open_ones += around
        patches.append(sorted(patch))
    return patches


def _radius_of(solid_angle: float) -> float:
    return float(np.arccos(np.clip(1 - solid_angle / (2 * np.pi), -1, 1)))


def _two_directions(luminance: ArrayF64, held: ArrayF64 | None) -> list[ArrayF64]:
    """The directions of two point lights that explain bands 1 and 2 best, the stronger first, each found in what the
    other leaves; one where a second adds nothing. `held` (3,) is one of them, wherever the bands point."""
    bands = luminance[1:]
    directions = np.array([_peak(bands) if held is None else held, np.zeros(3)])
    columns = np.zeros((2, 8))
    columns[0] = _of_point(directions[0])
    strengths = np.array([_strength(columns[0], bands), 0.0])
    for turn in range(N_TURNS):
        for one in (1, 0):
            other = 1 - one
            left = bands - strengths[other] * columns[other]
            if one == 1 or held is None:
                directions[one] = _peak(left, directions[one] if turn else None)
            columns[one] = _of_point(directions[one])
            strengths[one] = _strength(columns[one], left)
    if strengths.min() <= 0 or _is_same(*directions):
        return [directions[np.argmax(strengths)]]
    return list(directions[np.argsort(-strengths)])


def _of_point(direction: ArrayF64) -> ArrayF64:
    """(8,) bands 1 and 2 of a point light whose irradiance is 1."""
    x, y, z = direction.tolist()
    band1 = _Y1 * y, _Y1 * z, _Y1 * x
    band2 = x * y, y * z, (z * z - 1 / 3) * _ZZ, x * z, (x * x - y * y) / 2
    return np.array([*band1, *(_Y2 * one for one in band2)])


def _strength(column: ArrayF64, bands: ArrayF64) -> float:
    return max(0.0, float(column @ bands / (column @ column)))


def _peak(bands: ArrayF64, start: ArrayF64 | None = None) -> ArrayF64:
    """(3,) where the light of bands 1 and 2, (8,), is brightest; from `start` on, a few steps towards that.

    In direction d it is v.d + d.M d, and d <- unit(v + 2 (M + s) d) never falls where s is at least the size of M.
    """
    # Plain numbers: arrays of three take ten times as long, and this is most of the time of a split.
    along_y, along_z, along_x = (_Y1 * bands[:3]).tolist()
    xy, yz, zz, xz, xx = (_Y2 * bands[3:]).tolist()
    zz /= math.sqrt(12)
    m = ((xx / 2 - zz, xy / 2, xz / 2), (xy / 2, -xx / 2 - zz, yz / 2), (xz / 2, yz / 2, 2 * zz))
    n_steps, direction = N_STEPS, start
    if direction is None:
        shown = _STARTS @ np.array([along_x, along_y, along_z])
        shown += np.einsum("ni,ij,nj->n", _STARTS, np.array(m), _STARTS)
        n_steps, direction = N_ASCENT, _STARTS[np.argmax(shown)]
    size = math.hypot(*m[0], *m[1], *m[2])
    x, y, z = direction.tolist()
    for _ in range(n_steps):
        to_x = along_x + 2 * (m[0][0] * x + m[0][1] * y + m[0][2] * z + size * x)
        to_y = along_y + 2 * (m[1][0] * x + m[1][1] * y + m[1][2] * z + size * y)
        to_z = along_z + 2 * (m[2][0] * x + m[2][1] * y + m[2][2] * z + size * z)
        length = math.hypot(to_x, to_y, to_z)
        if length == 0:
            break
        x, y, z = to_x / length, to_y / length, to_z / length
    return np.array([x, y, z])


_STARTS = AnchorLattice(128).directions
_Y0, _Y1, _Y2 = (math.sqrt(n / (4 * math.pi)) for n in (1, 3, 15))
_ZZ = math.sqrt(3) / 2


def _strengths(luminance: ArrayF64, candidates: list[_Candidate]) -> ArrayF64:
    """Irradiance of each candidate, least squares over bands 1 and 2, none negative: by coordinate descent.

    Where any was seen, each is drawn to what was seen of it, clipped ones to as many times that as fits all of them.
    """
    columns = np.array([_of_disc(one.direction, one.angular_radius)[1:] for one in candidates])
    gram, right = (columns @ columns.T).tolist(), (columns @ luminance[1:]).tolist()
    any_seen, expected = any(one.is_seen for one in candidates), _expected(luminance, candidates, columns)
    counts = [
        any_seen * (SEEN_COUNTS if one.is_seen else UNSEEN_COUNTS) * row[i]
        for i, (one, row) in enumerate(zip(candidates, gram, strict=True))
    ]
    most = [math.inf if one.may_be_brighter else MOST_OF_SEEN * one.irradiance for one in candidates]
    strengths = list(expected)
    for _ in range(SWEEPS):
        before = list(strengths)
        for i, row in enumerate(gram):
            left = right[i] - sum(one * strength for one, strength in zip(row, strengths, strict=True))
            drawn = counts[i] * (expected[i] - strengths[i])
            strengths[i] = min(most[i], max(0.0, strengths[i] + (left + drawn) / (row[i] + counts[i])))
        if all(abs(now - then) <= 1e-6 * then for now, then in zip(strengths, before, strict=True)):
            break
    return np.array(strengths)


def _expected(luminance: ArrayF64, candidates: list[_Candidate], columns: ArrayF64) -> list[float]:
    """Irradiance of each by what was seen: 0 of what was not."""
    expected = np.array([one.irradiance for one in candidates])
    is_clipped = np.array([one.is_seen and one.may_be_brighter for one in candidates])
    together = expected[is_clipped] @ columns[is_clipped]
    left = luminance[1:] - expected[~is_clipped] @ columns[~is_clipped]
    if together.any():
        expected[is_clipped] *= max(0.0, float(together @ left / (together @ together)))
    return [float(one) for one in expected]


def _explained(luminance: ArrayF64, candidates: list[_Candidate]) -> float:
    """Share of the energy of bands 1 and 2 that candidates explain together."""
    columns = np.array([_of_disc(one.direction, one.angular_radius)[1:] for one in candidates])
    left = luminance[1:] - _strengths(luminance, candidates) @ columns
    return 1 - float(left @ left / (luminance[1:] @ luminance[1:]))


def _chosen(candidates: list[_Candidate], strengths: ArrayF64, previous: KeyLight | None) -> int | None:
    """Which candidate is the key light; None where two are as strong."""
    weights = strengths * [1 if one.is_seen else UNSEEN_WEIGHS for one in candidates]
    strongest = int(np.argmax(weights))
    if previous is not None:
        stay = [
            i
            for i, one in enumerate(candidates)
            if _is_same(one.direction, previous.direction) and weights[i] >= STAYS_FROM * weights[strongest]
        ]
        if stay:
            return max(stay, key=lambda i: float(candidates[i].direction @ previous.direction))
    others = np.delete(weights, strongest)
    if len(others) and others.max() >= EQUAL * weights[strongest]:
        return None
    return strongest


def _fitted(coefficients: ArrayF64, one: _Candidate, strength: float) -> KeyLight:
    """The candidate with its colour: as its share in each channel, and no more light than there is in any."""
    column = _of_disc(one.direction, one.angular_radius)
    fitted = np.maximum(column[1:] @ coefficients[1:] / (column[1:] @ column[1:]), 0)
    alone = float(fitted @ LUMINANCE)
    irradiance = fitted * (strength / alone if alone > 0 else 0.0)
    most = np.maximum(coefficients[0], 0) / column[0]
    return KeyLight(one.direction, np.minimum(irradiance, most), one.angular_radius, one.is_seen)


def _is_same(a: ArrayF64, b: ArrayF64) -> bool:
    return bool(a @ b > SAME_LIGHT_COSINE)


def _unit(vector: ArrayF64) -> ArrayF64:
    length = math.sqrt(vector @ vector)
    return vector / length if length else np.array([0.0, 0.0, 1.0])
