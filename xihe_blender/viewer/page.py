"""The viewer of a run: one HTML file in which its virtual objects stand in the captured pictures, live, in three.js.

What it shows is in it, three.js among it (three.min.js, made by `npm run viewer` in addon_tests/engines), and
the page asks for nothing else. Lights are those that `xihenet.light.platforms` gives three.js. Depth as captured hides
what is behind; shadows fall on the surfaces that the run found around its objects.
"""

from __future__ import annotations

import base64
import hashlib
import json
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from xihe_blender.errors import UserError
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.io.run_lights import light_with_reflections, panorama_of_change
from xihe_blender.io.run_results import FrameResult, RunResults
from xihe_blender.report.document import png_url
from xihe_blender.report.values import escape, mean
from xihenet.formats import format_bytes, format_count, format_number, format_percent, format_quantity
from xihenet.io.png import encode_png
from xihenet.io.recording import load_frame
from xihenet.light.environments import encode_hdr, laid_out
from xihenet.light.platforms import PLATFORMS, Y_UP, coefficients_for, convention_of, main_light_for, soft_light
from xihenet.records import ArrayF64, ObjectLight, RgbdFrame

_HERE = Path(__file__).parent
TURNED = np.block([[Y_UP, np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]])
"""(4, 4) from Blender's axes to those of three.js and glTF."""

NOTHING_MM = 65535
MOST_PICTURES = 250_000_000
"""Bytes of PNG. As text, with the depth, they are twice that, and Chromium reads no more than 537 million characters of
a page at once. Of 256x192 pixels it is some 1,500 frames, of 1920x1440 some 60."""

TITLES = {"truth": "the rendered light probe", "ambient": "the ambient light sensor"}


@dataclass(frozen=True, eq=False)
class ViewedObject:
    """A virtual object as the viewer takes it.

    Parameters
    ----------
    name : of the object
    glb : its shape and materials, where it is at one frame, Y up
    matrices : (4, 4) by which that is moved, Y up, metres; one for each frame of the viewer, or one for all
    middle, radius : of a ball around `glb`: there, and in metres
    """

    name: str
    glb: bytes
    matrices: Sequence[ArrayF64]
    middle: ArrayF64
    radius: float


def _base64(content: bytes) -> str:
    return base64.b64encode(content).decode()


@dataclass
class _Stored:
    """What several frames share, each once: its place by its content."""

    as_text: Callable[[bytes], str] = _base64
    contents: list[str] = field(default_factory=list)
    places: dict[bytes, int] = field(default_factory=dict)

    def place(self, content: bytes) -> int:
        if content not in self.places:
            self.places[content] = len(self.contents)
            self.contents.append(self.as_text(content))
        return self.places[content]


def viewed_frames(results: RunResults, outputs: RunOutputs) -> dict[int, RgbdFrame]:
    """What the phone saw, by frame; UserError where the run's captures are gone, none, or too many."""
    _check_can_be_opened(results, outputs)
    seen = {}
    for frame in results.captured_frames:
        capture = None if frame.rendering is None else frame.rendering.capture
        source = frame.frame if capture is None or capture.same_as is None else capture.same_as
        paths = [outputs.seen(frame.frame), outputs.seen(source), outputs.capture(source)]
        path = next((path for path in paths if path.exists()), None)
        if path is None:
            raise UserError(f"{outputs.capture(source)} is gone: run xihe previs again, and keep the folder work")
        try:
            seen[frame.frame] = load_frame(path)
        except (OSError, ValueError, KeyError) as error:
            raise UserError(f"{path} cannot be read ({error}): run xihe previs again") from error
    if not seen:
        raise UserError("the run has captured no frame: nothing can be shown")
    return seen


def _check_can_be_opened(results: RunResults, outputs: RunOutputs) -> None:
    """UserError where no browser would open a page with all pictures; before any frame is loaded."""
    kinds = [("captured", results.captured_frames), ("ground_truth", [one for one in results.frames if one.compared])]
    files = [outputs.picture(kind, frame.frame) for kind, frames in kinds for frame in frames]
    contents = (file.read_bytes() for file in files if file.is_file())
    # As in the page, those that are the same count once: where a phone stands still there are thousands.
    n_bytes = sum({hashlib.sha256(content).digest(): len(content) for content in contents}.values())
    if n_bytes > MOST_PICTURES:
        raise UserError(
            f"the pictures of {format_count(len(results.captured_frames), 'frame')} have {format_bytes(n_bytes, 2)}, "
            f"and browsers open a page with {format_bytes(MOST_PICTURES, 2)}: run again with fewer frames (--frames), "
            "or smaller pictures (--size)"
        )


def viewer_page(
    results: RunResults, outputs: RunOutputs, seen: Mapping[int, RgbdFrame], objects: Sequence[ViewedObject]
) -> str:
    """The page. `seen` as of `viewed_frames`, all of one size; `objects` have a matrix for each of them, or one."""
    pictures, depths, reflections = _Stored(png_url), _Stored(), _Stored()
    methods = _methods(results, outputs.folder, reflections)
    by_number = {frame.frame: frame for frame in results.frames}
    frames = [_frame(results, by_number[number], one, outputs, pictures, depths) for number, one in seen.items()]
    first = next(iter(seen.values()))
    content = {
        "size": [first.intrinsics.width, first.intrinsics.height],
        "frames": frames,
        "methods": methods,
        "objects": [_object(one) for one in objects],
        "pictures": pictures.contents,
        "depths": depths.contents,
        "reflections": reflections.contents,
        "exposure": results.settings.reference_exposure,
    }
    licence = (_HERE / "three.LICENSE.txt").read_text(encoding="utf-8")
    three = (_HERE / "three.min.js").read_text(encoding="utf-8")
    return Template((_HERE / "viewer.html").read_text(encoding="utf-8")).substitute(
        title=escape(Path(results.scene.file).stem),
        style=(_HERE / "viewer.css").read_text(encoding="utf-8"),
        # No name in a scene can end the script.
        data=json.dumps(content, allow_nan=False).replace("<", "\\u003c"),
        three=f"/*\nthree.js\n\n{licence}*/\n{three}".replace("</script", "<\\/script"),
        script=(_HERE / "viewer.js").read_text(encoding="utf-8"),
    )


def _object(one: ViewedObject) -> dict[str, Any]:
    same = all(np.allclose(matrix, one.matrices[0], atol=1e-6) for matrix in one.matrices)
    return {
        "name": one.name,
        "glb": _base64(one.glb),
        "matrices": [_by_column(matrix) for matrix in (one.matrices[:1] if same else one.matrices)],
        "middle": one.middle.tolist(),
        "radius": one.radius,
    }


def _by_column(matrix: ArrayF64) -> list[float]:
    return [round(float(value), 7) for value in np.asarray(matrix).T.ravel()]


def _frame(
    results: RunResults, frame: FrameResult, seen: RgbdFrame, outputs: RunOutputs, pictures: _Stored, depths: _Stored
) -> dict[str, Any]:
    depth_mm = np.nan_to_num(seen.plane_depth_m.astype(np.float64), nan=0.0, posinf=0.0) * 1000
    packed = zlib.compress(np.where(depth_mm < NOTHING_MM, np.rint(depth_mm), 0).astype("<u2").tobytes(), 9)
    k = seen.intrinsics
    compared = results.compared_frames.get(frame.frame)
    truth = None
    if compared is not None and "ground_truth" in compared.pictures:
        file = outputs.folder / compared.pictures["ground_truth"]
        truth = pictures.place(file.read_bytes()) if file.is_file() else None
    coverage, matrix = [probe.coverage for probe in frame.probes], _by_column(TURNED @ seen.world_from_camera)
    white_balance = np.ones(3) if seen.white_balance is None else seen.white_balance
    return {
        "frame": frame.frame,
        "time_s": frame.time_s,
        "captured": pictures.place(encode_png(seen.srgb_u8)),
        "truth": truth,
        "depth": depths.place(packed),
        "gain": (seen.exposure / results.settings.reference_exposure * white_balance).tolist(),
        "camera": {"matrix": matrix, "fx": k.fx, "fy": k.fy, "cx": k.cx, "cy": k.cy},
        "surfaces": _surfaces(results, frame.frame),
        "numbers": [["Sphere seen", format_percent(float(np.mean(coverage)), 2)]] if coverage else [],
        "by_method": _numbers(results, frame),
    }


def _surfaces(results: RunResults, number: int) -> dict[str, list[dict[str, Any]]]:
    """Those that were known in the last compared frame up to this one, or else in the first."""
    compared = results.compared_frames
    known = [frame for frame in compared if frame <= number] or sorted(compared)[:1]
    if not known:
        return {}
    return {
        name: [
            {
                "corners": [(Y_UP @ corner).round(6).tolist() for corner in np.array(one.outline_m)],
                "normal": (Y_UP @ np.array(one.normal)).round(6).tolist(),
            }
            for one in surfaces
        ]
        for name, surfaces in compared[max(known)].surfaces.items()
    }


def _numbers(results: RunResults, frame: FrameResult) -> dict[str, list[list[str]]]:
    """By method, name and value of each figure."""
    own, compared, found = results.settings.estimator, results.compared_frames.get(frame.frame), {}
    others, probes = results.settings.others, frame.probes
    errors = {own: mean(one.shc_rmse for one in probes), "ambient": mean(one.ambient_shc_rmse for one in probes)}
    errors |= {name: mean(one.others[name].shc_rmse for one in probes) for name in others}
    expected = mean(probe.expected_error for probe in probes)
    for name in dict.fromkeys([own, *others, *TITLES]):
        figures = []
        if (error := errors.get(name)) is not None:
            figures.append(["Error of the light (SHC RMSE)", format_number(error, 3)])
        if name == own and expected is not None:
            figures.append(["Expected error", format_number(expected, 3)])
        if compared is not None and name in compared.comparison:
            of_picture = compared.comparison[name]
            figures.append(["Error of the picture (RMSE)", format_number(of_picture.rmse, 3)])
            figures.append(["Likeness of the picture (SSIM)", format_number(of_picture.ssim, 3)])
        if name in results.summary.estimate_ms:
            time = format_quantity(results.summary.estimate_ms[name], "ms")
            figures.append(["Time of an estimate (median of the run)", time])
        found[name] = figures
    return found


# ------------------------------------------------------------------------------------------------------------ lights


def _methods(results: RunResults, folder: Path, reflections: _Stored) -> list[dict[str, Any]]:
    """The run's estimator, with all parts of its light, then the others, as spherical harmonics alone."""
    own, exposure = results.settings.estimator, results.settings.reference_exposure
    made: dict[str, list[dict[str, Any]]] = {}
    for name, changes in results.lights.items():
        made[name] = []
        for change in changes:
            light, panorama = light_with_reflections(change), panorama_of_change(change, folder, exposure)
            place = None if panorama is None else reflections.place(encode_hdr(laid_out(panorama, "+X")))
            has_lamp = change.reflections is not None and change.reflections.has_lamp
            made[name].append(_light(change.frame, light, place, has_lamp=has_lamp))
    listed = [{"name": own, "title": own, "lights": made}]
    for name in ("truth", "ambient", *results.settings.others):
        listed.append({"name": name, "title": TITLES.get(name, name), "lights": _by_object(results, name)})
    return listed


def _by_object(results: RunResults, method: str) -> dict[str, list[dict[str, Any]]]:
    """The mean light of each object's positions wherever it changes, as spherical harmonics."""
    lights: dict[str, list[dict[str, Any]]] = {name: [] for name in results.lights}
    exposure = results.settings.reference_exposure
    for frame in results.frames:
        of_objects: dict[str, list[ArrayF64]] = {}
        if method == "ambient" and frame.ambient_radiance is not None:
            grey = np.eye(9)[0][:, None] * np.array(frame.ambient_radiance) * exposure * np.sqrt(4 * np.pi)
            of_objects = {name: [grey] for name in lights}
        for probe in frame.probes:
            other = probe.others.get(method)
            sh = probe.sh_truth if method == "truth" else None if other is None else other.sh
            if sh is not None:
                of_objects.setdefault(probe.object, []).append(np.array(sh))
        for name, each in of_objects.items():
            entry = _light(frame.frame, ObjectLight(np.mean(each, axis=0)), None)
            before = lights.setdefault(name, [])
            if not before or before[-1]["sh"] != entry["sh"]:
                before.append(entry)
    return lights


def _light(frame: int, light: ObjectLight, reflections: int | None, *, has_lamp: bool = False) -> dict[str, Any]:
    """`has_lamp`: whether the picture that is reflected shows the key light, which then has no highlight beside it."""
    convention, three = convention_of("three"), PLATFORMS["three"]
    main = main_light_for(light, convention)
    return {
        "frame": frame,
        "sh": [round(float(value), 6) for value in coefficients_for(soft_light(light, three), convention)],
        "mainLight": None
        if main is None
        else {
            "direction": main.direction,
            "color": main.colour,
            "intensity": main.intensity,
            "angularRadius": float(np.radians(main.angular_diameter_deg / 2)),
        },
        "reflections": reflections,
        "hasLamp": has_lamp,
    }
