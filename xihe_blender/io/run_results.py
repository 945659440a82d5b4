"""The results of a run: what results.json says, field by field, and how it is read back.

Strict JSON: no NaN and no Infinity, None where a value is undefined. Lengths are in metres, times in seconds unless a
name says `ms`. Coefficients are nine triples (R, G, B) of radiance SH in the order l*l + l + m, real and orthonormal,
axes as in Blender's world; they carry `settings.reference_exposure`, and dividing by it gives scene radiance.

docs/results.schema.json is made from these records (`python -m xihe_blender.io.run_results`). What a field holds stands
beside it. Nothing here needs NumPy or Blender, since the panel reads results too.
"""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Literal

from xihe_blender.errors import UserError
from xihe_blender.io.json_records import ABSENT, INLINE, Parameters, Plain, json_schema, read_record
from xihenet.light import BetweenEstimates, LightParts

SCHEMA_VERSION: Literal[1] = 1

Rgb = tuple[float, float, float]
Coefficients = tuple[Rgb, ...]
Counts = dict[str, int]
ByMethod = dict[str, float | None]


@dataclass(frozen=True, kw_only=True)
class Fault:
    """Something in the scene that cannot be lit or believed as it stands (docs/odd_scenes.md)."""

    name: Annotated[str, "of the data-block"]
    n: Annotated[int, "how often"]
    said: Annotated[str, "a sentence for the reader, also among the notes"]


@dataclass(frozen=True, kw_only=True)
class SceneResult:
    """The scene that was run."""

    file: Annotated[str, "of the scene"]
    name: Annotated[str, "of the scene"]
    camera: Annotated[str | None, "None for no camera"]
    fps: Annotated[float, "frames per second"]
    virtual_objects: Annotated[tuple[str, ...], "names, in the order of the results"]
    view_transform: Annotated[str, "the scene's own; pictures are made with Standard"]
    faults: Annotated[tuple[Fault, ...], "see there"] = ()
    unit_m: Annotated[float | None, "metres of a Blender unit; None in results of earlier versions"] = None


@dataclass(frozen=True, kw_only=True)
class EffectResult:
    """One thing that was or was not simulated: of light transport, the phone or the session."""

    name: Annotated[str, "of the effect"]
    state: Annotated[Literal["on", "off"], "whether it was simulated"]
    reason: Annotated[str, "why"]
    parameters: Annotated[Parameters, "what Cycles was set to, or the profile's numbers"] = field(default_factory=dict)
    origin: Annotated[Literal["auto", "user"], "who decided"] = "auto"


@dataclass(frozen=True, kw_only=True)
class PhoneErrors:
    """What the phone's effects do to the light: mean SHC RMSE over probes and frames."""

    all_on: Annotated[float | None, "with all of them"]
    perfect: Annotated[float | None, "with none"]
    without: Annotated[dict[str, float | None], "with all but one, by its name; None for the frame rate"]


@dataclass(frozen=True, kw_only=True)
class PhoneResult:
    """The phone of the run."""

    name: Annotated[str, "of its profile (docs/phone.md)"]
    summary: Annotated[str, "of its profile (docs/phone.md)"]
    shc_rmse: Annotated[PhoneErrors | None, "None where none of its effects is on"] = None


@dataclass(frozen=True, kw_only=True)
class SampleCounts:
    """Samples per pixel, and pictures of the light probe at most."""

    capture: Annotated[int, "of captures"]
    truth: Annotated[int, "of light probes"]
    comparison: Annotated[int, "of compared pictures"]


@dataclass(frozen=True, kw_only=True)
class NoiseLevels:
    """Relative noise; None where the number of samples was given."""

    capture: Annotated[float | None, "what captures have"]
    truth: Annotated[float | None, "what light probes aim at"]
    trigger: Annotated[float | None, "the change of colour that the trigger would see in noise alone"] = None


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """What was asked for, and what came of it."""

    estimator: Annotated[str, "as in the command line"]
    preset: Annotated[str, "as in the command line"]
    others: Annotated[tuple[str, ...], "other estimators that were compared with it"] = ()
    target: Annotated[Literal["ldr", "hdr"], "as in the command line"]
    light: Annotated[LightParts, "what objects are lit with"] = "sh"
    size: Annotated[tuple[int, int], "of captures and comparisons, width and height"]
    frames: Annotated[tuple[int, ...], "of the path"]
    captured: Annotated[Literal["path", "in-view"], "which of them the phone took in"] = "in-view"
    n_anchors: Annotated[int, "directions in which light is gathered around a position"]
    codec: Annotated[str, "format in which clouds are encoded"]
    seed: Annotated[int, "as in the command line"]
    phone: Annotated[str, "as in the command line"] = "perfect"
    network: Annotated[str | None, "as in the command line; None for none"] = None
    backend: Annotated[str | None, "address of the edge service that estimated; None for none"] = None
    effect_choices: Annotated[dict[str, str], "on or off by effect, where the user chose"] = field(default_factory=dict)
    reference_exposure: Annotated[float, "of the session; coefficients carry it"]
    metering: Annotated[str | None, "how it was found; None where it was given"] = None
    trigger: Annotated[dict[str, Plain], "numbers of the trigger, with noise added to theta"]
    following: Annotated[dict[str, Plain] | None, "numbers of light that follows; None where none does"] = None
    between_estimates: Annotated[BetweenEstimates, "as in the command line"] = "kept"
    samples: Annotated[SampleCounts, "see there"]
    noise_target: Annotated[float | None, "what was aimed at; None where the number of samples was given"] = None
    noise: Annotated[NoiseLevels, "see there"]
    truth_size: Annotated[tuple[int, int], "pixels of the light probe's pictures"]
    comparison_step: Annotated[int, "every so many-th active frame was compared"]
    comparison_view_transform: Annotated[str, "of the pictures"]
    error_map_full_scale: Annotated[float, "of the pictures"]

    @property
    def has_key_light(self) -> bool:
        """Whether objects have a sun beside their world."""
        return self.light != "sh"


@dataclass(frozen=True, kw_only=True)
class CaptureRender:
    """The render of one capture."""

    rendered: Annotated[bool, "for this frame"]
    same_as: Annotated[int | None, "the earlier frame whose pixels it would have had again; None where it was rendered"]
    samples: Annotated[int, "it has"]
    noise: Annotated[float | None, "expected at these, relative to the light; None where it was not measured"]


@dataclass(frozen=True, kw_only=True)
class ProbeRender(CaptureRender):
    """The render of one light probe (docs/reference_light.md)."""

    expected_error: Annotated[float | None, "the noise and what is not noise"] = None
    is_capped: Annotated[bool, "whether the preset's most samples left it above `settings.noise.truth`"] = False


@dataclass(frozen=True, kw_only=True)
class Rendering:
    """What was rendered for a frame."""

    capture: Annotated[CaptureRender, "what the phone would see"]
    probes: Annotated[dict[str, ProbeRender], "the light probe of each position in view, by its name"]


@dataclass(frozen=True, kw_only=True)
class OtherLight:
    """The light of another estimator, from the same clouds."""

    sh: Annotated[Coefficients, "the light in use"]
    shc_rmse: Annotated[float | None, "root mean square difference of `sh` from `sh_truth`; None without one"]


@dataclass(frozen=True, kw_only=True)
class ProbeResult:
    """One estimation position in one frame."""

    name: Annotated[str, "of the position"]
    object: Annotated[str, "the virtual object that it stands for"]
    position_m: Annotated[tuple[float, float, float], "world"]
    coverage: Annotated[float, "share of the anchors that are set"]
    fired: Annotated[bool, "whether an estimate was asked for"]
    reason: Annotated[Literal["first", "colour", "coverage", "light", "moved", "none"], "why an estimate was asked for"]
    change: Annotated[float | None, "what the trigger compared with `threshold`; None for `first`"]
    threshold: Annotated[float | None, "None where nothing was compared"]
    n_changed_anchors: Annotated[int, "above it"]
    n_invalid_points: Annotated[int, "points of this frame that were left out"] = 0
    invalid: Annotated[Counts, "these, and clamped distances (docs/invalid_data.md)"] = field(default_factory=dict)
    is_valid: Annotated[bool, "false where the light could not be known, so that the last one stays"] = True
    unknown_because: Annotated[str | None, "why, else None"] = None
    light_frame: Annotated[int | None, "whose estimate is in use; None for the ambient light"] = None
    n_followed_anchors: Annotated[int, "directions out of view that were changed as the light in view was"] = 0
    light_gain: Annotated[
        Rgb, "what that estimate is multiplied by, by channel, as the light in view has changed since its frame"
    ] = (1.0, 1.0, 1.0)
    payload_bytes: Annotated[int, "sent; 0 where nothing fired"]
    arrival_frame: Annotated[int | None, "first at or after the arrival; None also where the path ends before"] = None
    latency_ms: Annotated[float | None, "from trigger to arrival; None without an estimate or where it was lost"] = None
    sh: Annotated[Coefficients, "the light in use, the ambient one until a valid estimate has arrived"]
    sh_truth: Annotated[Coefficients | None, "the light probe's, for `settings.target`; None in a recording"]
    shc_rmse: Annotated[float | None, "root mean square difference of `sh` from it; None without one"]
    expected_error: Annotated[float | None, "that the estimator expects of `sh`; None if it says none"] = None
    ambient_shc_rmse: Annotated[float | None, "the same of the ambient light"] = None
    share_above_white: Annotated[
        float | None,
        "of the light what lies above white at the session's exposure or comes from lamps that cameras do not see; "
        "None without light",
    ] = None
    others: Annotated[dict[str, OtherLight], "by name of the other estimators"] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Metrics:
    """A method's picture against the ground truth; None where undefined."""

    psnr: Annotated[float | None, "dB"]
    ssim: Annotated[float | None, "structural similarity"]
    rmse: Annotated[float | None, "root mean square error"]
    si_rmse: Annotated[float | None, "root mean square error at the best common scale"]
    angular_deg: Annotated[float | None, "mean angle between colours"]
    ring_rmse: Annotated[float | None, "root mean square error around the objects, where their shadow falls"] = None


ERROR_AT_FULL_SCALE = 0.25
"""Difference of sRGB-encoded colour at which an error map reaches its brightest colour."""

METRICS = tuple(field.name for field in fields(Metrics))


@dataclass(frozen=True, kw_only=True)
class SurfaceResult:
    """A flat surface of the room that an object's shadow falls on, as the phone has seen it."""

    outline_m: Annotated[tuple[Rgb, ...], "its corners in order, world, metres"]
    normal: Annotated[Rgb, "unit, world, towards the object"]


@dataclass(frozen=True, kw_only=True)
class ComparedFrame:
    """The pictures of one frame, beside the ground truth."""

    pictures: Annotated[dict[str, str], "paths in the run's folder, by kind; `captured` is what the phone saw"]
    comparison: Annotated[dict[str, Metrics], "by method"]
    n_hueless_pixels: Annotated[Counts, "by method, black pixels that `angular_deg` leaves out"]
    object_pixels: Annotated[float | None, "the pixels that virtual objects cover, by how much they cover"] = None
    comparison_render_s: Annotated[float, "0 where it was taken over"]
    comparison_same_as: Annotated[int | None, "the frame that it was taken over from, or None"]
    surfaces: Annotated[dict[str, tuple[SurfaceResult, ...]], "by object, where its shadow falls"] = field(
        default_factory=dict
    )


@dataclass(frozen=True, kw_only=True)
class FrameResult:
    """One frame of the path. Not active where no position is in view, or it is not captured."""

    frame: Annotated[int, "its number"]
    time_s: Annotated[float, "when it is"]
    active: Annotated[bool, "whether a captured position is in view; else there is no estimate, and `probes` is empty"]
    captured: Annotated[bool, "whether the phone took it in"] = False
    is_delivered: Annotated[bool, "false where the phone is slower than the scene"] = True
    exposure: Annotated[float | None, "of the phone's frame"] = field(default=None, metadata=ABSENT)
    render_s: Annotated[float, "of capture and light probes"] = 0.0
    work_s: Annotated[float, "of all else"] = 0.0
    stage_ms: Annotated[dict[str, float], "by stage, summed over positions"] = field(default_factory=dict)
    others_ms: Annotated[dict[str, float], "by other estimator, of its estimates, summed over positions"] = field(
        default_factory=dict
    )
    ambient_radiance: Annotated[Rgb | None, "of the phone's light sensor"] = None
    n_invalid_pixels: Annotated[int, "without plane depth"] = 0
    n_lost_pixels: Annotated[Counts, "of these, what each effect of the phone took"] = field(default_factory=dict)
    invalid: Annotated[Counts, "pixels that gave no point or were clamped, by reason"] = field(default_factory=dict)
    probes: Annotated[tuple[ProbeResult, ...], "see there"] = ()
    rendering: Annotated[Rendering | None, "see there"] = field(default=None, metadata=ABSENT)
    composited: Annotated[dict[str, str], "pictures over a recording, by method: paths in the run's folder"] = field(
        default_factory=dict
    )
    compared: ComparedFrame | None = field(default=None, metadata=INLINE)  # its fields stand among these in the file


@dataclass(frozen=True, kw_only=True)
class RecordingResult:
    """The recording of a phone that was run in place of rendered captures, so that there is no ground truth."""

    name: Annotated[str, "of its folder"]
    format: Annotated[str, "as `xihe replay` names it"]
    source: Annotated[str, "where a Xihe session says that its frames come from, such as another format; or empty"] = ""
    said: Annotated[str, "a sentence for the reader, also among the notes"]
    notes: Annotated[tuple[str, ...], "what is assumed or not known of it, also among the notes"] = ()


@dataclass(frozen=True, kw_only=True)
class KeyLightResult:
    """The part of a light that casts a shadow: a disc of even radiance, far away."""

    direction: Annotated[tuple[float, float, float], "unit, world, towards the light"]
    irradiance: Annotated[Rgb, "on a surface that faces it, carrying `settings.reference_exposure`"]
    angular_radius: Annotated[float, "radians, from its middle to its rim"]
    is_seen: Annotated[bool, "whether the phone saw it; else it is what the estimate implies"]
    certainty: Annotated[float, "0 to 1, how large it is beside the error that the estimator expects of itself"] = 1.0


@dataclass(frozen=True, kw_only=True)
class ReflectionsResult:
    """What the glossy parts of an object reflect."""

    picture: Annotated[str, "a panorama in the run's folder, laid out as Blender reads one, scene radiance"]
    seen_share: Annotated[float, "of its directions the phone has seen, 0 to 1; the rest is a guess"]
    has_lamp: Annotated[bool, "of the key light; else its sun is reflected, as on rough objects"] = True


@dataclass(frozen=True, kw_only=True)
class LightChange:
    """From a frame on, an object's light."""

    frame: Annotated[int, "from which on"]
    sh: Annotated[Coefficients, "the mean over the object's positions, the key light among it"]
    key: Annotated[KeyLightResult | None, "None for no key light, and where `settings.light` has none"] = None
    reflections: Annotated[ReflectionsResult | None, "None where `settings.light` has none"] = None


@dataclass(frozen=True, kw_only=True)
class InvalidCounts:
    """What was left out or is undefined in a run, by reason (docs/invalid_data.md)."""

    pixels: Annotated[Counts, "in sums"]
    points: Annotated[Counts, "in sums"]
    lights: Annotated[Counts, "in sums"]
    metrics: Annotated[Counts, "without a value, by metric"]
    hues: Annotated[Counts, "black pixels, by method"]


@dataclass(frozen=True, kw_only=True)
class Summary:
    """The run in a few numbers; means over what is defined."""

    n_frames: Annotated[int, "of the path"]
    n_active_frames: Annotated[int, "of the path"]
    n_captured_frames: Annotated[int, "of the path, those out of view of all positions among them"] = 0
    n_compared_frames: Annotated[int, "of the path"]
    n_reused_captures: Annotated[int, "taken from an earlier frame"] = 0
    n_reused_probes: Annotated[int, "taken from an earlier frame"] = 0
    n_reused_comparisons: Annotated[int, "taken from an earlier frame"] = 0
    n_estimates: Annotated[int, "triggers"]
    fired_share: Annotated[float | None, "of triggers among all steps"]
    mean_shc_rmse: Annotated[float | None, "over positions and frames"]
    expected_error: Annotated[float | None, "over positions and frames"] = None
    ambient_shc_rmse: Annotated[float | None, "over positions and frames"] = None
    others_shc_rmse: Annotated[ByMethod, "of the other estimators, over positions and frames"] = field(
        default_factory=dict
    )
    share_above_white: Annotated[float | None, "over positions and frames"] = None
    n_capped_probes: Annotated[int, "light probes noisier than aimed at"] = 0
    mean_coverage: Annotated[float | None, "over positions and frames"]
    mean_step_ms: Annotated[float | None, "a frame's steps without rendering"]
    estimate_ms: Annotated[
        dict[str, float],
        "by estimator, of one estimate, median over frames; the chosen one makes those of a frame together",
    ] = field(default_factory=dict)
    payload_bytes: Annotated[int, "sent"]
    mean_latency_ms: Annotated[float | None, "of the estimates that arrive"] = None
    n_lost: Annotated[int, "estimates that never arrived"] = 0
    n_invalid_pixels: Annotated[int, "sum"] = 0
    n_invalid_points: Annotated[int, "sum"] = 0
    n_followed_anchors: Annotated[int, "sum"] = 0
    n_carried_lights: Annotated[int, "with a `light_gain`, over positions and frames"] = 0
    n_unknown_lights: Annotated[int, "sum"] = 0
    invalid: Annotated[InvalidCounts, "sums"]
    render_s: Annotated[float, "of captures and light probes"]
    comparison_render_s: Annotated[float, "of compared pictures"] = 0.0
    overhead_share: Annotated[float | None, "`work_s` of all frames over `render_s`"] = None
    object_pixels: Annotated[float | None, "that virtual objects cover, over compared frames that show any"] = None
    rmse_against_ambient: Annotated[ByMethod, "its error over that of the ambient light"] = field(default_factory=dict)
    pilot_s: Annotated[float, "of choosing samples"] = 0.0

    @property
    def all_render_s(self) -> float:
        """Of captures, light probes and compared pictures, and of choosing the samples."""
        return self.render_s + self.comparison_render_s + self.pilot_s


@dataclass(frozen=True, kw_only=True)
class RunResults:
    """All of results.json."""

    schema_version: Annotated[Literal[1], "of the file"] = SCHEMA_VERSION
    software: Annotated[dict[str, str], "versions, and the `command` that was typed"]
    machine: Annotated[dict[str, str | int | None], "platform, processor, cores, the device Cycles used"]
    settings: Annotated[RunSettings, "see there"]
    scene: Annotated[SceneResult, "see there"]
    effects: Annotated[tuple[EffectResult, ...], "see there"]
    phone: Annotated[PhoneResult, "see there"]
    frames: Annotated[tuple[FrameResult, ...], "one entry per frame of the path"]
    lights: Annotated[
        dict[str, tuple[LightChange, ...]],
        "by virtual object, what its world is keyed with wherever its light changes; empty for one that nothing lit, "
        "since no position was ever in view",
    ]
    comparison: Annotated[
        dict[str, Metrics],
        "by method, the mean over compared frames. `truth` is the rendered light probe as an SH world, the whole "
        "light, whatever the target: the best that order 2 can do, not the path-traced picture it is compared with",
    ]
    summary: Annotated[Summary, "see there"]
    notes: Annotated[tuple[str, ...], "what a reader has to know, in sentences"] = ()
    warnings: Annotated[tuple[str, ...], "those of the notes that ask to check or change something"] = ()
    recording: Annotated[RecordingResult | None, "see there; None where captures were rendered"] = None

    @property
    def active_frames(self) -> list[FrameResult]:
        """Those in which light was estimated, or could have been."""
        return [frame for frame in self.frames if frame.active]

    @property
    def captured_frames(self) -> list[FrameResult]:
        """Those that the phone took in, of results from before it took in more than active ones as well."""
        return [frame for frame in self.frames if frame.captured or frame.active]

    @property
    def compared_frames(self) -> dict[int, ComparedFrame]:
        """Those with pictures, by number."""
        return {frame.frame: frame.compared for frame in self.frames if frame.compared is not None}

    @property
    def network_in_use(self) -> str | None:
        """None also for one that the run left out."""
        left_out = any(effect.name == "network" and effect.state == "off" for effect in self.effects)
        return None if left_out else self.settings.network

    @property
    def probes(self) -> list[ProbeResult]:
        """Of all frames."""
        return [probe for frame in self.frames for probe in frame.probes]

    @property
    def light_errors(self) -> ByMethod:
        """Mean SHC RMSE by method: of the chosen estimator, the others and the ambient light."""
        chosen, summary = {self.settings.estimator: self.summary.mean_shc_rmse}, self.summary
        return {"ambient": summary.ambient_shc_rmse, **summary.others_shc_rmse, **chosen}

    @functools.cached_property
    def last_coverage(self) -> dict[str, float]:
        """Share of the sphere that was seen from each position, by its name, at the end of the run."""
        return {probe.name: probe.coverage for probe in self.probes}

    def nearest_compared_frame(self, frame: int) -> int | None:
        """The compared frame next to `frame`, the earlier of two equally near; None if none was compared."""
        return min(self.compared_frames, key=lambda compared: (abs(compared - frame), compared), default=None)


def read_results(folder: Path) -> RunResults:
    """The results of the run in `folder`, anew where the file changed; UserError if none that this version wrote."""
    file = folder / "results.json"
    try:
        results = _read(file, file.stat().st_mtime_ns)
    except OSError as error:
        raise UserError(f"{file} cannot be read ({error.strerror}): run again") from error
    if results is None:
        raise UserError(f"{file} is not from a run of this version: run again")
    return results


@functools.lru_cache(maxsize=4)
def _read(file: Path, _changed_ns: int) -> RunResults | None:
    """None for what no run of this version wrote: that is remembered as well."""
    try:
        results = read_record(RunResults, file)
    except (TypeError, ValueError):
        return None
    return results if results.lights else None


if __name__ == "__main__":
    print(json.dumps(json_schema(RunResults), indent=1))
