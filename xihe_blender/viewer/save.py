"""Writing the viewer of a run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from xihe_blender.errors import UserError
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.io.run_results import RunResults
from xihe_blender.report.document import write_document
from xihe_blender.scene.blend_file import open_blend
from xihe_blender.viewer.gltf import viewed_objects
from xihe_blender.viewer.page import viewed_frames, viewer_page
from xihenet.formats import as_spelled


def save_viewer(
    results: RunResults, folder: Path, objects: Sequence[str] | None = None, *, blend: Path | None = None,
    out: Path | None = None,
) -> Path:  # fmt: skip
    """Write viewer.html of the run in `folder`, whole or not at all; its path.

    Opens `blend`, by default the lit file of the run, in place of what is open. `objects` None shows all that have a
    light. UserError, naming the fix, for what the run or the file does not have, and where nothing can be written.
    """
    outputs = RunOutputs(folder, Path(results.scene.file).stem)
    seen = viewed_frames(results, outputs)
    blend = outputs.lit_blend if blend is None else blend
    if not blend.is_file():
        raise UserError(f"there is no {blend}: name the .blend with the virtual objects by --from")
    scene = open_blend(blend)
    there = {item.name: item for item in scene.objects}
    wanted = list(results.lights) if objects is None else as_spelled(objects, there)
    lacking = [name for name in wanted if name not in there]
    if lacking or not wanted:
        named = f"no virtual object {lacking[0]!r}" if lacking else "no virtual objects"
        raise UserError(f"{blend} has {named}: name another .blend by --from")
    viewed = viewed_objects(scene, [there[name] for name in wanted], list(seen))
    path = (folder if out is None else out) / "viewer.html"
    try:
        write_document(path, viewer_page(results, outputs, seen, viewed))
    except OSError as error:
        raise UserError(f"cannot write {path} ({error.strerror}): choose another folder for --out") from error
    return path
