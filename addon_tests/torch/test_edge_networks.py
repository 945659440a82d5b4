"""A service whose network runs in torch gives the light of NumPy's."""

import numpy as np
import pytest

from addon_tests.pure.commands import assert_refused, xihe_here
from addon_tests.pure.made import random_cloud, with_facing
from xihenet import estimators
from xihenet.edge.batching import Inference, Job
from xihenet.edge.torch_networks import put_on
from xihenet.records import UnitSphereCloud


def clouds(rng, n=512):
    for share in (0.02, 0.5, 1.0):
        cloud = random_cloud(rng, n, share)
        yield from (cloud, with_facing(cloud, rng))


@pytest.mark.parametrize(("name", "target"), [("lattice", "ldr"), ("lattice", "hdr"), ("xihenet", "ldr")])
def test_torch_gives_what_numpy_gives(name, target):
    plain, torched = (estimators.load(name, 512, target) for _ in range(2))
    put_on(torched, "cpu")
    for cloud in clouds(np.random.default_rng(0)):
        (light, error), (other, other_error) = plain.estimate_with_error(cloud), torched.estimate_with_error(cloud)
        np.testing.assert_allclose(other, light, atol=1e-4)
        assert (error is None) == (other_error is None) and np.isclose(error or 0, other_error or 0, rtol=1e-3)
    empty = UnitSphereCloud.empty(512)
    np.testing.assert_allclose(torched.estimate(empty), plain.estimate(empty), atol=1e-4)


def test_batches_run_there_too():
    rng = np.random.default_rng(1)
    jobs = [Job(random_cloud(rng, 512), "ldr") for _ in range(3)]
    # Any device but "cpu" goes through torch; its own name for the processor, with a number, is one.
    lights = zip(Inference("lattice", "cpu:0")(jobs), Inference("lattice")(jobs), strict=True)
    assert all(np.allclose(one.sh_radiance, other.sh_radiance, atol=1e-4) for one, other in lights)


def test_an_estimator_without_a_network_is_refused():
    with pytest.raises(ValueError, match="leave --device out"):
        put_on(estimators.load("ambient", 512), "cpu:0")
    asked = xihe_here("serve", "--estimator", "ambient", "--device", "cuda")
    assert_refused(asked, "--estimator ambient: ", "leave --device out")
