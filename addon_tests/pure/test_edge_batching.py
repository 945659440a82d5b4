"""Requests of all clients in one inference: equal to each alone, bounded, and none keeps another waiting for ever."""

import asyncio
import threading

import numpy as np
import pytest

from addon_tests.pure.made import frame_of, random_cloud, with_facing
from xihenet import estimators
from xihenet.edge.batching import STEPS_TO_QUEUE, Batcher, Inference, Job, QueueFull, estimate_together
from xihenet.estimators.base import EstimateContext, NotFinite
from xihenet.records import LightEstimate, UnitSphereCloud

N = 512


@pytest.fixture(scope="module")
def inference():
    return Inference("lattice")


def test_a_batch_of_all_kinds_gives_what_each_has_alone(inference):
    rng = np.random.default_rng(0)
    jobs = [Job(random_cloud(rng, N), target) for target in ("ldr", "hdr", "ldr", "hdr")]
    jobs += [Job(with_facing(random_cloud(rng, N), rng), "ldr") for _ in range(3)] + [
        Job(random_cloud(rng, 768), "ldr")
    ]
    jobs += [Job(random_cloud(rng, N, 0.01), "ldr", np.array([0.3, 0.2, 0.1])) for _ in range(2)]
    jobs.append(Job(UnitSphereCloud.empty(N), "ldr"))
    together, alone = inference(jobs), [inference([job])[0] for job in jobs]
    for one, other in zip(together, alone, strict=True):
        assert np.allclose(one.sh_radiance, other.sh_radiance, atol=1e-5)
        assert one.unknown_because == other.unknown_because
        assert np.allclose(one.expected_error or 0, other.expected_error or 0, rtol=1e-4)
    assert together[-1].unknown_because == "nothing_seen" and not together[-1].sh_radiance.any()


def test_the_light_sensor_counts_as_it_does_on_the_phone(inference):
    cloud, ambient = random_cloud(np.random.default_rng(1), N, 0.01), np.array([0.3, 0.2, 0.1])
    frame = frame_of(np.ones((2, 2)), ambient=ambient / 0.5, exposure=2.0)
    context = EstimateContext(frame, reference_exposure=0.5)
    local = estimators.load("lattice", N, "ldr").estimate(cloud, context)
    assert np.allclose(inference([Job(cloud, "ldr", ambient)])[0].sh_radiance, local, atol=1e-6)


@pytest.mark.parametrize("name", estimators.names())
def test_what_needs_more_than_anchors_and_a_light_sensor_is_not_served(name):
    if not estimators.kind(name).needs - {"frame"}:
        assert Inference(name).name == name
        return
    with pytest.raises(ValueError, match=f"^{name} .*, which .*: choose another estimator$"):
        Inference(name)


def test_one_light_that_is_not_finite_does_not_spoil_the_others(inference):
    lattice = inference.estimator(N, "ldr")

    class Spoilt(type(lattice)):
        def estimate_batch_with_error(self, *_, **__):
            raise NotFinite("one of them")

        def estimate_with_error(self, cloud, context=None):
            if cloud is jobs[1].cloud:
                raise NotFinite("this one")
            return np.ones((9, 3)), 0.1

    rng = np.random.default_rng(2)
    jobs = [Job(random_cloud(rng, N), "ldr") for _ in range(3)]
    lights = estimate_together(Spoilt(N), jobs)
    assert [light.unknown_because for light in lights] == ["", "estimate_not_finite", ""]


def light_of(job):
    return LightEstimate(np.full((9, 3), job.ambient[0]), 1.0, 0.0, "slow")


class Slow:
    """Answers once it is let go; remembers the batches."""

    def __init__(self):
        self.go, self.batches = threading.Event(), []

    def __call__(self, jobs):
        assert self.go.wait(10)
        self.batches.append(len(jobs))
        return list(map(light_of, jobs))


def job(number):
    return Job(UnitSphereCloud.empty(1), "ldr", np.full(3, number))


def test_what_arrives_meanwhile_is_the_next_batch_and_answers_find_their_requests():
    async def run():
        batcher = Batcher(slow, max_batch=4, max_queue=10)
        first = asyncio.create_task(batcher.estimate(job(0)))
        await asyncio.sleep(0.05)
        rest = [asyncio.create_task(batcher.estimate(job(number))) for number in range(1, 7)]
        await asyncio.sleep(0.05)
        slow.go.set()
        answers = await asyncio.gather(first, *rest)
        await batcher.close()
        return [answer.light.sh_radiance[0, 0] for answer in answers]

    slow = Slow()
    assert asyncio.run(run()) == list(range(7))
    assert slow.batches == [1, 4, 2]


def test_in_the_event_loop_itself_what_has_arrived_is_one_batch():
    """Requests of which each takes as many steps of the loop to be read as those over a socket do."""
    batches = []

    def lights_of(jobs):
        batches.append(len(jobs))
        return list(map(light_of, jobs))

    async def arriving(batcher, number):
        for _ in range(number % (STEPS_TO_QUEUE + 1)):
            await asyncio.sleep(0)
        return await batcher.estimate(job(number))

    async def run():
        batcher = Batcher(lights_of, max_batch=16, in_thread=False)
        answers = await asyncio.gather(*(arriving(batcher, number) for number in range(12)))
        more = await asyncio.gather(*(batcher.estimate(job(number)) for number in range(20)))
        await batcher.close()
        return [[answer.light.sh_radiance[0, 0] for answer in some] for some in (answers, more)]

    assert asyncio.run(run()) == [list(range(12)), list(range(20))]
    assert batches == [12, 16, 4]


def test_what_is_slow_has_a_thread_of_its_own(inference):
    assert inference.is_quick and not Inference("xihenet").is_quick


def test_a_full_queue_refuses_at_once_and_recovers():
    async def run():
        batcher = Batcher(slow, max_batch=4, max_queue=2)
        waiting = [asyncio.create_task(batcher.estimate(job(0)))]
        await asyncio.sleep(0.05)
        waiting += [asyncio.create_task(batcher.estimate(job(number))) for number in (1, 2)]
        await asyncio.sleep(0.05)
        with pytest.raises(QueueFull):
            await batcher.estimate(job(3))
        slow.go.set()
        await asyncio.gather(*waiting)
        assert (await batcher.estimate(job(4))).light.sh_radiance[0, 0] == 4
        await batcher.close()

    slow = Slow()
    asyncio.run(run())


@pytest.mark.parametrize("in_thread", [True, False])
def test_a_fault_reaches_those_who_wait_and_the_queue_goes_on(in_thread):
    def broken(jobs):
        if jobs[0].ambient[0] == 0:
            raise RuntimeError("a fault of ours")
        return list(map(light_of, jobs))

    async def run():
        batcher = Batcher(broken, in_thread=in_thread)
        with pytest.raises(RuntimeError, match="a fault of ours"):
            await batcher.estimate(job(0))
        assert (await batcher.estimate(job(1))).batch_size == 1
        await batcher.close()

    asyncio.run(run())


def test_who_has_gone_away_is_not_answered():
    async def run():
        batcher = Batcher(slow, max_batch=4)
        first = asyncio.create_task(batcher.estimate(job(0)))
        await asyncio.sleep(0.05)
        gone, second = (asyncio.create_task(batcher.estimate(job(number))) for number in (1, 2))
        await asyncio.sleep(0.05)
        gone.cancel()
        await asyncio.sleep(0.05)
        slow.go.set()
        await asyncio.gather(first, second)
        await batcher.close()

    slow = Slow()
    asyncio.run(run())
    assert slow.batches == [1, 1]
