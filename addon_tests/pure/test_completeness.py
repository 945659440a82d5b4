"""Coverage and joint entropy: known answers, and what must not change them."""

import numpy as np
import pytest

from xihenet.completeness import ENTROPY_SIZES, coverage, joint_entropy
from xihenet.records import PointCloud, UnitSphereCloud
from xihenet.sampling import sample_unit_sphere
from xihenet.sphere import AnchorLattice

ORIGIN = np.zeros(3)


def on_cap(rng, n, half_angle):
    """Directions spread evenly within an angle of +X."""
    cosine = rng.uniform(np.cos(half_angle), 1, n)
    azimuth = rng.uniform(0, 2 * np.pi, n)
    sine = np.sqrt(1 - cosine**2)
    return np.stack([cosine, sine * np.cos(azimuth), sine * np.sin(azimuth)], axis=1)


def test_coverage_is_the_share_of_set_anchors():
    is_set = np.arange(1280) % 4 == 0
    cloud = UnitSphereCloud(np.zeros((1280, 3)), np.zeros(1280), is_set)
    assert coverage(cloud) == 0.25
    assert coverage(UnitSphereCloud.empty(1280)) == 0
    assert coverage(UnitSphereCloud.empty(0)) == 0


def test_half_space_of_points_covers_half_of_the_anchors_and_those_on_its_border():
    points = np.random.default_rng(0).normal(size=(200_000, 3))
    points[:, 0] = np.abs(points[:, 0])
    sampled = sample_unit_sphere(PointCloud(points, np.zeros_like(points)), ORIGIN, AnchorLattice(1280))
    # The border is a great circle, along which some 2 pi / 0.1 anchors reach over to one side or the other.
    assert 0.5 <= coverage(sampled) <= 0.5 + 63 / 1280


def test_entropy_uses_the_papers_sizes():
    assert ENTROPY_SIZES == (2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048, 4096)


def test_evenly_spread_points_have_nearly_the_largest_entropy():
    points = np.random.default_rng(1).normal(size=(300_000, 3))
    assert joint_entropy(points, ORIGIN) == pytest.approx(sum(np.log2(ENTROPY_SIZES)), abs=0.5)


def test_two_opposite_directions_have_one_bit_per_size():
    points = np.float64([[0, 0, 2], [0, 0, -3]] * 50)
    assert joint_entropy(points, ORIGIN) == pytest.approx(12)


def test_entropy_is_the_sum_of_equation_1():
    rng = np.random.default_rng(2)
    points, position = rng.uniform(-3, 3, (700, 3)), np.array([0.5, -0.2, 0.1])
    expected = 0.0
    for n in ENTROPY_SIZES:
        nearest = AnchorLattice(n).nearest(points - position, "brute").tolist()
        for anchor in set(nearest):
            share = nearest.count(anchor) / 700
            expected -= share * np.log2(share)
    assert joint_entropy(points, position) == pytest.approx(expected, rel=1e-12)


def test_wider_view_has_more_entropy():
    rng = np.random.default_rng(3)
    entropies = [joint_entropy(on_cap(rng, 20_000, angle), ORIGIN) for angle in (0.01, 0.1, 0.5, 1.0, 2.0, np.pi)]
    assert (np.diff(entropies) > 1).all()


def test_clumped_points_have_less_entropy_than_spread_ones_of_the_same_number():
    rng = np.random.default_rng(4)
    spread = rng.normal(size=(1280, 3))
    clumped = np.concatenate([spread[:128], on_cap(rng, 1152, 0.2)])
    assert joint_entropy(clumped, ORIGIN) < joint_entropy(spread, ORIGIN) - 10


def test_turning_the_points_by_a_lattice_step_hardly_changes_the_entropy():
    points = on_cap(np.random.default_rng(5), 20_000, 0.8)
    step = np.pi * (3 - np.sqrt(5))
    turn = np.array([[np.cos(step), -np.sin(step), 0], [np.sin(step), np.cos(step), 0], [0, 0, 1]])
    assert joint_entropy(points @ turn.T, ORIGIN) == pytest.approx(joint_entropy(points, ORIGIN), rel=0.03)


def test_distance_place_and_order_do_not_matter():
    rng = np.random.default_rng(6)
    points, position = rng.normal(size=(5000, 3)), np.array([4.0, -2.0, 1.0])
    moved = rng.permutation(points * 2.0 ** rng.integers(-9, 9, (5000, 1))) + position
    assert joint_entropy(moved, position) == pytest.approx(joint_entropy(points, ORIGIN), abs=0.01)


def test_unusable_points_do_not_count():
    points = np.random.default_rng(7).normal(size=(300, 3))
    bad = [[np.nan, 0, 0], [0, np.inf, 0], [0, 0, 0], [-np.inf, np.nan, 1]]
    assert joint_entropy(np.concatenate([bad, points]), ORIGIN) == joint_entropy(points, ORIGIN)


def test_entropy_names_what_it_expected():
    with pytest.raises(ValueError, match=r"shape \(any, 3\), got \(3,\)"):
        joint_entropy([1, 2, 3], ORIGIN)
    with pytest.raises(ValueError, match="three finite numbers"):
        joint_entropy([[1, 2, 3]], [0, np.nan, 0])
