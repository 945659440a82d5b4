"""The results of a run: what results.json says, field by field, and how it is read back.

Strict JSON: no NaN and no Infinity, None where a value is undefined. Lengths are in metres, times in seconds unless a
name says `ms`. Coefficients are nine triples (R, G, B) of radiance SH in the order l*l + l + m, real and orthonormal,
axes as in Blender's world; they carry `settings.reference_exposure`, and dividing by it gives scene radiance.

docs/results.schema.json is made from these records, whose docstrings describe their fields
(`python -m xihe_blender.io.run_results`). Nothing here needs NumPy or Blender, since the panel reads results too.
"""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Literal

from xihe_blender.errors import UserError
from xihe_blender.io.json_records import ABSENT, INLINE, from_json, json_schema
from xihenet.json_files import read_json

SCHEMA_VERSION: Literal[1] = 1

Rgb = tuple[float, float, float]
Coefficients = tuple[Rgb, ...]
Plain = str | int | float | bool | None
Counts = dict[str, int]


@dataclass(frozen=True, kw_only=True)
class Fault:
    """Something in the scene that cannot be lit or believed as it stands (docs/odd_scenes.md).

    name : of the data-block
    n : how often
    said : a sentence for the reader, also among the notes
    """

    name: str
    n: int
    said: str


@dataclass(frozen=True, kw_only=True)
class SceneResult:
    """The scene that was run.

    file, name, camera : of the scene, None for no camera
    fps : frames per second
    virtual_objects : names, in the order of the results
    view_transform : the scene's own; pictures are made with Standard
    faults : see there
    """

    file: str
    name: str
    camera: str | None
    fps: float
    virtual_objects: tuple[str, ...]
    view_transform: str
    faults: tuple[Fault, ...] = ()


@dataclass(frozen=True, kw_only=True)
class EffectResult:
    """One thing that was or was not simulated: of light transport, the phone or the session.

    name, state, reason : what, whether, and why
    parameters : what Cycles was set to, or the profile's numbers
    origin : who decided
    """

    name: str
    state: Literal["on", "off"]
    reason: str
    parameters: dict[str, Plain | tuple[Plain, ...]] = field(default_factory=dict)
    origin: Literal["auto", "user"] = "auto"


@dataclass(frozen=True, kw_only=True)
class PhoneErrors:
    """What the phone's effects do to the light: mean SHC RMSE over probes and frames.

    all_on : with all of them
    perfect : with none
    without : with all but one, by its name; None for the frame rate
    """

    all_on: float | None
    perfect: float | None
    without: dict[str, float | None]


@dataclass(frozen=True, kw_only=True)
class PhoneResult:
    """The phone of the run.

    name, summary : of its profile (docs/phone.md)
    shc_rmse : None where none of its effects is on
    """

    name: str
    summary: str
    shc_rmse: PhoneErrors | None = None


@dataclass(frozen=True, kw_only=True)
class SampleCounts:
    """Samples per pixel, and pictures of the light probe at most.

    capture, truth, comparison : of captures, of light probes, of compared pictures
    """

    capture: int
    truth: int
    comparison: int


@dataclass(frozen=True, kw_only=True)
class NoiseLevels:
    """Relative noise; None where the number of samples was given.

    capture : what captures have
    truth : what light probes aim at
    trigger : the change of colour that the trigger would see in noise alone
    """

    capture: float | None
    truth: float | None
    trigger: float | None = None


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """What was asked for, and what came of it.

    estimator, preset, target, seed, phone, network, n_anchors, codec : as in the command line; no network is None
    size : of captures and comparisons, width and height
    frames : of the path
    effect_choices : on or off by effect, where the user chose
    reference_exposure : of the session; coefficients carry it
    metering : how it was found; None where it was given
    trigger, following : numbers of the trigger, with noise added to theta, and of light that follows; None for neither
    samples, noise : see there
    noise_target : what was aimed at; None where the number of samples was given
    truth_size : pixels of the light probe's pictures
    comparison_step : every so many-th active frame was compared
    comparison_view_transform, error_map_full_scale : of the pictures
    """

    estimator: str
    preset: str
    target: Literal["ldr", "hdr"]
    size: tuple[int, int]
    frames: tuple[int, ...]
    n_anchors: int
    codec: str
    seed: int
    phone: str = "perfect"
    network: str | None = None
    effect_choices: dict[str, str] = field(default_factory=dict)
    reference_exposure: float
    metering: str | None = None
    trigger: dict[str, Plain]
    following: dict[str, Plain] | None = None
    samples: SampleCounts
    noise_target: float | None = None
    noise: NoiseLevels
    truth_size: tuple[int, int]
    comparison_step: int
    comparison_view_transform: str
    error_map_full_scale: float


@dataclass(frozen=True, kw_only=True)
class CaptureRender:
    """The render of one capture.

    rendered : for this frame
    same_as : the earlier frame whose pixels it would have had again; None where it was rendered
    samples : it has
    noise : expected at these, relative to the light; None where it was not measured
    """

    rendered: bool
    same_as: int | None
    samples: int
    noise: float | None


@dataclass(frozen=True, kw_only=True)
class ProbeRender(CaptureRender):
    """The render of one light probe (docs/reference_light.md).

    rendered, same_as, samples, noise : as for a capture
    expected_error : the noise and what is not noise
    is_capped : whether the preset's most samples left it above `settings.noise.truth`
    """

    expected_error: float | None = None
    is_capped: bool = False


@dataclass(frozen=True, kw_only=True)
class Rendering:
    """What was rendered for a frame.

    capture : what the phone would see
    probes : the light probe of each position in view, by its name
    """

    capture: CaptureRender
    probes: dict[str, ProbeRender]


@dataclass(frozen=True, kw_only=True)
class ProbeResult:
    """One estimation position in one frame.

    name, object : of the position and of the virtual object that it stands for
    position_m : world
    coverage : share of the anchors that are set
    fired, reason : whether an estimate was asked for, and why
    change : what the trigger compared with `threshold`; None for `first`
    threshold : None where nothing was compared
    n_changed_anchors : above it
    n_skipped_points, n_invalid_points : points of this frame that were left out; the same number
    invalid : these and clamped distances, by reason (docs/invalid_data.md)
    is_valid : false where the light could not be known, so that the last one stays
    unknown_because : why, else None
    light_frame : whose estimate is in force; None for the ambient light
    n_followed_anchors : directions out of view that were changed as the light in view was
    payload_bytes : sent; 0 where nothing fired
    arrival_frame : the first at or after the arrival; None also where the path ends before
    latency_ms : from trigger to arrival; None where no estimate was made or it was lost
    sh : the light in force, the ambient one until a valid estimate has arrived
    sh_truth : the light probe's, for `settings.target`
    shc_rmse, ambient_shc_rmse : root mean square difference from it, of `sh` and of the ambient light
    share_above_white : of the light what lies above white at the session's exposure or comes from lamps that cameras
        do not see; None without light
    """

    name: str
    object: str
    position_m: tuple[float, float, float]
    coverage: float
    fired: bool
    reason: Literal["first", "colour", "coverage", "none"]
    change: float | None
    threshold: float | None
    n_changed_anchors: int
    n_skipped_points: int = 0
    n_invalid_points: int = 0
    invalid: Counts = field(default_factory=dict)
    is_valid: bool = True
    unknown_because: str | None = None
    light_frame: int | None = None
    n_followed_anchors: int = 0
    payload_bytes: int
    arrival_frame: int | None = None
    latency_ms: float | None = None
    sh: Coefficients
    sh_truth: Coefficients
    shc_rmse: float
    ambient_shc_rmse: float | None = None
    share_above_white: float | None = None


@dataclass(frozen=True, kw_only=True)
class Metrics:
    """A method's picture against the ground truth; None where undefined.

    psnr : dB
    ssim, rmse, si_rmse : structural similarity, root mean square error, and the latter at the best common scale
    angular_deg : mean angle between colours
    """

    psnr: float | None
    ssim: float | None
    rmse: float | None
    si_rmse: float | None
    angular_deg: float | None


METRICS = tuple(field.name for field in fields(Metrics))


@dataclass(frozen=True, kw_only=True)
class ComparedFrame:
    """The pictures of one frame, beside the ground truth.

    pictures : paths in the run's folder, by kind; `captured` is what the phone saw
    comparison : by method
    n_hueless_pixels : by method, black pixels that `angular_deg` leaves out
    comparison_render_s : 0 where it was taken over
    comparison_same_as : the frame that it was taken over from, or None
    """

    pictures: dict[str, str]
    comparison: dict[str, Metrics]
    n_hueless_pixels: Counts
    comparison_render_s: float
    comparison_same_as: int | None


@dataclass(frozen=True, kw_only=True)
class FrameResult:
    """One frame of the path. Not active where no position is in view, or the phone does not deliver it.

    frame, time_s : its number, and when it is
    active : whether it was captured; else nothing is rendered, and `probes` is empty
    is_delivered : false where the phone is slower than the scene
    exposure : of the phone's frame
    render_s, work_s : of capture and light probes, and of all else
    stage_ms : by stage, summed over positions
    ambient_radiance : of the phone's light sensor
    n_invalid_pixels : without plane depth
    n_lost_pixels : of these, what each effect of the phone took
    invalid : pixels that gave no point or were clamped, by reason
    probes, rendering : see there
    compared : see ComparedFrame; its fields stand among the frame's own in the file
    """

    frame: int
    time_s: float
    active: bool
    is_delivered: bool = True
    exposure: float | None = field(default=None, metadata=ABSENT)
    render_s: float = 0.0
    work_s: float = 0.0
    stage_ms: dict[str, float] = field(default_factory=dict)
    ambient_radiance: Rgb | None = None
    n_invalid_pixels: int = 0
    n_lost_pixels: Counts = field(default_factory=dict)
    invalid: Counts = field(default_factory=dict)
    probes: tuple[ProbeResult, ...] = ()
    rendering: Rendering | None = field(default=None, metadata=ABSENT)
    compared: ComparedFrame | None = field(default=None, metadata=INLINE)


@dataclass(frozen=True, kw_only=True)
class LightChange:
    """From a frame on, an object's light.

    frame : from which on
    sh : the mean over the object's positions
    """

    frame: int
    sh: Coefficients


@dataclass(frozen=True, kw_only=True)
class InvalidCounts:
    """What was left out or is undefined in a run, by reason (docs/invalid_data.md).

    pixels, points, lights : in sums
    metrics : without a value, by metric
    hues : black pixels, by method
    """

    pixels: Counts
    points: Counts
    lights: Counts
    metrics: Counts
    hues: Counts


@dataclass(frozen=True, kw_only=True)
class Summary:
    """The run in a few numbers; means over what is defined.

    n_frames, n_active_frames, n_compared_frames : of the path
    n_reused_captures, n_reused_probes, n_reused_comparisons : taken from an earlier frame
    n_estimates, fired_share : triggers, and their share of all steps
    mean_shc_rmse, ambient_shc_rmse, mean_coverage, share_above_white : over positions and frames
    n_capped_probes : light probes noisier than aimed at
    mean_step_ms : a frame's steps without rendering
    payload_bytes : sent
    mean_latency_ms, n_lost : of the estimates that arrive, and how many never did
    n_invalid_pixels, n_invalid_points, n_followed_anchors, n_unknown_lights, invalid : sums
    render_s, comparison_render_s, pilot_s : of captures and light probes, of compared pictures, of choosing samples
    overhead_share : work over rendering
    rmse_against_ambient : by method, its picture's error over that of the ambient light
    """

    n_frames: int
    n_active_frames: int
    n_compared_frames: int
    n_reused_captures: int = 0
    n_reused_probes: int = 0
    n_reused_comparisons: int = 0
    n_estimates: int
    fired_share: float | None
    mean_shc_rmse: float | None
    ambient_shc_rmse: float | None = None
    share_above_white: float | None = None
    n_capped_probes: int = 0
    mean_coverage: float | None
    mean_step_ms: float | None
    payload_bytes: int
    mean_latency_ms: float | None = None
    n_lost: int = 0
    n_invalid_pixels: int = 0
    n_invalid_points: int = 0
    n_followed_anchors: int = 0
    n_unknown_lights: int = 0
    invalid: InvalidCounts
    render_s: float
    comparison_render_s: float = 0.0
    overhead_share: float | None = None
    rmse_against_ambient: dict[str, float | None] = field(default_factory=dict)
    pilot_s: float = 0.0


@dataclass(frozen=True, kw_only=True)
class RunResults:
    """All of results.json.

    schema_version : of the file
    software : versions, and the `command` that was typed
    machine : platform, processor, cores, the device Cycles used
    settings, scene, effects, phone, summary : see there
    frames : one entry per frame of the path
    lights : by virtual object, what its world is keyed with wherever its light changes; empty for one that nothing
        lit, since no position was ever in view
    comparison : by method, the mean over compared frames. `truth` is the rendered light probe as an SH world, the whole
        light, whatever the target: the best that order 2 can do, not the path-traced picture it is compared with
    notes : what a reader has to know, in sentences
    """

    schema_version: Literal[1] = SCHEMA_VERSION
    software: dict[str, str]
    machine: dict[str, str | int | None]
    settings: RunSettings
    scene: SceneResult
    effects: tuple[EffectResult, ...]
    phone: PhoneResult
    frames: tuple[FrameResult, ...]
    lights: dict[str, tuple[LightChange, ...]]
    comparison: dict[str, Metrics]
    summary: Summary
    notes: tuple[str, ...] = ()

    @property
    def active_frames(self) -> list[FrameResult]:
        """Those that went through the chain."""
        return [frame for frame in self.frames if frame.active]

    @property
    def compared_frames(self) -> dict[int, ComparedFrame]:
        """Those with pictures, by number."""
        return {frame.frame: frame.compared for frame in self.frames if frame.compared is not None}

    @property
    def probes(self) -> list[ProbeResult]:
        """Of all frames."""
        return [probe for frame in self.frames for probe in frame.probes]

    def nearest_compared_frame(self, frame: int) -> int | None:
        """The compared frame next to `frame`, the earlier of two equally near; None if none was compared."""
        return min(self.compared_frames, key=lambda compared: (abs(compared - frame), compared), default=None)


def read_results(folder: Path) -> RunResults:
    """The results of the run in `folder`, read once and kept while the file is the same.

    UserError if there are none, or none that this version wrote.
    """
    file = folder / "results.json"
    try:
        return _read(file, file.stat().st_mtime_ns)
    except OSError as error:
        raise UserError(f"{file} cannot be read ({error.strerror}): run again") from error
    except (ValueError, TypeError) as error:
        raise UserError(f"{file} is not from a run of this version: run again") from error


@functools.lru_cache(maxsize=2)
def _read(file: Path, _changed_ns: int) -> RunResults:
    results = from_json(RunResults, read_json(file))
    if not results.lights:
        raise ValueError("nothing was lit")
    return results


if __name__ == "__main__":
    print(json.dumps(json_schema(RunResults), indent=1))
