"""`xihe estimate`: the light at places in one RGB-D frame from anywhere, without Blender.

Runs where bpy is not installed, so nothing here may import it. Positions are given and told in the world of the camera
file, as the user knows them; coefficients are in the project's own axes, +Z up, whatever that file's are.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from xihe_blender.cli.arguments import Position, adder, as_given, one_of, position
from xihe_blender.errors import UserError
from xihe_blender.io.outputs import finite_or_none, json_file, write_together
from xihenet import __version__, estimators
from xihenet.backend import LocalBackend, estimate_light
from xihenet.camera import behind_m, in_view, invalid_pixels, unproject_frame
from xihenet.estimators import EstimateContext, Estimator
from xihenet.invalid import CLAMPED, Counts, counted, format_reason, n_left_out
from xihenet.io.frame_files import FrameCamera, off_centre, read_camera, read_frame
from xihenet.io.picture_size import MOST_PIXELS
from xihenet.io.png import encode_png
from xihenet.light.light_picture import light_picture
from xihenet.records import LightEstimate, PointCloud, RgbdFrame
from xihenet.sampling import sample_unit_sphere
from xihenet.sh import dering_for_display
from xihenet.sphere import AnchorLattice

SCHEMA_VERSION = 1
MAX_ANCHORS = 65536
DEPTH_SCALE = 1e-3


@dataclass(frozen=True, eq=False)
class PlacedEstimate:
    """The light at one position, and how well the frame shows it.

    Parameters
    ----------
    position_m, light, invalid : where, what, and the points that gave nothing or were clamped
    is_in_view : whether it lies within the picture, in front of the camera
    behind_m : how far behind the surface that its pixel shows, along the optical axis; 0 where it is not, or only by
        as much as `xihenet.camera.BEHIND` allows
    """

    position_m: Position
    light: LightEstimate
    is_in_view: bool
    behind_m: float
    invalid: Counts


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = adder(parser)
    megapixels = f"{MOST_PIXELS // 10**6} megapixels at most"
    dering = (
        "for a light to look at: smooth each colour just enough that no direction is negative; changes half of the "
        "lights of lattice, and adds 5 to 7 percent to the error of all of the light"
    )
    out = "folder for estimate.json and a picture of each light: its panorama and three lit spheres"
    others = one_of(name for name in estimators.names() if name != "truth")
    add("frame FRAME", f"OpenEXR with colour and Z, or a colour image with --plane-depth; {megapixels}", Path)
    add("--camera FILE.json", "intrinsics and pose of the camera", Path, required=True)
    add("--at X,Y,Z", "position in metres; may be repeated", position, action="append", required=True)
    add("--plane-depth FILE", "16-bit image of distances along the optical axis; 0 or 65535: none", Path)
    add("--depth-scale METRES", "metres per unit of the 16-bit image; default: 0.001", float, default=DEPTH_SCALE)
    add("--exposure FACTOR", "exposure of the frame; default: metered for OpenEXR, 1 for images", float)
    add("--estimator NAME", others, default=estimators.DEFAULT)
    add("--target", "hdr: all of the light; ldr: light clipped at white", choices=("ldr", "hdr"), default="hdr")
    anchors = "number of directions in which light is gathered; default: 1280"
    add("--anchors N", anchors, int, default=1280)
    add("--dering", dering, action="store_true")
    add("--json", "print JSON and nothing else on stdout", action="store_true")
    add("--out DIR", out, Path)


def estimate_from_files(options: argparse.Namespace) -> tuple[RgbdFrame, dict[str, Any], list[PlacedEstimate]]:
    """The frame, what was read of it, and the light at every position.

    UserError, naming the fix, for files or options that will not do.
    """
    scale = options.depth_scale
    if options.plane_depth is None and scale != DEPTH_SCALE:
        raise UserError("--depth-scale is of the image of --plane-depth: an OpenEXR file has its distances in metres")
    try:
        estimator = _loaded(options)
        camera = read_camera(options.camera)
        frame = read_frame(
            options.frame, camera, plane_depth=options.plane_depth, depth_scale=scale, exposure=options.exposure
        )
    except (ValueError, ImportError) as error:
        raise UserError(str(error)) from error
    except OSError as error:
        raise UserError(f"cannot read {error.filename} ({error.strerror}): give a file that can be read") from error
    points, lattice = unproject_frame(frame), AnchorLattice(options.anchors)
    placed = [_estimate_at(p, frame, camera, points, estimator, lattice) for p in options.at]
    if options.dering:
        deringed = [replace(one.light, sh_radiance=dering_for_display(one.light.sh_radiance)) for one in placed]
        placed = [replace(one, light=light) for one, light in zip(placed, deringed, strict=True)]
    return frame, _frame_facts(frame, camera, 1.0 if options.plane_depth is None else scale), placed


def _frame_facts(frame: RgbdFrame, camera: FrameCamera, unit_m: float) -> dict[str, Any]:
    """What was read, for a user to see whether it is what was meant, where 1 was taken for `unit_m` metres."""
    seen = frame.plane_depth_m[frame.plane_depth_m > 0]
    given, used = camera.intrinsics, frame.intrinsics
    size, given_size = (used.width, used.height), (given.width, given.height)
    return {
        "size": size,
        "nearest_m": float(seen.min()),
        "farthest_m": float(seen.max()),
        "metres_per_unit": unit_m,
        "intrinsics_given_for": None if size == given_size else given_size,
        "invalid": invalid_pixels(frame),
    }


def _loaded(options: argparse.Namespace) -> Estimator:
    if options.estimator == "truth":
        raise UserError(
            "truth is a light probe rendered in Blender, which a single frame does not have: choose another --estimator"
        )
    if not 1 <= options.anchors <= MAX_ANCHORS:
        raise UserError(f"--anchors: expected 1 to {MAX_ANCHORS}, got {options.anchors}")
    return estimators.load(options.estimator, options.anchors, options.target)


def _estimate_at(
    position_m: Position, frame: RgbdFrame, camera: FrameCamera, points: PointCloud, estimator: Estimator,
    lattice: AnchorLattice,
) -> PlacedEstimate:  # fmt: skip
    in_blender_m = camera.blender_from_file @ position_m
    cloud = sample_unit_sphere(points, in_blender_m, lattice)
    context = EstimateContext(frame, points, in_blender_m, None, frame.exposure)
    light = estimate_light(LocalBackend(estimator), cloud, context, frame.exposure)
    is_in_view = bool(in_view([in_blender_m], frame.intrinsics, frame.world_from_camera)[0])
    behind = behind_m(in_blender_m, frame)
    clamped = {reason: n for reason, n in frame.invalid.items() if reason in CLAMPED}
    beyond = counted(distance_in_network=int(np.count_nonzero(cloud.distance_m > estimator.farthest_m)))
    return PlacedEstimate(position_m, light, is_in_view, behind, {**cloud.invalid, **clamped, **beyond})


def as_json(
    options: argparse.Namespace, exposure: float, facts: dict[str, Any], placed: list[PlacedEstimate]
) -> dict[str, Any]:
    """What `estimate.json` holds; every number is finite."""
    return {
        "schema_version": SCHEMA_VERSION,
        "software": {"xihe": __version__, "numpy": np.__version__},
        "estimator": options.estimator,
        "target": options.target,
        "exposure": exposure,
        "frame": facts,
        "n_anchors": options.anchors,
        "sh_axes": "right-handed, +Z up",
        "is_deringed": options.dering,
        "positions": [
            {
                "position_m": list(one.position_m),
                "coverage": one.light.coverage,
                "n_invalid_points": n_left_out(one.invalid),
                "invalid": dict(one.invalid),
                "in_view": one.is_in_view,
                "behind_m": one.behind_m,
                "is_valid": one.light.is_valid,
                "unknown_because": one.light.unknown_because or None,
                "expected_error": finite_or_none(one.light.expected_error),
                "sh_radiance": one.light.sh_radiance.tolist(),
            }
            for one in placed
        ],
    }


def as_table(facts: dict[str, Any], placed: list[PlacedEstimate]) -> str:
    """The same for a reader: what was read, then a line on how far to trust each position and its coefficients."""
    read = (
        "frame of {size[0]}x{size[1]} pixels, plane depth from {nearest_m:.4g} m to {farthest_m:.4g} m "
        "(1 in the file is {metres_per_unit:g} m)"
    )
    if facts["intrinsics_given_for"] is not None:
        read += "\nintrinsics given for {intrinsics_given_for[0]}x{intrinsics_given_for[1]} pixels, scaled to these"
    if facts["invalid"]:
        read += f"\npixels without a distance: {_format_reasons(facts['invalid'])}"
    return "\n\n".join([read.format_map(facts), *map(_position_table, placed)])


def _format_reasons(invalid: Counts) -> str:
    return "; ".join(f"{n} ({format_reason(reason)})" for reason, n in invalid.items())


def _position_table(one: PlacedEstimate) -> str:
    light = one.light
    facts = ["in view" if one.is_in_view else "not in view", f"{light.coverage:.0%} of the sphere seen"]
    if light.expected_error is not None:
        facts.append(f"expected error {light.expected_error:.3f}")
    if not light.is_valid:
        facts.append(f"the light cannot be known: {format_reason(light.unknown_because)}")
    rows = [f"{as_given(one.position_m)}: {', '.join(facts)}"]
    if one.invalid:
        rows.append(f"points left out or clamped: {_format_reasons(one.invalid)}")
    rows.append(" l  m      red    green     blue")
    bands = [(band, m) for band in range(3) for m in range(-band, band + 1)]
    for (band, m), (red, green, blue) in zip(bands, light.sh_radiance, strict=True):
        rows.append(f"{band:2d} {m:2d} {red:z8.4f} {green:z8.4f} {blue:z8.4f}")
    return "\n".join(rows)


def warnings_about(frame: RgbdFrame, placed: list[PlacedEstimate]) -> list[str]:
    """A line where the camera looks wrong, and one for each position whose light is a guess."""
    doubt = off_centre(frame.intrinsics)
    lines = [] if doubt is None else [doubt]
    for one in placed:
        where = as_given(one.position_m)
        if not one.light.is_valid:
            lines.append(f"the light at {where} cannot be known: {format_reason(one.light.unknown_because)}")
        elif not one.is_in_view:
            lines.append(f"{where} is not in the frame's view: its light is estimated from other surfaces")
        elif one.behind_m:
            lines.append(
                f"{where} lies {one.behind_m:.2g} m behind the surface seen there: its light is estimated from "
                "surfaces that may be hidden from it; is the position, or the unit of the plane depth, right?"
            )
    return lines


def write_estimates(folder: Path, content: dict[str, Any], placed: list[PlacedEstimate]) -> list[Path]:
    """Write `light_<i>.png` of every position and `estimate.json`: all of them, or none if one cannot be written.

    Their paths, the JSON's first. UserError if they cannot be written; files of an earlier estimate are replaced.
    """
    pictures = {f"light_{k}.png": encode_png(light_picture(one.light.sh_radiance)) for k, one in enumerate(placed)}
    try:
        # The JSON gets its name last: where it is, the pictures are.
        return write_together(folder, {"estimate.json": json_file(content), **pictures})
    except OSError as error:
        raise UserError(f"cannot write to {folder} ({error.strerror}): choose another folder for --out") from error


def run(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    frame, facts, placed = estimate_from_files(options)
    content = as_json(options, frame.exposure, facts, placed)
    written = [] if options.out is None else write_estimates(options.out, content, placed)
    for line in warnings_about(frame, placed):
        print(f"xihe: warning: {line}", file=stderr)
    if options.json:
        print(json_file(content).decode(), file=stdout, end="")
        return
    print(as_table(facts, placed), file=stdout)
    for path in written:
        print(path, file=stdout)
