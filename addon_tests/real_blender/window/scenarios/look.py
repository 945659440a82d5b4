"""Nothing but a look: the tab as it is when a file is opened, with everything in it unfolded and what buttons say."""

import bpy


def scenario(w):
    yield from w.open_tab()
    w.facts["width"] = w.sidebar.width
    w.facts["language"] = bpy.context.preferences.view.language
    w.picture("tab")
    if hasattr(bpy.types, "XIHE_OT_run"):
        yield from w.find("xihe.run(")
        yield 1.2
        w.picture("run_hovered")
    w.facts["worlds"] = sorted(world.name for world in bpy.data.worlds)
    undefined = [node.name for tree in bpy.data.node_groups for node in tree.nodes if "Undefined" in node.bl_idname]
    w.facts["n_undefined_nodes"] = len(undefined)
