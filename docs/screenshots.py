"""The README's picture of the panel, taken from the window of a real Blender.

    XIHE_BLENDER_WINDOW="blender" python docs/screenshots.py docs/panel.png

XIHE_BLENDER_WINDOW is a command that starts Blender with a window of 1600x1000 on some (virtual) screen, where
ImageMagick and xdotool are at hand; see addon_tests/real_blender/window. The run that is shown is made first, with the
bpy module of this Python (some minutes); `--run DIR` takes one that is there.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
SCENE = ROOT / "blend_scenes" / "living_room.blend"
WIDTH_PX = 1360
N_COLOURS = 256
N_REPEATS = 3

sys.path.insert(0, str(ROOT / "addon_tests" / "real_blender" / "window"))

from blender_window import run_in_window  # noqa: E402  where the driver is, is only known now


def make_run(folder: Path) -> None:
    """A quick run with pictures large enough to be looked at."""
    options = ["--size", "400x300", "--preset", "draft", "--samples", "16"]
    subprocess.run([sys.executable, "-m", "xihe_blender", "previs", SCENE, "--out", folder, *options], check=True)


def save_small(screenshot: Path, picture: Path) -> None:
    """Smaller, and in few colours, which flat panels do not miss: most are chosen for the comparison on the right."""
    with Image.open(screenshot) as image:
        height = round(image.height * WIDTH_PX / image.width)
        small = image.convert("RGB").resize((WIDTH_PX, height), Image.Resampling.LANCZOS)
    comparison = small.crop((round(0.62 * WIDTH_PX), round(0.22 * height), WIDTH_PX, round(0.69 * height)))
    sample = Image.new("RGB", (WIDTH_PX, height + N_REPEATS * comparison.height))
    sample.paste(small, (0, 0))
    for k in range(2 * N_REPEATS):
        sample.paste(comparison, (k % 2 * comparison.width, height + k // 2 * comparison.height))
    palette = sample.quantize(N_COLOURS, kmeans=2)
    small.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG).save(picture, optimize=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("picture", type=Path)
    parser.add_argument("--run", type=Path, help="folder of a finished run of living_room")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.run or Path(temporary) / "run"
        if options.run is None:
            make_run(folder)
        seen = run_in_window(
            "readme_picture", Path(temporary) / "window", blend=SCENE, run=folder.resolve(), size_px=(1600, 1000)
        )
        if seen.code != 0:
            sys.exit(f"Blender could not take the picture:\n{seen.console}")
        save_small(seen.out / "panel.png", options.picture)


if __name__ == "__main__":
    main()
