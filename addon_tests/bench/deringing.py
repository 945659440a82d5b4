"""De-ringing: what does it cost in error to take the ringing off an estimate before it is shown?

    python addon_tests/bench/deringing.py FOLDER_OF_TEST_ROOMS

Clouds as in `test_rooms.py`, patches and facing. SHC RMSE against the light of the rooms, clipped at white ("ldr") and
not ("hdr"), as estimated and after `dering_for_display`, and the share of the estimates that it changes.
"""

from __future__ import annotations

import numpy as np
from given import given
from test_rooms import seen_in

from xihenet import estimators
from xihenet.metrics import shc_rmse
from xihenet.sh import dering_for_display
from xihenet.training.rooms import room_files

CHOICES = [(name, target) for name in ("lattice", "projection") for target in ("ldr", "hdr")]


def main() -> None:
    files = room_files(given(__doc__, "rooms").rooms)
    loaded = [estimators.load(name, target=target) for name, target in CHOICES]
    pairs: dict[tuple[str, str, str], list[tuple[np.ndarray, np.ndarray]]] = {}
    for seen in (one for path in files for one in seen_in(path)):
        for one in loaded:
            light, truth = one.estimate(seen.clouds[-1]), seen.truths[one.target]
            pairs.setdefault((seen.views, one.name, one.target), []).append((light, truth))
    print(f"{len(files)} rooms\n")
    print("| views | estimator | target | estimates | changed | SHC RMSE | without ringing | more error |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for (views, name, target), known in pairs.items():
        shown = [(dering_for_display(light), light, truth) for light, truth in known]
        changed = sum(not np.array_equal(one, light) for one, light, _ in shown)
        before = np.mean([shc_rmse(light, truth) for light, truth in known])
        after = np.mean([shc_rmse(one, truth) for one, _, truth in shown])
        figures = f"{len(known)} | {changed} ({changed / len(known):.0%}) | {before:.5f} | {after:.5f}"
        print(f"| {views} | `{name}` | {target} | {figures} | {after / before - 1:+.2%} |")


if __name__ == "__main__":
    main()
