"""What the extension puts into Blender, and takes away again. Imports nothing heavy: Blender's start waits for it."""

from __future__ import annotations

from xihe_blender.addon import command

MODULES = (command,)


def register(package: str) -> None:
    """Register all parts. `package` is the extension's own package, as Blender knows it."""
    for module in MODULES:
        module.register()


def unregister() -> None:
    """Take all parts away, in the opposite order."""
    for module in reversed(MODULES):
        module.unregister()
