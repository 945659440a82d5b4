"""What a run had in the file while it was under way must not stay: after Undo, and in a file saved meanwhile."""

from __future__ import annotations


def register() -> None:
    pass


def unregister() -> None:
    pass
