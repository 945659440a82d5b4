"""What every estimator promises, and what each of them gives."""

import hashlib
import re
import sys
import tomllib
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from addon_tests.pure.made import constant, frame_of, random_cloud
from xihenet import estimators
from xihenet.backend import LocalBackend, NoAnswer, estimate_light
from xihenet.colour import linear_to_srgb, srgb_to_linear
from xihenet.edge.batching import Inference, unserved_because
from xihenet.estimators import EstimateContext, Estimator
from xihenet.estimators.base import NotFinite
from xihenet.estimators.lattice import Lattice
from xihenet.estimators.weights_format import weights_sha256
from xihenet.records import PointCloud, UnitSphereCloud
from xihenet.sphere import AnchorLattice

N = 320
LATTICE = AnchorLattice(N)
RADIANCE = np.array([0.2, 0.5, 0.8])


def constant_cloud(is_set, radiance=RADIANCE):
    is_set = np.broadcast_to(is_set, N)
    return UnitSphereCloud(linear_to_srgb(radiance) * is_set[:, None], 2.0 * is_set, is_set)


def frame(ambient, exposure=1.0):
    return frame_of(np.ones((1, 1)), ambient=ambient, exposure=exposure)


@pytest.mark.parametrize("name", estimators.names())
def test_every_estimator_says_what_it_is_and_asks_for_what_there_is(name):
    assert estimators.label(name) and " " in estimators.summary(name) and not estimators.summary(name).endswith(".")
    estimator = estimators.load(name, N)
    assert estimator.name == name and estimator.n_anchors == N and estimator.target == "ldr"
    assert estimator.needs <= {part.name for part in fields(EstimateContext)}


@pytest.mark.parametrize("name", estimators.names())
@pytest.mark.parametrize("target", ["ldr", "hdr"])
def test_every_estimator_gives_finite_light_of_whatever_was_seen_and_the_same_in_a_batch(name, target):
    estimator, half = estimators.load(name, N, target), LATTICE.directions[:, 2] > 0
    clouds = [constant_cloud(True), constant_cloud(half), UnitSphereCloud.empty(N)]
    points = PointCloud(np.float32(2.0 * LATTICE.directions), clouds[0].srgb)
    context = EstimateContext(frame([0.1, 0.2, 0.3]), points, np.zeros(3), constant(RADIANCE), 1.0)
    for cloud in clouds:
        light = estimator.estimate(cloud, context)
        assert light.shape == (9, 3) and np.isfinite(light).all()
    if estimator.needs <= {"frame"}:
        arrays = (np.array([getattr(cloud, part) for cloud in clouds]) for part in ("srgb", "distance_m", "is_set"))
        singles = [estimator.estimate(cloud) for cloud in clouds]
        np.testing.assert_allclose(estimator.estimate_batch(*arrays), singles, atol=1e-5)


@pytest.mark.parametrize("name", ["lattice", "xihenet"])
def test_what_is_beyond_the_farthest_distance_is_taken_for_that(name):
    estimator, cloud = estimators.load(name, N), random_cloud(np.random.default_rng(0), N)
    lights = []
    for far_m in (estimator.farthest_m, 3e38):
        distance_m = np.where(cloud.is_set & (np.arange(N) % 16 == 0), far_m, cloud.distance_m)
        lights.append(estimator.estimate(UnitSphereCloud(cloud.srgb, distance_m, cloud.is_set)))
    np.testing.assert_array_equal(*lights)


@pytest.mark.parametrize("name", estimators.names())
def test_a_cloud_of_another_lattice_is_refused(name):
    with pytest.raises(ValueError, match="made for 320 anchors, got a cloud of 7"):
        estimators.load(name, N).estimate(UnitSphereCloud.empty(7))


def test_an_unknown_name_is_refused_with_the_known_ones():
    with pytest.raises(ValueError, match=f"choose one of {', '.join(estimators.names())}$"):
        estimators.load("magic")


@pytest.mark.parametrize("wrong", [{"n_anchors": 0}, {"target": "sdr"}])
def test_options_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ValueError, match="expected"):
        estimators.load("projection", **wrong)


def test_light_of_another_order_is_a_mistake_and_not_light_that_could_not_be_known():
    class OfOrder3(Estimator):
        name = "of-order-3"

        def _estimate(self, cloud, context):
            return np.zeros((16, 3))

    with pytest.raises(ValueError, match=r"of-order-3: expected coefficients of order 2, \(9, 3\), got \(16, 3\)"):
        estimate_light(LocalBackend(OfOrder3(N)), constant_cloud(True), EstimateContext(), 1.0)


def test_an_error_within_an_estimator_names_it():
    class Painter(Estimator):
        name = "painter"

        def _estimate(self, cloud, context):
            cloud.srgb[:] = 0
            return np.zeros((9, 3))

    with pytest.raises(ValueError, match=r"^painter: assignment destination is read-only$"):
        Painter(N).estimate(constant_cloud(True))


@pytest.mark.parametrize("error", [NoAnswer("too late"), NotFinite("all black")])
def test_an_estimator_may_say_itself_that_the_light_is_not_known(error):
    class Remote(Estimator):
        name = "remote"

        def _estimate(self, cloud, context):
            raise error

    light = estimate_light(LocalBackend(Remote(N)), constant_cloud(True), EstimateContext(), 1.0)
    assert light.unknown_because == error.reason and not light.is_valid


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Installs the estimator that docs/python.md shows, with other code or another entry point if given."""
    page = (Path(__file__).parents[2] / "docs" / "python.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(import numpy[^`]*class Evenly.*?)```", page, re.DOTALL)
    project = tomllib.loads(re.search(r"```toml\n(.*?)```", page, re.DOTALL)[1])["project"]
    ((name, place),) = project["entry-points"]["xihe.estimators"].items()
    shown = f"{name} = {place}"

    def install(code=code, entry=shown):
        (tmp_path / "evenly.py").write_text(code)
        facts = tmp_path / "evenly-1.0.dist-info"
        facts.mkdir()
        said = f"Metadata-Version: 2.1\nName: evenly\nVersion: 1.0\nSummary: {project['description']}\n"
        (facts / "METADATA").write_text(said)
        (facts / "entry_points.txt").write_text(f"[xihe.estimators]\n{entry}\n")
        monkeypatch.syspath_prepend(tmp_path)
        monkeypatch.delitem(sys.modules, "evenly", raising=False)
        estimators._outside.cache_clear()
        return code

    yield install
    estimators._outside.cache_clear()


def test_an_estimator_of_another_package_is_known_as_ours_are(package):
    code = package()
    assert (
        estimators.names()[-1] == "evenly" and estimators.summary("evenly") == "Mean of what was seen, from everywhere"
    )
    assert estimators.packages() == {"evenly": "1.0"}
    light = estimators.load("evenly", N, "hdr").estimate(constant_cloud(LATTICE.directions[:, 2] > 0))
    np.testing.assert_allclose(light, constant(RADIANCE), rtol=1e-5)
    digest = hashlib.sha256(code.encode()).hexdigest()
    assert weights_sha256(["evenly", "projection"], "hdr") == {"evenly": digest}
    assert Inference("evenly").name == "evenly" and not unserved_because("evenly")


def test_no_package_takes_the_name_of_ours(package):
    package(entry="lattice = evenly:Evenly")
    assert isinstance(estimators.load("lattice", N), Lattice) and len(set(estimators.names())) == len(
        estimators.names()
    )


BARE = "from xihenet.estimators import Estimator\nclass Evenly(Estimator):\n    name = 'evenly'\n"


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"code": "import nowhere"}, "evenly does not offer Evenly (No module named 'nowhere'): mend or uninstall it"),
        (
            {"code": ""},
            "evenly does not offer Evenly (module 'evenly' has no attribute 'Evenly'): mend or uninstall it",
        ),
        ({"code": "class Evenly: name = 'evenly'"}, "evenly: Evenly is no subclass of xihenet.estimators.Estimator"),
        (
            {"code": f"{BARE}    def __init__(self): super().__init__(1280, 'ldr')"},
            "evenly: Evenly is made of n_anchors and target (too many positional arguments)",
        ),
        ({"entry": "even = evenly:Evenly"}, "evenly: the name of Evenly is 'evenly', and 'even' is expected"),
    ],
)
def test_a_package_that_does_not_hold_what_it_offers_is_refused(package, wrong, said):
    package(**wrong)
    with pytest.raises(ImportError, match=re.escape(said)):
        estimators.load(estimators.names()[-1], N)
    assert unserved_because(estimators.names()[-1]) == said


def test_ambient_takes_the_sensor_and_the_sessions_exposure():
    context = EstimateContext(frame=frame([0.1, 0.2, 0.3], exposure=2.0))
    estimate = estimators.load("ambient", N).estimate(constant_cloud(True), context)
    np.testing.assert_allclose(estimate, constant([0.2, 0.4, 0.6]))
    context = EstimateContext(frame=frame([0.1, 0.2, 0.3], exposure=2.0), reference_exposure=1.0)
    np.testing.assert_allclose(
        estimators.load("ambient", N).estimate(constant_cloud(True), context), constant([0.1, 0.2, 0.3])
    )


def test_ambient_without_a_frame_takes_the_mean_of_the_set_anchors_in_linear_light():
    half = LATTICE.directions[:, 0] > 0
    colours = np.where(half[:, None], linear_to_srgb(0.9), linear_to_srgb(0.1)) * np.ones(3)
    cloud = UnitSphereCloud(colours, np.ones(N), np.ones(N, bool))
    expected = constant(np.full(3, 0.1 + 0.8 * half.mean()))
    np.testing.assert_allclose(estimators.load("ambient", N).estimate(cloud), expected, rtol=1e-6)


@pytest.mark.parametrize("n", [1280, 65536])
def test_ambient_gives_the_mean_of_constant_light_whatever_the_number_of_anchors(n):
    cloud = UnitSphereCloud(np.full((n, 3), [0.3, 0.7, 1.0]), np.ones(n), np.ones(n, bool))
    expected = constant(srgb_to_linear(cloud.srgb[0].astype(np.float64)))
    np.testing.assert_allclose(estimators.load("ambient", n).estimate(cloud), expected, rtol=1e-9)


def test_ambient_is_clipped_at_white_for_ldr_alone():
    context = EstimateContext(frame=frame([0.5, 2.0, 7.0]))
    for target, expected in (("ldr", [0.5, 1.0, 1.0]), ("hdr", [0.5, 2.0, 7.0])):
        estimate = estimators.load("ambient", N, target).estimate(UnitSphereCloud.empty(N), context)
        np.testing.assert_allclose(estimate, constant(expected))


@pytest.mark.parametrize("kind", [np.float32, ">f8", list])
def test_an_estimator_of_somebody_elses_may_answer_with_any_numbers(kind):
    class Listed(Estimator):
        name = "listed"

        def _estimate(self, cloud, context):
            light = constant(RADIANCE)
            return light.tolist() if kind is list else light.astype(kind)

    light = Listed(N).estimate(constant_cloud(True))
    assert light.dtype == np.float64 and light.dtype.isnative
    np.testing.assert_allclose(light, constant(RADIANCE), rtol=1e-6)


def test_truth_without_its_probe_is_refused():
    with pytest.raises(ValueError, match="needs the rendered light probe"):
        estimators.load("truth", N).estimate(constant_cloud(True))


def test_truth_hands_on_the_probe_and_a_result_that_is_not_finite_never_leaves_an_estimator():
    probe = EstimateContext(truth_sh=constant(RADIANCE))
    handed_on = estimators.load("truth", N).estimate(constant_cloud(True), probe)
    np.testing.assert_array_equal(handed_on, probe.truth_sh)
    assert not np.shares_memory(handed_on, probe.truth_sh), "whoever changes a light changes no truth"
    context = EstimateContext(truth_sh=np.full((9, 3), np.nan))
    with pytest.raises(ValueError, match="not nine finite triples"):
        estimators.load("truth", N).estimate(constant_cloud(True), context)
