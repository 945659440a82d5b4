"""Starts the Blender that XIHE_BLENDER names, as a user with a folder of their own would."""

import json
import os
import shlex
import subprocess
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = Path(__file__).resolve().parent / "scripts"
SCENE = ROOT / "blend_scenes" / "cornell_box.blend"
MODULE = "bl_ext.user_default.xihe"
SMALL = ("--preset", "draft", "--size", "32x24", "--frames", "1:13:6")
"""What docs/previs_in_blender.py does, as options."""
SMALLEST = ("--preset", "draft", "--size", "32x24", "--frames", "1", "--samples", "1", "--exposure", "1")
"""A run that goes through all its steps, for tests that ask whether it comes to its end."""


@dataclass(frozen=True)
class WholeBlender:
    """A Blender with `user` as the folder for everything that it keeps of its user.

    `wrapper` stands before the command: to take the network away, for example.
    """

    user: Path
    wrapper: tuple[str, ...] = ()

    def command(self, *arguments):
        return [*self.wrapper, *shlex.split(os.environ["XIHE_BLENDER"]), *map(str, arguments)]

    def run(self, *arguments, **options):
        """Start it and wait for its end; nothing is checked."""
        environment = {**os.environ, "BLENDER_USER_RESOURCES": str(self.user)}
        return subprocess.run(
            self.command(*arguments), env=environment, capture_output=True, text=True, timeout=200, **options
        )

    def xihe(self, *arguments, **options):
        """`blender --command xihe ...`."""
        return self.run("--command", "xihe", *arguments, **options)

    def extension(self, *arguments):
        """`blender --command extension ...`, which has to succeed."""
        done = self.run("--command", "extension", *arguments)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def install(self, zip_file):
        return self.extension("install-file", "--repo", "user_default", "--enable", zip_file)

    def background(self, *arguments):
        """`blender --background ...`, which has to succeed; scripts that fail make it fail."""
        done = self.run("--background", "--python-exit-code", "1", *arguments)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def facts(self, script, out, *arguments, start=()):
        """What one of the scripts in `scripts` notes: the JSON that it writes to the path it is given first."""
        self.background(*start, "--python", SCRIPTS / script, "--", out, *arguments)
        return json.loads(out.read_text())

    @property
    def site_packages(self):
        """Where this Blender has unpacked wheels."""
        return next((self.user / "extensions" / ".local" / "lib").glob("python*/site-packages"))
