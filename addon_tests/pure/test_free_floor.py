"""The floor of a room that is free to walk on: its largest part, and routes over it."""

import numpy as np
import pytest
from scipy import ndimage, sparse

from xihe_blender.lab.rooms.free_floor import CELL_M, FreeFloor, Route


def random_floor(seed, share):
    return FreeFloor((-1.0, 2.0), np.random.default_rng(seed).random((14, 19)) < share)


@pytest.mark.parametrize("seed", range(6))
def test_the_largest_part_of_a_floor_is_the_one_that_labelling_finds(seed):
    floor = random_floor(seed, (0.0, 0.3, 0.45, 0.6, 0.9, 1.0)[seed])
    labels, n_parts = ndimage.label(floor.is_free, structure=np.ones((3, 3)))
    sizes = ndimage.sum(floor.is_free, labels, range(1, n_parts + 1))
    kept = floor.without(np.array([[100.0, 100.0]]), 0.1)
    assert kept.area_m2 == pytest.approx(max(sizes, default=0) * CELL_M**2)
    assert not (kept.is_free & ~floor.is_free).any()
    assert len(set(labels[kept.is_free])) == (n_parts > 0)


@pytest.mark.parametrize("seed", range(6))
def test_a_route_stays_on_free_floor_and_is_never_longer_than_the_shortest_way_over_cells(seed):
    floor = random_floor(seed, 0.6).without(np.array([[100.0, 100.0]]), 0.1)
    ends = np.random.default_rng(seed).permutation(floor.places_m)[:2]
    route = floor.route(ends)
    np.testing.assert_allclose(route.places_m[[0, -1]], ends, atol=1e-9)
    assert floor.holds(route.places_m).all()
    gaps = np.linalg.norm(floor.places_m[:, None] - floor.places_m[None], axis=-1)
    steps = sparse.csr_matrix(np.where(gaps < 1.5 * CELL_M, gaps, 0))
    start, end = (int(np.linalg.norm(floor.places_m - place, axis=1).argmin()) for place in ends)
    shortest = sparse.csgraph.dijkstra(steps, indices=start)[end]
    assert np.linalg.norm(ends[1] - ends[0]) - 1e-9 <= route.length_m <= shortest + 1e-9


def test_a_route_is_walked_at_its_own_length():
    route = Route.through(np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 4.0]]))
    assert route.length_m == 7.0
    np.testing.assert_allclose(
        [route.at(-1), route.at(1.5), route.at(5), route.at(9)], [[0, 0], [1.5, 0], [3, 2], [3, 4]]
    )
