"""Leaks through near surfaces: how frequent are they, and what do patches and facing do to them? Tables of the docs.

    python addon_tests/bench/leaks.py blend_scenes/living_room.blend ROOM.blend ...

Positions are those of `reference.py`; frames are six along the path, at 256x192 and at 128x96. A leak is a set anchor
below the position whose distance lies more than 10 % outside the range of 64 rays through its cell, where the camera
saw what at least half of them hit. Errors are SHC RMSE over the norm of the truth, the reference probe with a noise of
3 %.
"""

from __future__ import annotations

from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from given import given
from reference import positions_of

from xihe_blender.capture.reference_probe import ProbeSettings, open_reference_probe
from xihe_blender.capture.render import RenderSettings
from xihe_blender.capture.scanner import meter_exposure, open_scanner
from xihe_blender.io.blender_output import only_our_output
from xihe_blender.jobs import run_blocking
from xihe_blender.lab.rooms.views import RoomRays
from xihe_blender.scene.blend_file import open_blend
from xihenet import estimators
from xihenet.buffers import merge_in_sight
from xihenet.camera import in_view, unproject_frame
from xihenet.metrics import shc_rmse
from xihenet.records import UnitSphereCloud
from xihenet.sampling import sample_unit_sphere
from xihenet.sphere import AnchorLattice
from xihenet.training.rooms import frames_of

SIZES = ((256, 192), (128, 96))
N_FRAMES, N_RAYS = 6, 64
LATTICE = AnchorLattice(1280)
BELOW = np.flatnonzero(LATTICE.directions[:, 2] < 0)


def rays_of_cells() -> np.ndarray:
    """(BELOW, N_RAYS, 3) directions spread evenly over the cell of each anchor below the horizon."""
    directions = np.random.default_rng(0).normal(size=(4 * N_RAYS * LATTICE.n, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    order = np.argsort(LATTICE.nearest(directions), kind="stable")
    first = np.searchsorted(LATTICE.nearest(directions[order]), BELOW)
    return directions[order][first[:, None] + np.arange(N_RAYS)]


def observe(path: Path) -> dict[str, Any]:
    """Everything that needs Blender: frames, truth, and what the rays of each cell hit."""
    scene = open_blend(path)
    positions = positions_of(scene)
    frames = np.linspace(scene.frame_start, scene.frame_end, N_FRAMES).astype(int)
    exposure = run_blocking(meter_exposure(scene, frames.tolist()))
    seen: dict[str, Any] = {"positions_m": positions, "frames": frames, "exposure": exposure}
    for size in SIZES:
        seen |= _frames(scene, frames, exposure, size)
    with open_reference_probe(scene, positions, ProbeSettings(noise_target=0.03)) as probe:
        light = [probe.light_at(index, int(frames[0]), exposure).measured.ldr for index in range(len(positions))]
    seen["truth"] = np.array(light)
    return seen | _rays(scene, seen)


def _frames(scene: bpy.types.Scene, frames: np.ndarray, exposure: float, size: tuple[int, int]) -> dict[str, Any]:
    scans = []
    with open_scanner(scene, RenderSettings(size, 8, denoise=True)) as scanner:
        scanner.exposure = exposure
        for frame in frames:
            scanner.move_to(int(frame))
            scans.append(scanner.acquire_environment_scan())
    return {
        f"srgb_u8_{size[0]}": np.array([scan.srgb_u8 for scan in scans]),
        f"plane_depth_m_{size[0]}": np.array([scan.plane_depth_m for scan in scans]),
        f"intrinsics_{size[0]}": np.array(astuple(scans[0].intrinsics)),
        "world_from_camera": np.array([scan.world_from_camera for scan in scans]),
    }


def _rays(scene: bpy.types.Scene, seen: dict[str, Any]) -> dict[str, Any]:
    """Distances of the hits (P, BELOW, N_RAYS), NaN for misses; whether each frame's camera sees them (F, P, ...)."""
    directions, distance_m, is_seen = rays_of_cells().reshape(-1, 3), [], []
    with open_scanner(scene, RenderSettings(SIZES[0], 1)) as scanner:
        intrinsics, _ = scanner.move_to(int(seen["frames"][0]))
        rays = RoomRays.of(scanner.scene)
        for position in seen["positions_m"]:
            reach, _ = rays.cast(position, directions)
            reach[np.isinf(reach)] = np.nan
            points = position + reach[:, None] * directions
            distance_m.append(reach)
            for pose in seen["world_from_camera"]:
                visible = in_view(points, intrinsics, pose)
                towards = points[visible] - pose[:3, 3]
                lengths = np.linalg.norm(towards, axis=1)
                hits, _ = rays.cast(pose[:3, 3], towards / lengths[:, None])
                visible[visible] = np.abs(hits - lengths) < 0.002 * lengths
                is_seen.append(visible)
    shape = (len(distance_m), -1, len(BELOW), N_RAYS)
    distances, seen_by = np.array(distance_m).reshape(shape)[:, 0], np.array(is_seen).reshape(shape).swapaxes(0, 1)
    return {"ray_distance_m": distances, "is_seen": seen_by}


def are_leaks(cloud: UnitSphereCloud, ray_distance_m: np.ndarray, is_seen: np.ndarray) -> np.ndarray:
    """(BELOW,) which set anchors lie out of the range of their rays, of which the camera saw at least half."""
    distance_m = cloud.distance_m[BELOW]
    low = np.where(np.isnan(ray_distance_m), np.inf, ray_distance_m).min(axis=1)
    high = np.where(np.isnan(ray_distance_m), -np.inf, ray_distance_m).max(axis=1)
    is_outside = (distance_m < 0.9 * low) | (distance_m > 1.1 * high)
    return cloud.is_set[BELOW] & is_outside & (is_seen.mean(axis=1) >= 0.5)


def measure(seen: Any, size: int) -> tuple[list[float], dict[str, list[float]]]:
    """Leaks in per cent, as points and with patches; and the errors that one view has and six merged have.

    Errors are those of points, of patches, and of patches with the weights of their facing.
    """
    projection = estimators.load("projection")
    n_leaks, n_set = np.zeros(2), np.zeros(2)
    errors: dict[str, list[np.ndarray]] = {}
    merged: dict[int, list[UnitSphereCloud]] = {}

    def note(kind: str, position: int, clouds: list[UnitSphereCloud]) -> None:
        truth = seen["truth"][position]
        plain, patched = (replace(cloud, surfaces=None) for cloud in clouds)
        lights = [projection.estimate(cloud) for cloud in (plain, patched, clouds[1])]
        found = [shc_rmse(light, truth) / np.sqrt((truth**2).mean()) for light in lights]
        errors.setdefault(f"projection, {kind}", []).append(np.array(found))

    of_size = {name: seen[f"{name}_{size}"] for name in ("srgb_u8", "plane_depth_m", "intrinsics")}
    for k, frame in enumerate(frames_of({**seen, **of_size})):
        patches = unproject_frame(frame)
        points = replace(patches, grid=None)
        for i in np.flatnonzero(in_view(seen["positions_m"], frame.intrinsics, frame.world_from_camera)):
            clouds = [sample_unit_sphere(cloud, seen["positions_m"][i], LATTICE) for cloud in (points, patches)]
            n_set += [cloud.is_set[BELOW].sum() for cloud in clouds]
            n_leaks += [are_leaks(cloud, seen["ray_distance_m"][i], seen["is_seen"][k, i]).sum() for cloud in clouds]
            note("one view", i, clouds)
            before = merged.get(i, [UnitSphereCloud.empty(LATTICE.n)] * 2)
            merged[i] = [merge_in_sight(old, new) for old, new in zip(before, clouds, strict=True)]
    for i, clouds in merged.items():
        note("merged", i, clouds)
    return (100 * n_leaks / n_set).tolist(), {name: np.mean(found, axis=0).tolist() for name, found in errors.items()}


def main() -> None:
    lines = []
    for path in given(__doc__, "scenes+").scenes:
        seen = observe(path)
        for size in SIZES:
            leaks, errors = measure(seen, size[0])
            lines.append(f"| {path.stem} {size[0]}x{size[1]} | leaks, % | {leaks[0]:.1f} | {leaks[1]:.1f} | |")
            for name, found in errors.items():
                lines.append(f"| | {name} | " + " | ".join(f"{error:.3f}" for error in found) + " |")
    print("| scene | | points | patches | and facing |", "| --- | --- | --- | --- | --- |", *lines, sep="\n")


if __name__ == "__main__":
    with only_our_output():
        main()
