"""The tab in Japanese, where the build has translations: labels of ours stay as they are, and nothing is in the way."""

import bpy


def scenario(w):
    view = bpy.context.preferences.view
    languages = [item.identifier for item in view.bl_rna.properties["language"].enum_items]
    w.facts["languages"] = languages
    try:
        view.language = "ja_JP"
    except TypeError:
        w.facts["language"] = None
        return
    view.use_translate_interface = view.use_translate_tooltips = view.use_translate_new_dataname = True
    yield from w.open_tab()
    w.facts["language"] = view.language
    yield from w.picture("tab")
    yield from w.click_on("xihe.add_sphere_rig", across=0.3)
    yield 0.5
    w.facts["virtual"] = len(bpy.data.collections["Xihe Virtual"].objects)
    yield from w.find("xihe.run(")
    yield 1.2
    yield from w.picture("run_hovered")
