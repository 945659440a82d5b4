"""`xihe train` has its own command line, which needs torch and no Blender."""

from __future__ import annotations

from collections.abc import Sequence

from xihe_blender.errors import UserError


def train(arguments: Sequence[str]) -> int:
    """Run it with these; UserError without torch."""
    try:
        from xihenet.training.__main__ import main
    except ImportError as error:
        raise UserError("train: torch is not installed: pip install 'xihe-blender[train]'") from error
    return main(arguments)
