"""Which effects does a run simulate? Said in every result, so that nobody has to guess what a number includes."""

from __future__ import annotations

import bpy

from xihe_blender.render import RenderSettings, can_denoise, working_scene


def simulated_effects(scene: bpy.types.Scene) -> list[dict[str, str]]:
    """[{name, state "on" or "off", reason}] of a previs run on `scene`."""
    cycles = scene.cycles
    with working_scene(scene, "Xihe Effects", RenderSettings((4, 4), samples=1)) as working:
        denoises = can_denoise(working)
    has_depth_of_field = scene.camera is not None and scene.camera.data.dof.use_dof
    bounces = f"{cycles.max_bounces} in all, {cycles.diffuse_bounces} diffuse, {cycles.glossy_bounces} glossy"
    rows = [
        ("light bounces", True, f"as the scene has them: {bounces}"),
        ("indirect clamp", cycles.sample_clamp_indirect > 0, f"as the scene has it: {cycles.sample_clamp_indirect:g}"),
        ("denoising", denoises, "OpenImageDenoise" if denoises else "this build of Blender has no OpenImageDenoise"),
        ("depth of field", has_depth_of_field, "as the scene's camera has it"),
        ("motion blur", False, "frames are rendered as still pictures"),
        ("Fast GI", False, "it approximates bounces, and the ground truth must not"),
        ("8-bit clipping", True, "a phone delivers clipped, sRGB-encoded bytes"),
        ("auto exposure", False, "exposure is locked for the session"),
        ("sensor noise and range", False, "plane depth is the renderer's own"),
        ("network delay", False, "estimates are made in this process and arrive in their own frame"),
    ]
    return [{"name": name, "state": "on" if is_on else "off", "reason": reason} for name, is_on, reason in rows]
