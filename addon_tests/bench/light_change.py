"""A change of the light: what does following it do to the light in use? A table over the captures of previs runs.

    python addon_tests/bench/light_change.py out/living_room out/lamp_off ...

For each run and estimator: the mean SHC RMSE against the rendered truth from frame FROM on, where what is out of view
is kept and where it follows, and in how many steps it did. A run under light that does not change must follow in none:
then the two are the same to the last bit. Nothing is rendered.
"""

from __future__ import annotations

import numpy as np
from given import given
from trigger import Recorded, read_run, steps_of

from xihe_blender.previs.settings import PREVIS_TRIGGER
from xihenet.controller import ControllerSettings
from xihenet.light_change import LightFollowing

FROM = 13


def walk(recorded: Recorded, estimator: str, following: LightFollowing | None) -> tuple[float, int]:
    """The mean error from frame FROM on, and the steps in which anchors followed."""
    chain = ControllerSettings(PREVIS_TRIGGER, reference_exposure=recorded.exposure, following=following)
    steps = list(steps_of(recorded, estimator, chain))
    errors = [error for frame, _, error in steps if error is not None and frame.frame >= FROM]
    return float(np.mean(errors)), sum(step.n_followed_anchors > 0 for _, step, _ in steps)


def main() -> None:
    folders = given(__doc__, "runs+").runs
    print(f"{'run':<28}{'estimator':<12}{'kept':>8}{'followed':>10}{'steps':>7}")
    for folder in folders:
        recorded = read_run(folder)
        for estimator in ("lattice", "projection"):
            kept, _ = walk(recorded, estimator, None)
            followed, n_followed = walk(recorded, estimator, LightFollowing())
            print(f"{recorded.name:<28}{estimator:<12}{kept:8.4f}{followed:10.4f}{n_followed:7d}")


if __name__ == "__main__":
    main()
