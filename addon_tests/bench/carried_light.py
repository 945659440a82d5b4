"""Carried light: what does carrying it between estimates do to the light in use? A table over runs and recordings.

    python addon_tests/bench/carried_light.py out/light_intensity out/light_temperature [--estimator projection]
    python addon_tests/bench/carried_light.py --lamp RECORDING ...

For a finished previs run and each link: the mean SHC RMSE against the rendered truth of the light in use where it is
kept from estimate to estimate, where it is multiplied by the ratio of two readings of the ambient sensor, and where it
is carried as `xihenet.light.carried_light` does; and of an estimate made and there in every frame. An estimate over a
link comes in the first frame after its arrival.

With `--lamp`, for a recording whose light stands still: the same under a lamp that we put in, the pictures times a
factor. Its light is known without any truth: that of every frame's own estimate. `off` is the relative difference
(norms of coefficients) of the light in use from it, mean over the frames after the first estimate; `flicker` is the
change of the light from frame to frame over those of the second half in which no estimate came, mean and most, as a
share of it. "none" leaves the light alone. Nothing is rendered.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from given import given
from trigger import EVERY_FRAME, read_run

from xihe_blender.previs.settings import PREVIS_TRIGGER
from xihenet import estimators
from xihenet.backend import LocalBackend
from xihenet.camera import sensed_ambient
from xihenet.captures import open_capture
from xihenet.colour import linear_to_srgb, srgb_to_linear
from xihenet.controller import ControllerSettings, XiheController
from xihenet.light.carried_light import BLEND_S, CarriedLight, blended
from xihenet.metrics import shc_rmse
from xihenet.phone import LINKS, EstimatesUnderWay
from xihenet.records import ArrayF64, ObjectLight, RgbdFrame, UnitSphereCloud

MODES = ("kept", "sensor", "carried")
LAMPS: dict[str, Callable[[float], float]] = {
    "none": lambda share: 1.0,
    "to a half, slowly": lambda share: 0.5 ** np.clip(3 * share - 1, 0, 1),
    "to a half at once": lambda share: 0.5 if share > 0.5 else 1.0,
    "up and down by a stop": lambda share: 2 ** np.sin(12 * np.pi * share),
}
Lights = Mapping[str, ArrayF64]


@dataclass(frozen=True)
class Shown:
    """The light in use at a position after a frame, by mode; `is_new` where an estimate has come since the last."""

    frame: int
    position: str
    lights: Lights
    is_new: bool


def shown_lights(
    frames: Iterable[tuple[RgbdFrame, Iterable[str]]], session: XiheController, link: str | None
) -> Iterator[Shown]:
    """Of each frame with the positions in view, with the positions in view."""
    under_way, sensed, before = EstimatesUnderWay(LINKS[link] if link else None, 0), {}, {}
    last_seen: dict[str, UnitSphereCloud] = {}
    going_on: dict[tuple[str, int], CarriedLight] = {}
    for seen, active in frames:
        sensed[seen.frame] = np.maximum(sensed_ambient(seen.srgb_u8, seen.exposure), 1e-6)
        for name, step in session.step(seen, active=list(active)).items():
            now, directions = session.seen(name), session.lattice.directions
            for key in [key for key in going_on if key[0] == name]:
                going_on[key] = going_on[key].after(now, last_seen.get(name), directions)
            last_seen[name] = now
            if step.estimate is not None:
                going_on[name, seen.frame] = CarriedLight(step.estimate)
                under_way.ask(name, step.estimate, frame=seen.frame, asked_s=seen.time_s, payload_bytes=4249)
            last = under_way.in_use(name, seen.time_s)
            if last is None:
                continue
            sh, shares = last.estimate.sh_radiance, under_way.shares(name, seen.time_s, BLEND_S)
            oldest = min(one.frame for _, one in shares)
            going_on = {key: one for key, one in going_on.items() if key[0] != name or key[1] >= oldest}
            parts = [(share, going_on[name, one.frame].light) for share, one in shares]
            lights = {
                "kept": sh,
                "sensor": sh * sensed[seen.frame] / sensed[last.frame],
                "carried": blended([(share, ObjectLight(light.sh_radiance)) for share, light in parts]).sh,
            }
            yield Shown(seen.frame, name, lights, before.get(name) != last.frame)
            before[name] = last.frame


def a_session(estimator: str, exposure: float | None, places: Mapping, *, every_frame: bool = False) -> XiheController:
    trigger = EVERY_FRAME if every_frame else PREVIS_TRIGGER
    chain = ControllerSettings(trigger, reference_exposure=exposure)
    session = XiheController(LocalBackend(estimators.load(estimator, target="hdr")), chain)
    for name, place_m in places.items():
        session.add_position(name, place_m)
    return session


def of_a_run(folder: Path, estimator: str) -> None:
    recorded = read_run(folder)
    frames = [(one, list(truth)) for one, truth in zip(recorded.frames, recorded.truth, strict=True)]
    truths = {one.frame: truth for one, truth in zip(recorded.frames, recorded.truth, strict=True)}

    def errors(mode: str, shown: list[Shown]) -> str:
        return f"{np.mean([shc_rmse(one.lights[mode], truths[one.frame][one.position]) for one in shown]):.4f}"

    for link in (None, *LINKS):
        shown = list(shown_lights(frames, a_session(estimator, recorded.exposure, recorded.positions), link))
        cells = [errors(mode, shown) for mode in MODES]
        if link is None:
            session = a_session(estimator, recorded.exposure, recorded.positions, every_frame=True)
            best = errors("kept", list(shown_lights(frames, session, None)))
        print(f"| {recorded.name} | {link or 'at once'} | {' | '.join(cells)} | {best} |", flush=True)


def lit(frame: RgbdFrame, factor: float) -> RgbdFrame:
    shown = np.clip(srgb_to_linear(frame.srgb_u8 / 255) * factor, 0, 1)
    return replace(frame, srgb_u8=np.rint(255 * linear_to_srgb(shown)).astype(np.uint8))


def of_a_lamp(folder: Path, estimator: str) -> None:
    frames, places = list(open_capture(folder)), places_of(folder)
    for words, lamp in LAMPS.items():
        walk = [(lit(one, lamp(i / len(frames))), list(places)) for i, one in enumerate(frames)]
        session = a_session(estimator, None, places, every_frame=True)
        own = {(one.frame, one.position): one.lights["kept"] for one in shown_lights(walk, session, None)}
        for link in (None, *LINKS):
            shown = list(shown_lights(walk, a_session(estimator, None, places), link))
            off = {m: np.mean([_change(own[s.frame, s.position], s.lights[m]) for s in shown]) for m in MODES}
            flicker = {m: list(_flicker(m, shown, frames[len(frames) // 2].frame)) or [0.0] for m in MODES}
            cells = [f"{off[mode]:.1%}" for mode in MODES]
            cells += [f"{np.mean(flicker[mode]):.2%}, {max(flicker[mode]):.1%}" for mode in MODES]
            print(f"| {folder.name} | {words} | {link or 'at once'} | {' | '.join(cells)} |", flush=True)


def places_of(folder: Path) -> dict[str, ArrayF64]:
    """1.5 m before the camera in the middle of the walk."""
    frames = open_capture(folder).frames
    pose = frames[len(frames) // 2].camera.world_from_camera
    return {"place": pose[:3, 3] - pose[:3, 2] * 1.5}


def _change(before: ArrayF64, after: ArrayF64) -> float:
    return float(np.linalg.norm(after - before) / np.linalg.norm(before))


def _flicker(mode: str, shown: list[Shown], since: int) -> Iterator[float]:
    for before, after in itertools.pairwise(shown):
        if after.frame > since and not after.is_new and before.position == after.position:
            yield _change(before.lights[mode], after.lights[mode])


def main() -> None:
    options = given(__doc__, "folders+", estimator="lattice", lamp=False)
    columns = ["run", "estimates come", *MODES, "every frame"]
    if options.lamp:
        of_modes = [f"{what}, {mode}" for what in ("off", "flicker") for mode in MODES]
        columns = ["recording", "lamp", "estimates come", *of_modes]
    print(f"| {' | '.join(columns)} |\n|{' --- |' * len(columns)}")
    for folder in options.folders:
        (of_a_lamp if options.lamp else of_a_run)(folder, options.estimator)


if __name__ == "__main__":
    main()
