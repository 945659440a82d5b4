"""The score without truth: does it order estimators as true errors do? Recordings with the true light beside them.

    xihe record ROOM.blend --out ROOM --truth        (for each room)
    python addon_tests/bench/session_score.py ROOM ...

For each recording the score of every estimator at places of the room's own, and its true error at the places of
truth.json: SHC RMSE of light clipped at white, from all frames; then the rank correlation of both. At the end its mean
over recordings, and in how many the estimator with the best score is also the one with the least error.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
from given import given

from xihe_blender.lab.paper.clouds import walk_errors
from xihe_blender.lab.paper.records import Place, Session
from xihenet import estimators
from xihenet.captures import open_capture
from xihenet.captures.capture import Capture
from xihenet.io.json_files import read_json
from xihenet.left_out import score_places, score_session
from xihenet.paired import rank_correlation
from xihenet.sphere import AnchorLattice

NAMES = ("ambient", "projection", "xihenet", "lattice")


def true_errors(capture: Capture, folder: Path) -> dict[str, float]:
    """Mean over the places whose light stays the same."""
    truth = read_json(folder / "truth.json")
    n_lights = Counter(one["name"] for one in truth["places"])
    steady = [one for one in truth["places"] if n_lights[one["name"]] == 1]
    places = [Place(one["name"], np.array(one["position_m"]), np.array(one["ldr"])) for one in steady]
    walk, lattice = Session(folder.name, list(capture), truth["exposure"], places), AnchorLattice(1280)
    errors = {name: walk_errors([walk], lattice, estimators.load(name, target="ldr").estimate) for name in NAMES}
    return {name: float(np.mean(found)) if found else np.nan for name, found in errors.items()}


def scores(capture: Capture) -> dict[str, float]:
    chosen = np.linspace(0, len(capture.frames) - 1, 12).astype(int)
    places_m = score_places([capture.frames[k].read() for k in chosen])
    loaded = {name: estimators.load(name, target="ldr") for name in NAMES}
    found = score_session(
        iter(capture), len(capture.frames), places_m, loaded, np.random.default_rng(0),
        reference_exposure=capture.reference_exposure,
    )  # fmt: skip
    return {one.estimator: one.rmse for one in found}


def main() -> None:
    folders, correlations, n_best = given(__doc__, "rooms+").rooms, [], 0
    print("| recording | " + " | ".join(f"{name}: score, error" for name in NAMES) + " | rank correlation |")
    print("| --- |" + " --- |" * (len(NAMES) + 1))
    for folder in folders:
        capture = open_capture(folder)
        found, errors = scores(capture), true_errors(capture, folder)
        if not found or np.isnan(list(errors.values())).any():
            print(f"| {folder.name} | nothing could be asked |", flush=True)
            continue
        correlations.append(rank_correlation([found[n] for n in NAMES], [errors[n] for n in NAMES]))
        n_best += min(found, key=found.__getitem__) == min(errors, key=errors.__getitem__)
        cells = " | ".join(f"{found[name]:.3f}, {errors[name]:.3f}" for name in NAMES)
        print(f"| {folder.name} | {cells} | {correlations[-1]:.2f} |", flush=True)
    if correlations:
        best = f"the best by score is the best in truth in {n_best} of {len(correlations)}"
        print(f"mean rank correlation {np.mean(correlations):.2f}; {best}")


if __name__ == "__main__":
    main()
