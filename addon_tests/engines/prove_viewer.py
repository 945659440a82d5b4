"""The viewer of a run: does it work in a browser, and does it show what Cycles shows?

    xihe previs blend_scenes/living_room.blend --out out/living_room --preset draft
    python addon_tests/engines/prove_viewer.py out/living_room out/viewer

Exports the viewer of the run, uses it in a headless Chromium at two sizes of screen, leaves screenshots in the folder,
and checks: no error, nothing asked for, all of the page in view, scrubbed, played, wiped. The live picture is held
against the run's own, which Cycles made under the same light: of the run's estimator and of the ambient light. Needs
what `prove.py` needs.
"""

from __future__ import annotations

import argparse
import base64
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from prove import browser_of_engines

from xihe_blender.cli.main import main as xihe
from xihe_blender.io.run_results import read_results
from xihenet.colour import linear_to_srgb, srgb_to_linear

HERE = Path(__file__).parent
MOST_BYTES = 15_000_000
MOST_OFF = {"ambient": 0.03}
"""Root mean square difference from Cycles' picture where the objects are, sRGB; of others, which have key light and
reflections, OTHERS: small mirrors differ from pixel to pixel."""

OTHERS = 0.1
CHANGED = 0.02


def picture(seen: dict[str, Any], size: tuple[int, int], *, at_centres: bool = False) -> np.ndarray:
    """(H, W, 3) of what the page drew, rows from the top: means over blocks of pixels, or what is in their middles."""
    width, height = seen["size"]
    rgba = np.frombuffer(base64.b64decode(seen["rgba"]), np.uint8).reshape(height, width, 4)[::-1, :, :3]
    blocks = rgba.reshape(size[1], height // size[1], size[0], width // size[0], 3)
    if at_centres:
        return blocks[:, blocks.shape[1] // 2, :, blocks.shape[3] // 2] / 255
    # Where a bright window ends in a pixel, that is as bright as its mean in linear light.
    return linear_to_srgb(srgb_to_linear(blocks / 255).mean(axis=(1, 3)))


def stored(path: Path) -> np.ndarray:
    image = bpy.data.images.load(str(path))
    values = np.empty(len(image.pixels), np.float32)
    image.colorspace_settings.name = "Non-Color"
    image.pixels.foreach_get(values)
    return values.reshape(image.size[1], image.size[0], -1)[::-1, :, :3]


def rms(difference: np.ndarray) -> float:
    return float(np.sqrt(np.mean(difference**2)))


def checked(run: Path, saw: dict[str, Any], page: Path) -> list[str]:
    """What is not as it should be."""
    size = tuple(read_results(run).settings.size)
    wrong = [f"the page said: {error}" for error in saw["errors"]]
    loaded = {url.split(":")[0] for url in saw["requests"]}
    wrong += [f"the page asked for something: {loaded}"] * bool(loaded - {"file", "data", "blob"})
    wrong += [f"{page} has {page.stat().st_size} bytes"] * (page.stat().st_size > MOST_BYTES)
    wrong += [f"{name}: the page is wider than the screen" for name in ("desk", "phone") if not saw[name]["wide"]]
    wrong += ["the line was not dragged to a quarter"] * (abs(saw["dragged"] - 0.25) > 0.01)
    is_keyed = saw["kept_frame"] and all(abs(place - saw["dragged"] - 0.06) < 0.01 for place in saw["keyed"])
    wrong += ["arrow keys did not move the line alone, or did not tell a screen reader"] * (not is_keyed)
    wrong += [f"{saw['filtered']} pictures were filtered again for the same frame"] * bool(saw["filtered"])
    wrong += ["the run was not played"] * (not saw["played"])
    frame = saw["truth"]["frame"]
    off = rms(picture(saw["truth"], size, at_centres=True) - stored(run / "pictures" / f"ground_truth_{frame:04d}.png"))
    wrong += [f"the ground truth is {off:.3f} off its picture"] * (off > 0.01)
    for name, seen in zip(saw["desk"]["methods"], saw["by_method"], strict=True):
        by_cycles = run / "pictures" / f"{name}_{frame:04d}.png"
        if name == "truth" or not by_cycles.exists():
            continue  # Cycles' picture of it has a key light and reflections; here it is spherical harmonics.
        true, captured = stored(by_cycles), stored(run / "pictures" / f"captured_{frame:04d}.png")
        inside = np.abs(true - captured).max(axis=-1) > CHANGED
        off = rms((picture(seen, size) - true)[inside])
        print(f"{name}: {off:.3f} off Cycles where the objects are, frame {frame}")
        wrong += [f"{name} is {off:.3f} off Cycles"] * (off > MOST_OFF.get(name, OTHERS))
    return wrong


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("out", type=Path)
    options = parser.parse_args()
    browser = browser_of_engines()
    if xihe(["export", str(options.run), "--to", "viewer", "--out", str(options.out)]) != 0:
        sys.exit(1)
    page = options.out / "viewer.html"
    command = ["node", HERE / "view.mjs", page.resolve(), options.out.resolve(), browser]
    saw = json.loads(subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout)
    print(f"{page.stat().st_size / 1e6:.1f} MB; {1000 / saw['frame_ms']:.0f} frames a second in software rendering")
    wrong = checked(options.run, saw, page)
    print("\n".join(wrong) or "all as it should be")
    sys.stdout.flush()
    os._exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
