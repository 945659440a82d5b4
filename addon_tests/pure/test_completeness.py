"""Coverage and joint entropy: known answers, and what must not change them."""

import numpy as np
import pytest

from xihenet.completeness import ENTROPY_SIZES, coverage, joint_entropy
from xihenet.records import UnitSphereCloud
from xihenet.sphere import AnchorLattice

ORIGIN = np.zeros(3)
SIZES = ENTROPY_SIZES[:9]
"""Those whose tables are made in no time."""


def test_coverage_is_the_share_of_set_anchors():
    is_set = np.arange(1280) % 4 == 0
    cloud = UnitSphereCloud(np.zeros((1280, 3)), np.zeros(1280), is_set)
    assert coverage(cloud) == 0.25
    assert coverage(UnitSphereCloud.empty(1280)) == 0
    assert coverage(UnitSphereCloud.empty(0)) == 0


def test_entropy_uses_the_papers_sizes():
    assert ENTROPY_SIZES == (2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048, 4096)
    assert joint_entropy.__kwdefaults__["sizes"] is ENTROPY_SIZES


def test_entropy_is_the_sum_of_equation_1():
    rng = np.random.default_rng(2)
    points, position = rng.uniform(-3, 3, (700, 3)), np.array([0.5, -0.2, 0.1])
    expected = 0.0
    for n in SIZES:
        nearest = AnchorLattice(n).nearest(points - position, "brute").tolist()
        for anchor in set(nearest):
            share = nearest.count(anchor) / 700
            expected -= share * np.log2(share)
    assert joint_entropy(points, position, sizes=SIZES) == pytest.approx(expected, rel=1e-12)


def test_unusable_points_do_not_count():
    points = np.random.default_rng(7).normal(size=(300, 3))
    bad = [[np.nan, 0, 0], [0, np.inf, 0], [0, 0, 0], [-np.inf, np.nan, 1]]
    expected = joint_entropy(points, ORIGIN, sizes=SIZES)
    assert joint_entropy(np.concatenate([bad, points]), ORIGIN, sizes=SIZES) == expected


def test_entropy_names_what_it_expected():
    with pytest.raises(ValueError, match=r"shape \(any, 3\), got \(3,\)"):
        joint_entropy([1, 2, 3], ORIGIN)
    with pytest.raises(ValueError, match="three finite numbers"):
        joint_entropy([[1, 2, 3]], [0, np.nan, 0])
