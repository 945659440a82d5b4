"""`xihe replay`: the light at places in a recorded session, without Blender."""

from __future__ import annotations

import argparse
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from xihe_blender.cli.arguments import BACKEND, BETWEEN, TRIGGER, add_recording, adder, as_given, one_of, position
from xihe_blender.cli.progress import progress_line
from xihe_blender.errors import UserError
from xihe_blender.io.outputs import finite_or_none, write_json, write_together
from xihe_blender.io.run_lights import write_lights
from xihe_blender.jobs import Progress
from xihe_blender.report.replay import write_replay_report
from xihenet import __version__, estimators
from xihenet.captures import open_capture
from xihenet.captures.capture import Capture, CapturedFrame
from xihenet.captures.conventions import suspicion
from xihenet.captures.drift import Drift, steadied
from xihenet.captures.reading import READERS
from xihenet.captures.replay import REPLAY_TRIGGER, ReplayedStep, never_in_view, replay
from xihenet.edge.client import EdgeBackend, backend_at
from xihenet.estimators import Estimator
from xihenet.formats import format_count
from xihenet.invalid import added, format_reason, left_out, n_left_out
from xihenet.io.png import encode_png
from xihenet.left_out import EstimatorScore, score_places, score_session
from xihenet.light.exports import NamedLight
from xihenet.light.light_picture import light_picture, seen_picture
from xihenet.light.platforms import PLATFORMS
from xihenet.light.reflections import fill_reflections
from xihenet.records import ArrayF64, RgbdFrame, UnitSphereCloud
from xihenet.sphere import AnchorLattice
from xihenet.trigger import RULES, TriggerSettings

SCORE = (
    "say how well each estimator guesses what left-out frames show, at the positions given or at 16 of the room's own; "
    "needs no true light"
)
DRIFT = (
    "exposure and white balance of a recording whose frames do not say theirs: followed over surfaces that are seen "
    "again, or ignored"
)
SCORE_SAYS = (
    "The score is the error in directions that only left-out frames show, of light clipped at white (--target ldr). It "
    "compares estimators; it is no error of the light."
)
CHECK = "check --at, which is in metres in the recording's world"
OUT_OF_VIEW = f"is in view of no frame, so that its light is estimated from what frames show elsewhere: {CHECK}."
HIDDEN = f"lies behind a surface in all frames that look at it, so that its light is estimated from others: {CHECK}."
NOT_ASKED = "No place could be asked: every part of the recording shows what the others do."
LEAST_FRAMES, MOST_FRAMES_SHOWN = 3, 8
LOOKED_AT = 12  # Frames, to choose places that are scored; some of them twice where there are fewer
SHOWN_EVERY_S = 2.0
"""How far a recording is read; one that is read in less needs no word of it."""


@dataclass
class Place:
    """A position of the session, in the recording's world, and what was found there."""

    name: str
    at: tuple[float, float, float]
    lights: list[dict[str, Any]] = field(default_factory=list)
    exported: list[NamedLight] = field(default_factory=list)
    coverage: float = 0.0
    invalid: Mapping[str, int] = field(default_factory=dict)
    unknown: Mapping[str, int] = field(default_factory=dict)  # frames that could not tell the light, by reason
    cloud: UnitSphereCloud | None = None
    n_asked: int = 0  # frames, and those of them in which what is seen there hides it
    n_hidden: int = 0

    @property
    def where(self) -> str:
        return as_given(self.at)


class Reading:
    """Shows on `stream` how far a recording is read: as many frames as `purposes` say for each, one after the other."""

    def __init__(self, purposes: Mapping[str, int], stream: Any) -> None:
        self._doing = [f"{purpose}, frame {k + 1} of {n}" for purpose, n in purposes.items() for k in range(n)]
        self._show = progress_line(stream)
        self._n_read, self._start_s, self._due_s = 0, time.monotonic(), SHOWN_EVERY_S

    def watched(self, capture: Capture) -> Capture:
        return replace(capture, frames=[replace(frame, load=partial(self._load, frame)) for frame in capture.frames])

    def _load(self, frame: CapturedFrame) -> RgbdFrame:
        elapsed_s, total = time.monotonic() - self._start_s, len(self._doing)
        if elapsed_s >= self._due_s and self._n_read < total:
            self._show(Progress(self._n_read, total, self._doing[self._n_read]), elapsed_s)
            self._due_s = elapsed_s + SHOWN_EVERY_S
        self._n_read += 1
        return frame.load()

    def end(self) -> None:
        """Where something was shown, say that all is read."""
        if self._due_s > SHOWN_EVERY_S:
            self._show(Progress(1, 1, "all frames read"), time.monotonic() - self._start_s)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = adder(parser)
    add("session PATH", f"folder of a recording, or its .r3d file: {one_of(READERS)}", Path)
    places = "position in metres, in the recording's world; may be repeated"
    add("--at X,Y,Z", places, position, action="append", default=[])
    add("--score", SCORE, action="store_true")
    out = "folder for report.html, replay.json, and a picture of the last light of each position"
    add("--out DIR", out, Path, required=True)
    add_recording(add)
    add("--drift", DRIFT, choices=("followed", "ignored"), default="followed")
    add("--every N", "take every N-th frame; default: 1", int, default=1)
    add("--estimator NAME", one_of(n for n in estimators.names() if n != "truth"), default=estimators.DEFAULT)
    add("--backend URL", BACKEND)
    add("--between-estimates", BETWEEN, choices=("carried", "kept"), default="carried")
    add(
        "--trigger",
        TRIGGER + f"; default: the recording's own, else split with a theta of {REPLAY_TRIGGER.theta:g}",
        choices=tuple(RULES),
    )
    add("--target", "hdr: all of the light; ldr: light clipped at white", choices=("ldr", "hdr"), default="hdr")
    add("--to TARGET", "write the lights for an engine as well, as xihe export does", choices=tuple(PLATFORMS))


def run(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    if options.every < 1:
        raise UserError(f"--every: expected 1 or more, got {options.every}")
    if not (options.at or options.score):
        raise UserError("say where: give --at X,Y,Z in metres, or --score for places of the room's own")
    if options.to is not None and not options.at:
        raise UserError("--to writes the light at places: give --at X,Y,Z as well")
    report, own = options.out / "report.html", options.out / "replay.json"
    if report.exists() and not own.exists():
        raise UserError(f"{report} is there and not of a replay: choose another folder for --out")
    if options.estimator == "truth":
        raise UserError("truth is a light probe rendered in Blender, which a recording does not have: choose another")
    try:
        estimator = _estimator(options)
        capture, drift, reading = _prepared(options, stderr)
        places = [Place(f"place_{number}", at) for number, at in enumerate(options.at)]
        unseen = never_in_view(capture, _positions(capture, places))
        steps = list(_replayed(capture, places, unseen, estimator, options)) if places else []
        score = _score(capture, places, options) if options.score else None
        reading.end()
    except (ValueError, ImportError) as error:
        raise UserError(str(error)) from error
    except OSError as error:
        raise UserError(f"cannot read {error.filename} ({error.strerror}): give a folder that can be read") from error
    for note in capture.notes:
        print(f"xihe: note: {note}", file=stderr)
    for place in places:
        if place.name in unseen:
            print(f"xihe: note: The position {place.where} {OUT_OF_VIEW}", file=stderr)
        elif place.n_hidden and place.n_hidden == place.n_asked:
            print(f"xihe: note: The position {place.where} {HIDDEN}", file=stderr)
    for path in _write(options, capture, places, steps, score, drift):
        print(path, file=stdout)
    for place in places:
        print(_format_lights(place, len(steps)), file=stdout)
    if isinstance(estimator, EdgeBackend):
        print(f"xihe: note: {estimator.state()}", file=stderr)
        estimator.close()
    for one in score or ():
        interval = "" if one.low is None else f" ({one.low:.3f} to {one.high:.3f})"
        against = "" if one.estimator == "ambient" else f", better than ambient at {one.share_better:.0%} of them"
        print(
            f"{one.estimator}: {one.rmse:.3f}{interval} at {format_count(one.n_places, 'place')}{against}", file=stdout
        )
    if score is not None:
        print(f"xihe: note: {SCORE_SAYS if score else NOT_ASKED}", file=stderr)


def _prepared(options: argparse.Namespace, stderr: Any) -> tuple[Capture, Drift | None, Reading]:
    """Every N-th frame, with a note where its conventions look wrong, and with its drift divided out."""
    capture = open_capture(options.session, options.up, scale=options.scale, floor_m=options.floor)
    capture = replace(capture, frames=capture.frames[:: options.every]).kept_once_read()
    if options.score and len(capture.frames) < LEAST_FRAMES:
        raise UserError(f"--score leaves frames out: give {LEAST_FRAMES} frames or more")
    suspected = suspicion(capture)
    if suspected is not None:
        capture = replace(capture, notes=(*capture.notes, suspected))
    is_followed = not capture.is_exposure_known and options.drift == "followed"
    n = len(capture.frames)
    purposes = {
        "following the exposure": n if is_followed else 0,
        "estimating light": n if options.at else 0,
        "choosing places": LOOKED_AT if options.score and not options.at else 0,
        "scoring": n if options.score else 0,
    }
    reading = Reading(purposes, stderr)
    capture = reading.watched(capture)
    return (*(steadied(capture) if is_followed else (capture, None)), reading)


def _as_json(drift: Drift) -> dict[str, Any]:
    return {
        "frames": drift.frames.tolist(),
        "gains": drift.gains.tolist(),
        "is_known": drift.is_known.tolist(),
        "n_unknown": drift.n_unknown,
        "n_samples": drift.n_samples.tolist(),
        "residual": [finite_or_none(value) for value in drift.residual],
    }


def _estimator(options: argparse.Namespace) -> Estimator | EdgeBackend:
    if options.backend is None:
        return estimators.load(options.estimator, target=options.target)
    return backend_at(options.backend, options.estimator, 1280, options.target)


def _score(capture: Capture, places: Sequence[Place], options: argparse.Namespace) -> list[EstimatorScore]:
    chosen = capture.frames
    # Beside the ambient light those that need nothing but what was seen.
    names = ["ambient", *(name for name in estimators.names() if not estimators.kind(name).needs)]
    loaded = {name: estimators.load(name, target="ldr") for name in names}
    if places:
        places_m = np.array(list(_positions(capture, places).values()))
    else:
        places_m = score_places([chosen[k].read() for k in np.linspace(0, len(chosen) - 1, LOOKED_AT).astype(int)])
    rng = np.random.default_rng(0)
    return score_session(capture, len(chosen), places_m, loaded, rng, reference_exposure=capture.reference_exposure)


def _positions(capture: Capture, places: Sequence[Place]) -> dict[str, ArrayF64]:
    """In Blender's axes."""
    return {place.name: capture.blender_from_file @ np.array(place.at) for place in places}


def _trigger(capture: Capture, options: argparse.Namespace) -> TriggerSettings:
    """The one that was chosen, else the recording's own."""
    return capture.trigger or REPLAY_TRIGGER if options.trigger is None else RULES[options.trigger]


def _replayed(
    capture: Capture,
    places: Sequence[Place],
    unseen: Collection[str],
    estimator: Estimator | EdgeBackend,
    options: argparse.Namespace,
) -> Iterator[dict[str, Any]]:
    """Per frame what is written of it; fills the places."""
    last: ReplayedStep | None = None
    for step in replay(
        capture,
        _positions(capture, places),
        estimator,
        trigger=_trigger(capture, options),
        has_key_light=True,
        has_reflections=options.to is not None,
        reference_exposure=capture.reference_exposure,
        never_in_view=unseen,
        between_estimates=options.between_estimates,
    ):
        last = step
        for place in places:
            _note(place, step)
        yield {
            "frame": step.frame,
            "time_s": step.time_s,
            "stage_ms": added(report.stage_ms for report in step.reports.values()),
            "positions": {
                name: {
                    "fired": report.decision.fire,
                    "reason": report.decision.reason,
                    "coverage": report.coverage,
                    "light_gain": step.gains[name].tolist() if name in step.gains else None,
                }
                for name, report in step.reports.items()
            },
        }

    if last is not None:
        for place in places:
            place.cloud = last.known(place.name)


def _note(place: Place, step: ReplayedStep) -> None:
    report = step.reports.get(place.name)
    if report is None:  # Out of view
        return
    place.n_asked, place.n_hidden = place.n_asked + 1, place.n_hidden + (place.name in step.hidden)
    place.coverage, place.invalid = report.coverage, added([place.invalid, report.invalid])
    place.unknown = added([place.unknown, {report.unknown_because: 1} if report.unknown_because else {}])
    estimate = report.estimate
    if estimate is None or not estimate.is_valid:
        return
    key = estimate.key
    place.lights.append(
        {
            "frame": step.frame,
            "time_s": step.time_s,
            "coverage": estimate.coverage,
            "expected_error": finite_or_none(estimate.expected_error),
            "sh_radiance": estimate.sh_radiance.tolist(),
            "key_light": None
            if key is None
            else {"direction": key.direction.tolist(), "irradiance": key.irradiance.tolist(), "is_seen": key.is_seen},
        }
    )
    light, seen = step.lights[place.name], estimate.reflected
    if seen is not None:
        light = replace(light, reflections=fill_reflections(seen, AnchorLattice(len(seen)), light))
    place.exported.append(NamedLight(place.name, step.frame, step.time_s, light))


def _write(
    options: argparse.Namespace,
    capture: Capture,
    places: Sequence[Place],
    steps: Sequence[Any],
    score: Sequence[EstimatorScore] | None,
    drift: Drift | None,
) -> list[Path]:
    """All that the command leaves; replay.json last."""
    out = options.out
    content = {
        "schema_version": 1,
        "software": {"xihe": __version__, "numpy": np.__version__},
        "format": capture.format_name,
        "source": capture.source,
        "notes": list(capture.notes),
        "reference_exposure": capture.reference_exposure,
        "estimator": options.estimator,
        "backend": options.backend,
        "between_estimates": options.between_estimates,
        "trigger": asdict(_trigger(capture, options)),
        "target": options.target,
        "sh_axes": "right-handed, +Z up",
        "blender_from_recording": capture.blender_from_file.tolist(),
        "positions": [
            {
                "name": place.name,
                "at": list(place.at),
                "coverage": place.coverage,
                "n_invalid_points": n_left_out(place.invalid),
                "invalid": dict(place.invalid),
                "unknown": dict(place.unknown),
                "lights": place.lights,
            }
            for place in places
        ],
        "frames": steps,
        "drift": None if drift is None else _as_json(drift),
        "score": None if score is None else {"says": SCORE_SAYS, "estimators": [asdict(one) for one in score]},
    }
    try:
        pictures = {f"{place.name}.png": _light_png(place) for place in places if place.lights}
        written = write_together(out, pictures)
        if options.to is not None:
            lights = [light for place in places for light in place.exported]
            written += write_lights(lights, options.to, out / options.to)
        shown = {place.name: _pictures(place) for place in places if place.lights}
        write_replay_report(out / "report.html", content, shown, _shown_frames(capture, places))
        written.append(out / "report.html")
        write_json(out / "replay.json", content)
    except OSError as error:
        raise UserError(f"cannot write to {out} ({error.strerror}): choose another folder for --out") from error
    return [*written, out / "replay.json"]


def _pictures(place: Place) -> tuple[bytes, bytes]:
    """PNG files of the sphere as it was seen, and of the last light."""
    assert place.cloud is not None
    return encode_png(seen_picture(place.cloud, 128)), _light_png(place, panorama_height=128)


def _light_png(place: Place, **drawn: int) -> bytes:
    """PNG file of the last light, `drawn` as `light_picture` takes it."""
    return encode_png(light_picture(np.array(place.lights[-1]["sh_radiance"]), **drawn))


def _shown_frames(capture: Capture, places: Sequence[Place]) -> list[tuple[int, bytes]]:
    """Numbers and PNG files of some frames: of those with an estimate, or of all where there are few."""
    chosen = capture.frames
    fired = {light["frame"] for place in places for light in place.lights}
    wanted = [frame for frame in chosen if frame.number in fired]
    if len(wanted) < MOST_FRAMES_SHOWN:
        wanted = list(chosen)
    some = np.unique(np.linspace(0, len(wanted) - 1, MOST_FRAMES_SHOWN).astype(int))
    return [(wanted[k].number, encode_png(wanted[k].read().srgb_u8)) for k in some]


def _format_lights(place: Place, n_frames: int) -> str:
    if not place.lights:
        return f"{place.where}: no light could be known in {format_count(n_frames, 'frame')}{_why_unknown(place)}"
    last = place.lights[-1]
    expected = "" if last["expected_error"] is None else f", expected error {last['expected_error']:.3f}"
    seen = f"{place.coverage:.0%} of the sphere seen"
    made, frames = format_count(len(place.lights), "estimate"), format_count(n_frames, "frame")
    return f"{place.where}: {made} in {frames}, {seen}{expected}"


def _why_unknown(place: Place) -> str:
    """The reason of most of its frames, and that of most of the points that were left out; empty for none."""
    reasons, lost = [], left_out(place.invalid)
    if place.unknown:
        reasons.append(format_reason(max(place.unknown, key=place.unknown.__getitem__)))
    if lost:
        most = max(lost, key=lost.__getitem__)
        reasons.append(f"{lost[most]} points left out ({format_reason(most)})")
    return f": {'; '.join(reasons)}" if reasons else ""
