"""Notes on results, in sentences: how the numbers came about, what is wrong, what is missing."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import bpy

from xihe_blender.apply.datablocks import PREFIX
from xihe_blender.apply.reflection_pictures import is_shiny
from xihe_blender.io.run_results import Fault, FrameResult, ProbeResult, RecordingResult
from xihe_blender.previs.prepare import PreparedRun
from xihe_blender.previs.presets import PRESETS
from xihe_blender.previs.sample_count import SampleCount
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.previs.simulated_phone import SimulatedPhone
from xihe_blender.report.values import mean, too_small_to_judge
from xihe_blender.scene.colour_management import PLAIN_VIEWS
from xihe_blender.scene.shader_nodes import Interaction, light_emits, material_shading
from xihe_blender.scene.units import metres_per_unit
from xihenet.backend import NoAnswer
from xihenet.edge.client import EdgeBackend
from xihenet.formats import format_count, format_frames, format_list
from xihenet.invalid import format_reason

NEVER_SEEN = "No virtual object was in view of the camera in any frame: move the camera's path, or an object."

WORTH_TELLING = 0.1
"""Share of the light above white from which on a reader is told."""

FAINTEST = 1e-3
"""Light of less than this, at the session's exposure, is none: the first code above black is 3e-4."""

NEXT_TO_NOTHING, NEARLY_ALL = 1e-2, 0.9
"""Of white: at an exposure that the user chose, no more than the first is black, and pictures from the second on are
white."""


def notes_and_warnings(
    run: PreparedRun, frames: Sequence[FrameResult], phone: SimulatedPhone, recording: RecordingResult | None
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """All notes, and those that ask the reader to check or change something."""
    if recording is not None:
        warnings = recorded_warnings(run, frames)
        return (*recorded_notes(run, frames, recording), *warnings), tuple(warnings)
    unanswered, is_chosen = list(unanswered_notes(frames)), run.settings.exposure is not None
    unseen = unseen_notes(frames)
    faults = list(faults_seen(run.survey.faults, frames, math.prod(run.plan.size), is_chosen=is_chosen))
    faults += dim_notes(run.scene, run.settings, run.exposure, frames)
    exposed, small = list(exposure_notes(run.settings, run.exposure, frames)), list(small_notes(frames))
    notes = (
        *frame_notes(run.scene, frames),
        *unseen,
        *backend_notes(run),
        *unanswered,
        *light_notes(run.settings, run.plan.objects),
        *shadow_notes(frames),
        *shining_notes(run.plan.objects),
        *faults,
        *phone.notes(),
        *exposed,
        *noise_notes(run.settings, run.sample_count, frames),
        *white_notes(frames),
        *small,
    )
    return notes, (*unseen, *unanswered, *faults, *exposed, *small)


def unseen_notes(frames: Sequence[FrameResult]) -> list[str]:
    return [] if any(entry.active for entry in frames) else [NEVER_SEEN]


def recorded_warnings(run: PreparedRun, frames: Sequence[FrameResult]) -> list[str]:
    """Of a run on a recording, what asks the reader to check or change something."""
    return [*unseen_notes(frames), *unanswered_notes(frames), *(fault.said for fault in run.survey.faults)]


def recorded_notes(run: PreparedRun, frames: Sequence[FrameResult], recording: RecordingResult) -> Iterator[str]:
    """Of a run on a recording, of which nothing was rendered but the objects; without what is a warning."""
    yield recording.said
    yield from recording.notes
    yield from backend_notes(run)
    yield "Pictures are the recording's, with the virtual objects over them; how far those are right is not measured."
    if run.settings.has_key_light:
        yield "Objects are lit by the key light of each light as a sun, and by the rest as spherical harmonics."
        yield "Their shadows fall on the scan of the recording."
    if run.settings.has_reflections:
        yield "Glossy parts reflect what the phone saw of the room, and a guess where it saw nothing."
    yield from unknown_light_notes(frames)


def backend_notes(run: PreparedRun) -> Iterator[str]:
    """Which edge service estimated, and how it went."""
    backend: object = run.estimator
    if isinstance(backend, EdgeBackend):
        yield f"Estimates came from an edge service: {backend.state()}."
        yield "When they arrive is what --network says, or at once: the time that the service took does not count."


WITH_REFLECTIONS = "reflections (--light sh+key+reflections, or Estimator > Details > Light in the panel)"


def light_notes(settings: PrevisSettings, objects: Sequence[bpy.types.Object]) -> Iterator[str]:
    """What objects are lit with, and whether that is what they call for."""
    said = "`truth` is all the light of the rendered probe as order-2 spherical harmonics, not clipped"
    yield f"In the pictures, {said}{', and a rendered picture of what is reflected' * settings.has_reflections}."
    if settings.has_key_light:
        yield "Objects are lit by the key light of each light as a sun, and by the rest as spherical harmonics."
    shiny = ", ".join(item.name for item in objects if is_shiny(item))
    if settings.has_reflections:
        yield "Glossy parts reflect what the phone saw of the room, and a guess where it saw nothing."
        if not shiny:
            yield "No virtual object is shiny, so that the light looks the same without reflections."
    elif shiny:
        yield f"Shiny virtual objects: {shiny}. With {WITH_REFLECTIONS} they show the room that the phone saw."
    else:
        yield "No virtual object is shiny, so that none calls for reflections."
    taken, enough = (preset.comparison_samples for preset in (settings.preset_values, PRESETS["accurate"]))
    if shiny and taken < enough:
        yield (
            f"In a ground truth of {taken} samples, lamps that shiny objects mirror are noise, and the denoiser takes "
            f"some away: errors of pictures are off by that. The preset accurate takes {enough}."
        )


def shadow_notes(frames: Sequence[FrameResult]) -> Iterator[str]:
    """Whether the pictures have shadows on the room, and which objects have nothing to cast one on."""
    found: dict[str, bool] = {}
    for compared in [frame.compared for frame in frames if frame.compared is not None]:
        for name, surfaces in compared.surfaces.items():
            found[name] = found.get(name, False) or bool(surfaces)
    if not any(found.values()):
        yield "The shadow that a virtual object casts on the room is in the ground truth, not in the methods' pictures."
    else:
        yield "Objects cast their shadow on the flat surfaces that the phone has seen around them."
    in_the_air = [name for name, has_any in found.items() if not has_any]
    if in_the_air:
        them = ", ".join(in_the_air)
        yield f"The phone has seen nothing flat near {them}: in the air an object calls for no shadow on the room."


def shining_notes(objects: Sequence[bpy.types.Object]) -> Iterator[str]:
    """Which objects light the room around them, as a lamp does that is inserted."""
    shining = ", ".join(item.name for item in objects if _shines(item))
    if shining:
        yield (
            f"Virtual objects that shine: {shining}. Their light falls on the room in the ground truth, not in the "
            "methods' pictures."
        )


def _shines(item: bpy.types.Object) -> bool:
    if item.instance_type == "COLLECTION" and item.instance_collection is not None:
        return any(map(_shines, item.instance_collection.all_objects))
    if isinstance(item.data, bpy.types.Light):
        return light_emits(item.data)
    return any(material_shading(slot.material).interactions & Interaction.EMISSION for slot in item.material_slots)


def _shown_otherwise(scene: bpy.types.Scene) -> list[str]:
    """What the scene's colour management does to a picture besides encoding it."""
    view = scene.view_settings
    switched = {
        view.view_transform: view.view_transform not in PLAIN_VIEWS,
        "exposure": view.exposure != 0 or scene.cycles.film_exposure != 1,
        "gamma": view.gamma != 1,
        "look": view.look != "None",
        "curves": view.use_curve_mapping,
        "white balance": getattr(view, "use_white_balance", False),  # from Blender 4.3 on
    }
    return [name for name, is_on in switched.items() if is_on]


def frame_notes(scene: bpy.types.Scene, frames: Sequence[FrameResult]) -> Iterator[str]:
    """How the numbers came about, and which frames have none."""
    own = format_list(_shown_otherwise(scene))
    aside = f"the scene's own, {own}, would distort the comparison" if own else "as the scene has it"
    yield f"Pictures are made with the Standard view transform: {aside}."
    yield (
        "Image metrics count the pixels that virtual objects cover, by how much they cover; psnr and ssim on "
        "sRGB-encoded colour, the others on linear colour at the session's exposure."
    )
    metres = metres_per_unit(scene)
    if metres != 1:
        said = "as the scene's units say (Scene > Units); all lengths here are metres."
        yield f"One Blender unit is {metres:g} m, {said}"
    n_scenes = sum(other == scene or not other.name.startswith(PREFIX) for other in bpy.data.scenes)
    if n_scenes > 1:
        yield f"The file has {n_scenes} scenes; this is a run of {scene.name!r} alone."
    undelivered = sum(not entry.is_delivered for entry in frames)
    if undelivered:
        yield f"{undelivered} of {len(frames)} frames of the path follow too closely for the phone's frame rate."
    inactive = [entry for entry in frames if not entry.active and entry.is_delivered]
    if inactive:
        frames_were = ("1 frame", "was") if len(inactive) == 1 else (f"{len(inactive)} frames", "were")
        took = "not captured"
        if any(entry.captured for entry in inactive):
            took = f"captured for what the room shows there, in {sum(entry.render_s for entry in inactive):.0f} s"
        yield "{} had no estimation position in view and {} {}.".format(*frames_were, took)
    lost = sum(n for entry in frames for n in entry.n_lost_pixels.values())
    if lost:
        yield f"The phone's range sensor returned no distance for {lost} captured pixels; they count as far away."
    invalid = sum(entry.n_invalid_pixels for entry in frames) - lost
    if invalid > 0:
        clip = f"what lies beyond the camera's Clip End, {metres * scene.camera.data.clip_end:g} m"
        why = f"open sky, windows, fog, smoke, or {clip}"
        yield f"{invalid} captured pixels had no plane depth ({why}); they count as far away."
    yield from unknown_light_notes(frames)
    followed = [entry.frame for entry in frames if any(probe.n_followed_anchors for probe in entry.probes)]
    if followed:
        yield (
            f"At {format_frames(followed)} the light in view changed as a whole; directions out of view were scaled by "
            "the same factor, which is a guess."
        )
    yield from carried_light_notes(frames)


def carried_light_notes(frames: Sequence[FrameResult]) -> Iterator[str]:
    """When the light in use went on from its estimate, and how far."""
    gains = {entry.frame: [gain for one in entry.probes for gain in one.light_gain] for entry in frames}
    numbers = [frame for frame, of_frame in gains.items() if set(of_frame) - {1.0}]
    if numbers:
        least, most = (extreme(extreme(gains[frame]) for frame in numbers) for extreme in (min, max))
        yield (
            f"At {format_frames(numbers)} the light in view had changed since the estimate in use, which was "
            f"multiplied by the same factor, {least:.2f} to {most:.2f} by channel, until the next one arrived."
        )


def unknown_light_notes(frames: Sequence[FrameResult]) -> Iterator[str]:
    """A sentence for each position and reason why its light could not be known, and which light it kept."""
    kept: dict[tuple[str, str, int | None], list[int]] = {}
    for entry in frames:
        for probe in entry.probes:
            if not probe.is_valid:
                key = probe.name, probe.unknown_because or "", probe.light_frame
                kept.setdefault(key, []).append(entry.frame)
    for (name, reason, source), numbers in kept.items():
        instead = f"the light of frame {source} was kept"
        if source is None:
            instead = "the phone's ambient light was used instead"
        frames_where, why = format_frames(numbers), format_reason(reason)
        yield f"The light at {name} could not be known in {frames_where}, because {why}: {instead}."


def unanswered_notes(frames: Sequence[FrameResult]) -> Iterator[str]:
    """How often an edge service did not answer."""
    n = sum(probe.unknown_because == NoAnswer.reason for entry in frames for probe in entry.probes)
    if n:
        yield (
            f"The edge service did not answer {format_count(n, 'time')}: the light in use there is an older estimate "
            "or the phone's ambient light. Start xihe serve again, then run into a new folder."
        )


def faults_seen(
    faults: Sequence[Fault], frames: Sequence[FrameResult], n_pixels: int, *, is_chosen: bool
) -> Iterator[str]:
    """What is wrong with the scene: as the survey found it, and as frames of `n_pixels` that are dark or empty show.

    An exposure that the user chose, `is_chosen`, and that leaves only black says nothing of the scene's lamps.
    """
    judged = [] if is_chosen and _is_black(frames) else [entry for entry in frames if entry.active]
    active = [entry for entry in frames if entry.active]
    blind = [e for e in active if e.n_invalid_pixels - sum(e.n_lost_pixels.values()) == n_pixels]
    unlit = [e for e in judged if e not in blind and not _is_lit(e) and any(map(_is_probe_lit, e.probes))]
    dark = {p.name: None for e in judged if _is_lit(e) for p in e.probes if not _is_probe_lit(p)}
    unseen = [e for e in frames if e.compared and all(m.rmse is None for m in e.compared.comparison.values())]
    yield from (fault.said for fault in faults)
    if judged and not any(_is_lit(e) or any(map(_is_probe_lit, e.probes)) for e in judged):
        yield "Neither the phone nor a light probe saw any light: is every lamp off, or hidden in renders?"
    for name in dark:
        yield f"The light probe of {name!r} saw no light where the phone did: is it inside an object?"
    for entries, words in (
        (blind, "showed no surface at all: check the camera's clip range, and where it stands."),
        (unlit, "showed no light, but a light probe did: is the camera inside an object?"),
        (unseen, "showed nothing of a virtual object: the metrics are undefined there."),
    ):
        if entries:
            which = f"Frame {entries[0].frame}" if len(entries) == 1 else f"{len(entries)} frames"
            yield f"{which} {words}"


def dim_notes(
    scene: bpy.types.Scene, settings: PrevisSettings, exposure: float, frames: Sequence[FrameResult]
) -> Iterator[str]:
    """A sentence where lamps that light the picture up to white are below the light that Cycles samples at all.

    An exposure that the user chose says nothing of that; the mean light around the objects is white then.
    """
    threshold, white = scene.cycles.light_sampling_threshold, 1 / exposure
    if settings.exposure is not None:
        around = (_mean_around(probe, settings.target) for entry in frames for probe in entry.probes)
        white = max(around, default=0.0) / exposure
    if 0 < white <= threshold:
        yield (
            f"The scene is so dim that lamps fall below Cycles' light threshold of {threshold:.2g} and are sampled "
            "only at random: set Render > Sampling > Lights > Light Threshold to 0, or make the lamps brighter."
        )


def _mean_around(probe: ProbeResult, target: str) -> float:
    """The mean light around a light probe, at the session's exposure and not clipped; 0 without one."""
    if probe.sh_truth is None:
        return 0.0
    unclipped = 1.0 - (probe.share_above_white or 0.0) if target == "ldr" else 1.0
    return math.fsum(probe.sh_truth[0]) / 3 / math.sqrt(4 * math.pi) / max(unclipped, 1e-9)


def _light(entry: FrameResult) -> float:
    """Of a frame, the brightest channel, at its exposure."""
    return max((channel * (entry.exposure or 0) for channel in entry.ambient_radiance or ()), default=0.0)


def _probe_light(probe: ProbeResult) -> float:
    """The same of a light probe."""
    return max((abs(channel) for coefficient in probe.sh_truth or () for channel in coefficient), default=0.0)


def _is_lit(entry: FrameResult) -> bool:
    return _light(entry) > FAINTEST


def _is_probe_lit(probe: ProbeResult) -> bool:
    return _probe_light(probe) > FAINTEST


def _is_black(frames: Sequence[FrameResult]) -> bool:
    """Whether there is light, but next to none at the session's exposure."""
    lights = (light for entry in frames for light in (_light(entry), *map(_probe_light, entry.probes)))
    return 0 < max(lights, default=0.0) <= NEXT_TO_NOTHING


def exposure_notes(settings: PrevisSettings, exposure: float, frames: Sequence[FrameResult]) -> Iterator[str]:
    """A sentence where the room gave no light to meter, or where a chosen exposure leaves only black or white."""
    if settings.exposure is None:
        # No light to meter comes out as exactly 1, and light does not.
        if exposure == 1.0:
            yield "The path shows no light to meter the exposure by, so the exposure is 1. Set another with --exposure."
        return
    seen = [_light(entry) for entry in frames if entry.captured]
    chosen = f"At the chosen exposure of {exposure:g}"
    if _is_black(frames):
        yield f"{chosen} the phone saw next to nothing: choose a higher one, or leave it out."
    elif seen and min(seen) >= NEARLY_ALL:
        yield f"{chosen} the captures are white: choose a lower one, or leave it out."


def small_notes(frames: Sequence[FrameResult]) -> Iterator[str]:
    """A sentence where the pictures show too little of the virtual objects to judge the light by."""
    small = too_small_to_judge(mean_object_pixels(frames))
    if small is not None:
        yield f"{small[0].upper()}{small[1:]}: go nearer, or take larger pictures."


def mean_object_pixels(frames: Sequence[FrameResult]) -> float | None:
    """How many pixels virtual objects cover in compared frames; those that show none are left out, as of metrics."""
    return mean(frame.compared.object_pixels or None for frame in frames if frame.compared is not None)


def white_notes(frames: Sequence[FrameResult]) -> Iterator[str]:
    """A sentence where much of the light is lost to a picture that ends at white."""
    shares = [probe.share_above_white for entry in frames for probe in entry.probes]
    known = [share for share in shares if share is not None]
    if max(known, default=0.0) >= WORTH_TELLING:
        told = dict.fromkeys(f"{share:.0%}" for share in (min(known), max(known)))
        yield (
            f"Of the light at the objects, {' to '.join(told)} is brighter than white at this "
            "exposure or comes from lamps that cameras do not see: an estimate of it is a guess."
        )


def noise_notes(settings: PrevisSettings, sample_count: SampleCount, frames: Sequence[FrameResult]) -> Iterator[str]:
    """A sentence for each kind of render whose noise is above the target at the most samples the preset allows."""
    target, noise = settings.noise_aim, sample_count.capture_noise
    if noise is not None and noise > target:
        yield (
            f"The noise of captures is {noise:.1%} of the light, above the target of {target:.1%}: the preset stops at "
            f"{settings.preset_values.max_samples} samples."
        )
    probes = [probe for entry in frames if entry.rendering for probe in entry.rendering.probes.values()]
    capped = [probe.noise for probe in probes if probe.is_capped and probe.noise is not None]
    if capped:
        yield (
            f"{len(capped)} of {len(probes)} reference lights are noisier than their target "
            f"({settings.reference.noise_target:.2%} of the light), up to {max(capped):.1%}: the preset stops at "
            f"{settings.reference.max_samples} pictures."
        )
