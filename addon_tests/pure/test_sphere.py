"""Anchors and which of them is nearest: exactly, by the paper's table, and by brute force."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from xihenet import anchor_table
from xihenet.anchor_table import build_anchor_table
from xihenet.sphere import AnchorLattice

SIZES_IN_USE = (512, 768, 1024, 1280, 1536, 2048)
FEW_OR_ODD = (1, 2, 3, 4, 5, 6, 7, 16, 100, 333)


def cosine_lost(directions, anchors, given_directions, n_times=1):
    """How far the cosine of the chosen anchor lies below the best, in float64.

    Given directions that come `n_times`, one after the other and in other lengths, have one best cosine.
    """
    unit = given_directions.astype(np.float64)
    unit /= np.abs(unit).max(axis=1, keepdims=True)
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    of_one = unit[: len(unit) // n_times]
    blocks = np.array_split(of_one, 1 + len(of_one) * len(directions) // 2**17)  # Which fit the cache
    best = np.concatenate([(block @ directions.T).max(axis=1) for block in blocks])
    return np.tile(best, n_times) - (unit * directions[anchors]).sum(axis=1)


def n_wrong(lattice, directions, method="exact", n_times=1):
    anchors = lattice.nearest(directions, method)
    assert anchors.shape == (len(directions),)
    assert ((anchors >= 0) & (anchors < lattice.n)).all()
    return int((cosine_lost(lattice.directions, anchors, np.asarray(directions), n_times) > 1e-7).sum())


def in_cube(rng, n, dtype=np.float32):
    return rng.uniform(-5, 5, (n, 3)).astype(dtype)


def axes_and_borders():
    """Poles, seam, axes, diagonals and the equator, with both zeros and the smallest steps beside them."""
    steps = np.float32([0.0, -0.0, 1e-7, -1e-7, 1e-30, -1e-30, 0.5, -0.5, 1.0, -1.0])
    grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    return grid[np.abs(grid).max(axis=1) > 0]


def on_cell_borders(rng, n_cells):
    """Corners and edges of cells of the octahedral map, and the nearest floats around them."""
    half = n_cells // 2
    x, y = rng.integers(-half, half + 1, (2, 4000)) / half
    y[:2000] = rng.uniform(-1, 1, 2000)
    inside = np.abs(x) + np.abs(y) <= 1
    x, y = x[inside], y[inside]
    z = (1 - np.abs(x) - np.abs(y)) * rng.choice([-1, 1], len(x))
    corners = np.stack([x, y, z], axis=1).astype(np.float32)
    return np.concatenate([corners, np.nextafter(corners, np.float32(2)), np.nextafter(corners, np.float32(-2))])


def on_voronoi_borders(lattice):
    """Points equally far from two or three anchors, and points a hair away from those."""
    neighbours = lattice.neighbours(min(7, lattice.n))
    a = lattice.directions
    edges = (a[neighbours[:, :1]] + a[neighbours[:, 1:]]).reshape(-1, 3)
    b, c = a[neighbours[:, 1:-1]] - a[:, None], a[neighbours[:, 2:]] - a[:, None]
    vertices = np.cross(b, c).reshape(-1, 3)
    ties = np.concatenate([edges, vertices, -vertices])
    ties = ties[np.linalg.norm(ties, axis=1) > 1e-6]
    return np.concatenate([ties, ties + 1e-6 * ties[:, [1, 2, 0]], ties - 1e-7 * ties[:, [2, 0, 1]]])


def nasty_directions(lattice, rng):
    borders = [on_cell_borders(rng, n_cells) for n_cells in (256, 1024, 2048)]
    parts = [axes_and_borders(), *borders, on_voronoi_borders(lattice), lattice.directions]
    directions = np.concatenate([part.astype(np.float64) for part in parts])
    lengths = 10.0 ** rng.uniform(-25, 25, (len(directions), 1))
    return np.concatenate([directions, directions * lengths])


def test_anchors_are_unit_vectors_in_falling_height():
    for n in FEW_OR_ODD + SIZES_IN_USE:
        directions = AnchorLattice(n).directions
        assert directions.shape == (n, 3)
        np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-15)
        assert (np.diff(directions[:, 2]) < 0).all()
        np.testing.assert_array_equal(directions[0], [0, 0, 1])


def test_lattice_follows_the_reference_formula():
    n, i = 1280, 777
    z = 1 - 2 * i / (n - 1)
    azimuth = i * np.pi * (3 - 5**0.5)
    expected = [np.sqrt(1 - z * z) * np.cos(azimuth), np.sqrt(1 - z * z) * np.sin(azimuth), z]
    np.testing.assert_allclose(AnchorLattice(n).directions[i], expected, atol=1e-12)


def test_lattices_of_one_size_are_equal_and_share_what_is_built():
    first, second = AnchorLattice(1280), AnchorLattice(np.int64(1280))
    assert first == second and hash(first) == hash(second)
    assert first.directions is second.directions
    assert first.neighbours(4) is second.neighbours(4)
    with pytest.raises(ValueError, match="read-only"):
        first.directions[0] = 0


@pytest.mark.parametrize("is_weighted", [True, False])
def test_a_mean_is_that_of_what_is_around_each_anchor(is_weighted):
    rng, lattice = np.random.default_rng(0), AnchorLattice(100)
    directions, values, weights = in_cube(rng, 150), rng.normal(size=(150, 3)), rng.uniform(0.1, 3, 150)
    means, is_set = lattice.means(directions, values, weights if is_weighted else None)
    around = [lattice.nearest(directions) == anchor for anchor in range(100)]
    expected = [
        np.average(values[near], axis=0, weights=weights[near] if is_weighted else None) if near.any() else np.zeros(3)
        for near in around
    ]
    np.testing.assert_allclose(means, expected, atol=1e-12)
    assert is_set.tolist() == [near.any() for near in around] and 0 < is_set.sum() < 100


@pytest.mark.parametrize("n", FEW_OR_ODD + (512, 1280, 2048))
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_exact_is_never_wrong_on_nasty_directions(n, dtype):
    lattice = AnchorLattice(n)
    directions = nasty_directions(lattice, np.random.default_rng(n)).astype(dtype)
    directions = directions[directions.any(axis=1)]  # float32 takes some of the shortest to zero
    assert n_wrong(lattice, directions, n_times=2 if dtype == np.float64 else 1) == 0


@settings(max_examples=30, deadline=None)
@given(n=st.integers(1, 60), log_cells=st.integers(1, 7), clustered=st.booleans(), seed=st.integers(0, 2**32 - 1))
def test_table_of_cells_is_exact_for_any_anchors_and_any_number_of_cells(n, log_cells, clustered, seed):
    rng = np.random.default_rng(seed)
    anchors = rng.normal(size=(n, 3)) * (0.05 if clustered else 1) + (clustered, 0, 0)
    anchors /= np.linalg.norm(anchors, axis=1, keepdims=True)
    points = np.concatenate([rng.normal(size=(2000, 3)), axes_and_borders()]).astype(np.float32)
    points = points[np.abs(points).max(axis=1) > 1e-20]
    columns = np.ascontiguousarray(points.T)
    found = build_anchor_table(anchors, 2**log_cells).find(columns, np.abs(columns).sum(axis=0))
    assert (cosine_lost(anchors, found, points) <= 1e-7).all()


@pytest.mark.parametrize("n_cells", [16, 64])
def test_cells_with_two_candidates_are_halved_as_any_others(n_cells):
    rng, n = np.random.default_rng(n_cells), 500
    row, column = np.divmod(rng.choice(2 * n_cells**2, n, replace=False), n_cells)
    anchors = np.sort(rng.choice(100, (n, 2)), axis=1).T + np.array([[0], [1]])
    scores = rng.normal(size=(2, 2, 2, n)).astype(np.float32)
    near = rng.choice([0, 1e-6, 4e-6, 5e-6], scores[:, :, 1].shape) * rng.choice([-1, 1], n)
    scores[:, :, 1, ::2] = (scores[:, :, 0] + near)[:, :, ::2].astype(np.float32)
    every = scores.swapaxes(2, 3).reshape(2, 2, -1)
    cells = anchor_table._Cells(row, column, np.full(n, 2), anchors.T.ravel(), every)
    codes, codes_of_pairs = np.zeros((2, 4 * n_cells, 2 * n_cells), np.uint16)
    expected = anchor_table._split(anchor_table._halved(cells, codes))[1]
    found = anchor_table._joined(
        anchor_table._halved_pairs(anchor_table._Pairs(row, column, anchors, scores), codes_of_pairs)
    )
    np.testing.assert_array_equal(codes_of_pairs, codes)
    assert 100 < len(found.row) < 4 * n
    for field in dataclasses.fields(found):
        np.testing.assert_array_equal(getattr(found, field.name), getattr(expected, field.name))


def test_table_of_cells_counts_on_where_16_bits_end():
    table = build_anchor_table(AnchorLattice(18000).directions, 256)
    assert table.codes.max() == 18000 + len(table.lists) - 1 >= 2**16


@pytest.mark.parametrize("n_cells", [0, 1, 3, 100])
def test_table_of_cells_halves_down_to_a_power_of_two_only(n_cells):
    with pytest.raises(ValueError, match=f"power of two of at least 2, got {n_cells}"):
        build_anchor_table(AnchorLattice(4).directions, n_cells)


@pytest.mark.parametrize("method", ["exact", "table", "brute"])
@pytest.mark.parametrize("factor", [2.0**-149, 2.0**-98, 2.0**-40, 2.0**40, 2.0**98, 2.0**120])
def test_length_of_a_direction_does_not_matter(method, factor):
    lattice = AnchorLattice(1280)
    directions = np.random.default_rng(0).integers(-127, 128, (3000, 3)) + np.float64([0, 0, 0.5])
    directions = directions.astype(np.float32) * 2
    np.testing.assert_array_equal(
        lattice.nearest(directions * np.float32(factor), method), lattice.nearest(directions, method)
    )


@pytest.mark.parametrize("method", ["exact", "table", "brute"])
def test_direction_that_is_none_gets_anchor_zero_and_disturbs_no_other(method):
    lattice, rng = AnchorLattice(1280), np.random.default_rng(3)
    directions = in_cube(rng, 1000)
    expected = lattice.nearest(directions, method)
    none = np.float32(
        [[0, 0, 0], [-0.0, 0, -0.0], [np.nan, 1, 1], [1, 1, np.nan], [np.inf, 0, 0], [1, -np.inf, np.nan]]
    )
    directions[100:106] = none
    expected[100:106] = 0
    np.testing.assert_array_equal(lattice.nearest(directions, method), expected)
    np.testing.assert_array_equal(lattice.nearest(directions.astype(np.float64), method), expected)
    assert lattice.nearest(directions[:0], method).shape == (0,)


def test_memory_layout_and_type_of_directions_do_not_matter():
    lattice = AnchorLattice(1280)
    directions = np.random.default_rng(5).integers(-50, 50, (999, 3)) * 2 + 1
    expected = lattice.nearest(directions.astype(np.float32))
    for same in (directions, directions.tolist(), np.asfortranarray(directions, np.float32), directions.astype(float)):
        np.testing.assert_array_equal(lattice.nearest(same), expected)
    np.testing.assert_array_equal(lattice.nearest(directions.astype(np.float32)[::2]), expected[::2])


def test_nearest_leaves_its_input_alone():
    directions = in_cube(np.random.default_rng(6), 100)
    before = directions.copy()
    columns = np.ascontiguousarray(directions.T)
    for method in ("exact", "table", "brute"):
        AnchorLattice(64).nearest(np.asfortranarray(directions), method)
        AnchorLattice(64).nearest_to_columns(columns, method)
    np.testing.assert_array_equal(columns.T, before)


# The share of right answers that the paper's artefact reports, in per cent.
@pytest.mark.parametrize(
    ("n", "size", "right"),
    [(512, (1024, 512), 98.35), (1280, (512, 256), 94.77), (1280, (1024, 512), 97.42), (2048, (2048, 1024), 98.38)],
)
def test_table_is_right_as_often_as_the_papers(n, size, right):
    lattice = AnchorLattice(n)
    directions = in_cube(np.random.default_rng(7), 100_000)
    lost = cosine_lost(lattice.directions, lattice.nearest(directions, "table", size), directions)
    assert 100 * (lost <= 1e-7).mean() == pytest.approx(right, abs=0.25)


@pytest.mark.parametrize("size", [(1, 1), (2, 1), (7, 3), (360, 180)])
def test_table_gives_the_nearest_anchor_of_the_cells_centre(size):
    width, height = size
    lattice = AnchorLattice(100)
    azimuth = (np.arange(width) + 0.5) * 2 * np.pi / width - np.pi
    polar = (np.arange(height)[:, None] + 0.5) * np.pi / height
    centres = np.stack(
        np.broadcast_arrays(np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)), -1
    )
    expected = lattice.nearest(centres.reshape(-1, 3), "brute")
    for shift in (-0.4, 0.0, 0.4):
        a, p = azimuth + shift * 2 * np.pi / width, polar + shift * np.pi / height
        inside = np.stack(np.broadcast_arrays(np.sin(p) * np.cos(a), np.sin(p) * np.sin(a), np.cos(p)), -1)
        np.testing.assert_array_equal(lattice.nearest(inside.reshape(-1, 3), "table", size), expected)


def test_table_takes_seam_and_poles_to_anchors_close_by():
    lattice = AnchorLattice(1280)
    directions = axes_and_borders()
    lost = cosine_lost(lattice.directions, lattice.nearest(directions, "table"), directions)
    assert lost.max() < 1e-3


@pytest.mark.parametrize("size", [(0, 512), (1024, 0), (-4, 4), (2**20, 2**20)])
def test_table_without_cells_or_with_too_many_is_refused(size):
    with pytest.raises(ValueError, match=f"expected 1 to 2.28 cells, got {size[0]} x {size[1]}"):
        AnchorLattice(16).nearest(np.ones((1, 3)), "table", size)


def test_nearest_names_what_it_expected():
    with pytest.raises(ValueError, match=r"shape \(any, 3\), got \(3,\)"):
        AnchorLattice(16).nearest([0, 0, 1])
    with pytest.raises(ValueError, match="exact, table or brute, got 'fast'"):
        AnchorLattice(16).nearest(np.ones((1, 3)), "fast")


@pytest.mark.parametrize(("n", "k"), [(1, 1), (2, 2), (9, 9), (100, 4), (333, 16), (1280, 4)])
def test_neighbours_are_the_nearest_anchors_in_order(n, k):
    lattice = AnchorLattice(n)
    neighbours = lattice.neighbours(k)
    assert neighbours.shape == (n, k)
    np.testing.assert_array_equal(neighbours[:, 0], np.arange(n))
    assert all(len(set(row)) == k for row in neighbours.tolist())
    cosines = lattice.directions @ lattice.directions.T
    found = np.take_along_axis(cosines, neighbours, axis=1)
    np.testing.assert_allclose(found, -np.sort(-cosines, axis=1)[:, :k], atol=1e-12)


@pytest.mark.parametrize("k", [0, 17])
def test_neighbours_refuses_more_than_there_are(k):
    with pytest.raises(ValueError, match=f"1 to 16 neighbours of 16 anchors, got {k}"):
        AnchorLattice(16).neighbours(k)
