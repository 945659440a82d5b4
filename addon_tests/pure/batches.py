"""Made-up results of a batch, in which everyone knows who is better by how much."""

import numpy as np

from xihe_blender.io.run_results import METRICS
from xihe_blender.lab.batch.grid import BatchSettings
from xihe_blender.lab.batch.results import (
    WORST_KINDS,
    BatchFolder,
    BatchResults,
    Failure,
    Trial,
    TrialFrame,
    TriggerFigures,
    UnitRow,
    worst_picture,
)
from xihe_blender.lab.frontier.records import Frontier, FrontierSettings
from xihenet.io.png import write_png

FACTORS = (0.0, 0.25, 1.0, 4.0)
HALF = dict.fromkeys(METRICS, 0.5)


def trial(scene="room", seed=0, phone="perfect", estimator="lattice", error=0.1, psnr=20.0, **more):
    frames = [
        TrialFrame(
            frame=frame, time_s=frame / 30, n_fired=1, shc_rmse=error + 0.01 * (frame - 2), coverage=0.5,
            **HALF | {"psnr": None if psnr is None else psnr + (2 - frame)},
        )
        for frame in (1, 2, 3)
    ]  # fmt: skip
    sweep = [
        TriggerFigures(factor=f, theta=0.02 * f, coverage_theta=0.05 * f, per_minute=60 / (1 + f), shc_rmse=error)
        for f in FACTORS
    ]
    counts = dict.fromkeys(("n_frames", "n_active_frames", "n_compared_frames", "n_estimates"), 3)
    means = {"shc_rmse": error, "coverage": 0.5, **HALF, "psnr": psnr, "estimates_per_minute": 30.0}
    given = {"frames": tuple(frames), "trigger_sweep": tuple(sweep), **counts, **means, **more}
    return Trial(
        unit=f"{scene}_{seed}", scene=scene, seed=seed, number=0, phone=phone, estimator=estimator,
        payload_bytes=1000, **given,
    )  # fmt: skip


def batch(n_scenes=8, phones=("perfect", "cheap"), seeds=(0, 1)):
    """`lattice` beats `projection` by 0.1 and `ambient` by 0.2 everywhere; the cheap phone costs 0.05."""
    more = {"lattice": 0.0, "projection": 0.1, "ambient": 0.2, "truth": -0.2}
    return [
        trial(
            f"room {scene}", seed, phone, estimator,
            error=0.25 + 0.03 * scene + more[estimator] + (0.05 if phone != "perfect" else 0.0),
            psnr=20.0 - scene - 10 * more[estimator],
        )
        for scene in range(n_scenes)
        for seed in seeds
        for phone in phones
        for estimator in more
    ]  # fmt: skip


def results(trials, failed=()):
    cost = {"elapsed_s": 1.0, "processor_s": 1.0, "render_s": 0.5, "peak_memory_mb": 400.0, "written_bytes": 10_000}
    units = {t.unit: UnitRow(unit=t.unit, scene=t.scene, seed=t.seed, step_ms=(1.0,), **cost) for t in trials}
    return BatchResults(
        software={},
        settings=BatchSettings(),
        trials=tuple(trials),
        units=tuple(units.values()),
        failed=tuple(Failure(what=what, reason=reason) for what, reason in failed),
    )


def frontier(points=(), answers=()):
    """A frontier of such points."""
    return Frontier(
        software={}, machine={}, settings=FrontierSettings(), scenes=(), answers=tuple(answers), points=tuple(points)
    )


def folder_with_pictures(path, trials):
    """A batch's folder that holds the worst pictures of `trials`."""
    for one in trials:
        for kind in WORST_KINDS:
            file = worst_picture(path / "units" / one.unit, one.number, kind)
            file.parent.mkdir(parents=True, exist_ok=True)
            write_png(file, np.full((3, 4, 3), 128, np.uint8))
    return BatchFolder(path)
