"""Steps of a script in Blender's window, as an artist takes them: look, rest the mouse on something, click, press keys.

Runs inside a Blender with a window. A scenario is a generator: it acts, and yields the seconds to wait before it goes
on, during which Blender draws and handles what the mouse and the keys did. `play` drives it from a timer and ends
Blender: exit code 0 at its end, 1 after an error, with a picture of the window as it was then.

Where is a button? The mouse is moved over the sidebar, from the top down, and Blender itself is asked at each place
what is under the mouse: its operators "Copy Python Command" and "Copy Full Data Path" answer for the button that is
active. So places hold in every version, theme and language, whatever is drawn above the button. Rejected: places
measured on screenshots, which move with every label, and pictures of buttons to look for, which change with the theme.

Pictures are taken of the whole virtual screen with ImageMagick's `import`, mouse and keys are xdotool's.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import traceback
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any

import bpy

Steps = Generator[float, None, Any]

HOVER_S = 0.06
ROW_PX = 16
"""Less than the height of a button, so that none is missed."""
TABS_PX = 20
QUIET_S = 0.15
N_QUIET = 4
"""Times in a row that nothing is drawn within QUIET_S: then the window is still."""
N_SCROLLS = 2
"""Times that the sidebar is looked through, a good part of its height further down each time."""


class Window:
    """The one window of this Blender, its 3D view, the folder for pictures and facts, and a finished run to show."""

    def __init__(self, out: Path, run_folder: Path | None = None) -> None:
        self.out = out
        self.run_folder = run_folder
        self.facts: dict[str, Any] = {}
        self.found_at = 0
        self.places: dict[int, str] = {}
        self.window = bpy.context.window_manager.windows[0]
        self.n_drawn = 0
        for region in ("WINDOW", "UI"):
            bpy.types.SpaceView3D.draw_handler_add(self._count_drawn, (), region, "POST_PIXEL")
            bpy.types.SpaceImageEditor.draw_handler_add(self._count_drawn, (), region, "POST_PIXEL")

    def _count_drawn(self) -> None:
        self.n_drawn += 1

    @property
    def area(self) -> bpy.types.Area:
        return max((a for a in self.window.screen.areas if a.type == "VIEW_3D"), key=lambda a: a.width * a.height)

    @property
    def sidebar(self) -> bpy.types.Region:
        return next(region for region in self.area.regions if region.type == "UI")

    @contextlib.contextmanager
    def context(self, region: bpy.types.Region | None = None) -> Iterator[None]:
        """As if a script were run from `region`, the sidebar's if None."""
        with bpy.context.temp_override(window=self.window, area=self.area, region=region or self.sidebar):
            yield

    def picture(self, name: str) -> Steps:
        """A picture of the whole screen as it stays: once nothing was drawn for a while.

        Blender moves panels to their new places over some 0.3 s, and OpenGL in software takes as long for each of the
        draws in between. Nothing is asked to be drawn here: what the add-on forgets to redraw is old in the picture.
        """
        waited, n_quiet = 0.0, 0
        while n_quiet < N_QUIET:
            assert waited < 30, f"the window was drawn for 30 s before {name}"
            n_drawn = self.n_drawn
            yield QUIET_S
            waited += QUIET_S
            n_quiet = n_quiet + 1 if self.n_drawn == n_drawn else 0
        self.picture_now(name)

    def picture_now(self, name: str) -> Path:
        """A picture of the whole screen, whatever is moving."""
        path = self.out / f"{name}.png"
        subprocess.run(["import", "-window", "root", str(path)], check=True)
        return path

    def move(self, x: float, y: float) -> None:
        """The mouse, to a place in Blender's window, whose origin is its lower left corner."""
        _xdotool("mousemove", str(round(x)), str(round(self.window.height - 1 - y)))

    def sidebar_x(self, across: float) -> float:
        """Where in the window `across` of the sidebar's width is, its tabs left out."""
        return self.sidebar.x + across * (self.sidebar.width - TABS_PX)

    def click(self) -> None:
        _xdotool("click", "1")

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> Steps:
        """Such as the edge between two areas."""
        self.move(*start)
        yield 0.3
        _xdotool("mousedown", "1")
        yield 0.3
        for share in (0.3, 0.6, 1.0):
            self.move(*(a + share * (b - a) for a, b in zip(start, end, strict=True)))
            yield 0.2
        _xdotool("mouseup", "1")
        yield 0.3

    def press(self, key: str) -> None:
        """Such as "Escape" or "ctrl+z"; it goes to what is under the mouse."""
        _xdotool("key", key)

    def under_mouse(self) -> str:
        """What the button under the mouse in the sidebar does: "xihe.run()", "scenes[...].xihe.seed", or nothing."""
        clipboard = bpy.context.window_manager
        with self.context():
            command, path = bpy.ops.ui.copy_python_command_button, bpy.ops.ui.copy_data_path_button
            for ask, options in ((command, {}), (path, {"full_path": True})):
                clipboard.clipboard = ""
                if ask.poll() and ask(**options) == {"FINISHED"}:
                    return clipboard.clipboard.removeprefix("bpy.ops.").removeprefix("bpy.data.")
        return ""

    def find(self, wanted: str, *, across: float = 0.5) -> Steps:
        """Rest the mouse on the button whose command or data path holds `wanted`; `across` of the sidebar's width.

        Looks first where it was seen before, then near what was found last; where nothing was found yet, at every third
        row before those in between. The sidebar is scrolled down where that is not in view. AssertionError if it is not
        there, with what was found.
        """
        seen: list[str] = []
        for _ in range(N_SCROLLS):
            r = self.sidebar
            rows = list(range(r.y + r.height - 8, r.y, -ROW_PX))
            if self.found_at:
                rows.sort(key=lambda y: abs(y - self.found_at))
            else:
                rows = [*rows[::3], *rows[1::3], *rows[2::3]]
            for y in sorted(rows, key=lambda y: wanted not in self.places.get(y, "")):
                self.move(self.sidebar_x(across), y)
                yield HOVER_S
                here = self.places[y] = self.under_mouse()
                if wanted in here:
                    self.found_at = y
                    return
                if here and here not in seen:
                    seen.append(here)
            self.found_at = 0
            _xdotool("click", "--repeat", "8", "--delay", "30", "5")
            yield 1.0
        raise AssertionError(f"there is no {wanted!r} in the sidebar; there are {seen}")

    def click_on(self, wanted: str, *, across: float = 0.5) -> Steps:
        yield from self.find(wanted, across=across)
        self.click()
        yield 0.3

    def open_tab(self, name: str = "Xihe") -> Steps:
        """The sidebar with the tab `name`. Blender needs a moment before it knows its tabs."""
        self.area.spaces.active.show_region_ui = True
        yield 1.0
        self.sidebar.active_panel_category = name
        self.area.tag_redraw()
        yield 0.5

    def wait_until(self, is_true: Callable[[], bool], what: str, *, at_most_s: float = 120) -> Steps:
        waited = 0.0
        while not is_true():
            assert waited < at_most_s, f"waited {at_most_s:.0f} s for this: {what}"
            yield 0.1
            waited += 0.1


def _xdotool(*words: str) -> None:
    subprocess.run(["xdotool", *words], check=True)


def smooth_edges(are_smooth: bool) -> None:
    """They take almost half of the time of a draw in software, and only a picture for the documentation needs them."""
    system = bpy.context.preferences.system
    system.viewport_aa, system.use_overlay_smooth_wire = "8" if are_smooth else "OFF", are_smooth


def plain_shading() -> None:
    """Solid shading without lamps and highlights, in all 3D views: they take two thirds of a draw in software."""
    for screen in bpy.data.screens:
        for area in screen.areas:
            if area.type == "VIEW_3D":
                area.spaces.active.shading.light = "FLAT"


def play(scenario: Callable[[Window], Steps], out: Path, run_folder: Path | None = None) -> None:
    """Drive `scenario` from a timer; write its facts as facts.json into `out`; end Blender."""
    out.mkdir(parents=True, exist_ok=True)
    bpy.context.preferences.view.show_splash = False
    smooth_edges(False)
    plain_shading()
    window = Window(out, run_folder)
    steps = scenario(window)

    def tick() -> float | None:
        try:
            return next(steps)
        except StopIteration:
            _end(window, 0)
        except BaseException:
            traceback.print_exc()
            window.picture_now("failed")
            _end(window, 1)
            raise
        return None

    bpy.app.timers.register(tick, first_interval=1.5, persistent=True)


def _end(window: Window, code: int) -> None:
    """Ended hard: Blender's own way out has no exit code."""
    (window.out / "facts.json").write_text(json.dumps(window.facts, indent=1), encoding="utf-8")
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)
