"""The parts of the tab that are folded at first: effects with their reasons, and the details of path and estimator."""

import bpy


def prepare():
    try:
        from xihe_blender.addon import panels
    except ImportError:  # an installed add-on comes by its own way
        return
    for cls in panels.classes:
        if hasattr(cls, "bl_options"):
            cls.bl_options = set()


def scenario(w):
    yield from w.open_tab()
    w.area.spaces.active.shading.type = "SOLID"
    with w.context():
        w.facts["planned"] = sorted(bpy.ops.xihe.plan_effects())
    effects = bpy.context.scene.xihe.effects
    w.facts["effects"] = {row.name: row.state for row in effects}
    bpy.context.scene.xihe.active_effect = min(2, len(effects) - 1)
    bpy.context.scene.xihe.use_own_frames = True
    for row in effects:
        if row.name == "motion blur":
            row.override = "ON"
    for _ in range(3):
        # Panels unfold in steps, some of them only when drawn again.
        w.area.tag_redraw()
        yield 2
    yield from w.picture("unfolded")
