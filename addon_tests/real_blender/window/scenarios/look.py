"""Nothing but a look: the tab as it is when a file is opened, and what Run says; without the add-on, the window."""

import bpy


def scenario(w):
    if hasattr(bpy.types.Scene, "xihe"):
        yield from w.open_tab()
        w.facts["width"] = w.sidebar.width
        yield from w.picture("tab")
        yield from w.find("xihe.run(")
        yield 1.2
    yield from w.picture("seen")
    w.facts["worlds"] = sorted(world.name for world in bpy.data.worlds)
    undefined = [node.name for tree in bpy.data.node_groups for node in tree.nodes if "Undefined" in node.bl_idname]
    w.facts["n_undefined_nodes"] = len(undefined)
    yield 0.1
