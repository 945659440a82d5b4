"""Made-up results of a run: complete as results.json has them, and changed where a test cares."""

from collections.abc import Iterable
from typing import Any

from xihe_blender.io.json_records import from_json
from xihe_blender.io.run_results import RunResults

LIGHT = [[0.5, 0.4, 0.3], *([0.0, 0.0, 0.0] for _ in range(8))]
SETTINGS = {
    "estimator": "projection", "preset": "draft", "target": "ldr", "size": [10, 10], "frames": [1, 2, 3, 5],
    "n_anchors": 1280, "codec": "uint8_float16_stripped", "seed": 0, "reference_exposure": 1.7,
    "trigger": {"theta": 0.6, "n_neighbours": 4, "policy": "split"},
    "samples": {"capture": 4, "truth": 16, "comparison": 16}, "noise": {"capture": None, "truth": None},
    "truth_size": [32, 32], "comparison_step": 6, "comparison_view_transform": "Standard",
    "error_map_full_scale": 0.25,
}  # fmt: skip
SCENE = {"file": "living_room.blend", "name": "Scene", "camera": "Phone", "fps": 30.0, "virtual_objects": ["Ball"],
         "view_transform": "Standard"}  # fmt: skip
SUMMARY = {
    "n_frames": 0, "n_active_frames": 0, "n_compared_frames": 0, "n_estimates": 0, "fired_share": None,
    "mean_shc_rmse": None, "mean_coverage": None, "mean_step_ms": None, "payload_bytes": 0, "render_s": 21.6,
    "invalid": {kind: {} for kind in ("pixels", "points", "lights", "metrics", "hues")},
}  # fmt: skip


def probe(name: str = "Ball", **changes: Any) -> dict[str, Any]:
    """One position, at which nothing was asked for."""
    at_rest = {"coverage": 0.5, "fired": False, "reason": "none", "change": None, "threshold": None}
    light = {"n_changed_anchors": 0, "payload_bytes": 0, "sh": LIGHT, "sh_truth": LIGHT, "shc_rmse": 0.1}
    return {"name": name, "object": name, "position_m": [0.3, -1.25, 0.8], **at_rest, **light, **changes}


def frame(number: int, *probes: dict[str, Any], **changes: Any) -> dict[str, Any]:
    """Active where it has a position."""
    return {"frame": number, "time_s": (number - 1) / 30, "active": bool(probes), "probes": list(probes), **changes}


def metrics(rmse: float | None = None, **changes: float | None) -> dict[str, float | None]:
    """Undefined where nothing is given."""
    return {**dict.fromkeys(("psnr", "ssim", "rmse", "si_rmse", "angular_deg")), "rmse": rmse, **changes}


def compared(pictures: Iterable[str], comparison: dict[str, Any] | None = None) -> dict[str, Any]:
    """What a frame has besides where it was compared, with pictures of these kinds that are nowhere."""
    return {
        "pictures": {kind: f"pictures/{kind}.png" for kind in pictures},
        "comparison": comparison or {},
        "n_hueless_pixels": {},
        "comparison_render_s": 1.0,
        "comparison_same_as": None,
    }


def content(frames: Iterable[dict[str, Any]] = (), **changes: Any) -> dict[str, Any]:
    """All of results.json; settings, scene and summary are changed in part, everything else as a whole."""
    whole = {
        "software": {"xihe": "0.1.0", "command": "xihe previs living_room.blend --out out --preset draft"},
        "machine": {"platform": "Linux-6.1-x86_64", "n_cores": 2},
        "effects": [],
        "phone": {"name": "Perfect", "summary": "no phone is like this"},
        "lights": {"Ball": []},
        "comparison": {},
    }
    parts = {"settings": SETTINGS, "scene": SCENE, "summary": SUMMARY}
    changed = {name: of_one | changes.pop(name, {}) for name, of_one in parts.items()}
    return {"schema_version": 1, "frames": list(frames), **whole, **changed, **changes}


def results(frames: Iterable[dict[str, Any]] = (), **changes: Any) -> RunResults:
    """The record of `content`."""
    return from_json(RunResults, content(frames, **changes))
