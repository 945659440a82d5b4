"""The Cycles device: what does Cycles render on where there is no window to choose it in?

Blender as a module starts with the factory's preferences, in which Cycles may use no graphics card. A whole Blender
starts with the user's, but a server has none. So a variable of the environment names the kind of device,
`--cycles-device` sets it, and processes that a command starts inherit it. In a window only the preferences count.
"""

from __future__ import annotations

import os
from typing import Any

import bpy

from xihe_blender.errors import UserError

DEVICE_VARIABLE = "XIHE_CYCLES_DEVICE"
CPU = "CPU"
CYCLES_IS_OFF = "Cycles is turned off in this Blender: turn on Cycles Render Engine in Preferences > Add-ons"


def choose_device(kind: str) -> list[str]:
    """Have this process and those that it starts render on a kind of device.

    Returns the names of the graphics cards, none for CPU. UserError as of `use_chosen_device`.
    """
    kind = kind.upper()
    use_device(kind)
    os.environ[DEVICE_VARIABLE] = kind
    return (
        [] if kind == CPU else [d.name for d in _preferences().get_devices_for_type(kind) if d.use and d.type == kind]
    )


def use_chosen_device(scene: bpy.types.Scene) -> None:
    """Let `scene` render on the kind of device that was chosen; nothing where none was.

    UserError where this machine has no such device, or this Blender does not know the kind.
    """
    kind = _chosen()
    if kind:
        use_device(kind)
        scene.cycles.device = CPU if kind == CPU else "GPU"


def use_device(kind: str) -> None:
    """Let Cycles use all devices of a kind, such as OPTIX, and no other, or those of it that the preferences name.

    UserError as of `use_chosen_device`.
    """
    if kind == CPU:
        return
    cycles = _preferences()
    if cycles is None:
        raise UserError(CYCLES_IS_OFF)
    if cycles.compute_device_type == kind and cycles.has_active_device():
        return
    cycles.refresh_devices()
    kinds = [known for known, *_ in cycles.get_device_types(bpy.context) if known != "NONE"]
    found = [CPU, *(known for known in kinds if any(d.type == known for d in cycles.get_devices_for_type(known)))]
    if kind not in found:
        raise UserError(
            f"--cycles-device or {DEVICE_VARIABLE}: Cycles finds no device of the kind {kind!r} on this machine: "
            f"choose one of {', '.join(found)}"
        )
    cycles.compute_device_type = kind
    for device in cycles.get_devices_for_type(kind):
        device.use = device.type == kind


def device_of(scene: bpy.types.Scene) -> str:
    """The kind of device that `scene` renders on, as was chosen or as the user's Blender is set up."""
    return _chosen() or (CPU if scene.cycles.device == CPU else device_in_preferences())


def device_in_preferences() -> str:
    """The kind of device that Cycles may use, as the user has set it in Blender's preferences."""
    cycles = _preferences()
    kind = "NONE" if cycles is None else str(cycles.compute_device_type)
    return CPU if kind == "NONE" else kind


def _chosen() -> str:
    return os.environ.get(DEVICE_VARIABLE, "").upper() if bpy.app.background else ""


def _preferences() -> Any:
    """Of Cycles; None where the user has turned it off."""
    addon = bpy.context.preferences.addons.get("cycles")
    return None if addon is None else addon.preferences
