"""The longest words that the tab can show: does any not fit at the width that the sidebar has by itself?"""

import bpy

from xihe_blender.addon import choices, planning_operators


def longest(items):
    return max(items, key=lambda item: len(item[1]))[0]


def scenario(w):
    w.area.spaces.active.shading.type = "SOLID"
    settings, job = bpy.context.scene.xihe, bpy.context.window_manager.xihe
    settings.phone = longest(choices.phone_items(None, None))
    settings.network = longest(choices.network_items(None, None))
    settings.estimator = longest(choices.estimator_items(None, None))
    settings.use_own_frames = True
    settings.run_folder = str(w.out / "gone")
    job.run_estimate, job.timed = "about 55 min", planning_operators.timed(bpy.context.scene)
    job.error = "virtual object 'A Vase with a Long Name' is also in collection 'Furniture': unlink it from there"
    yield from w.open_tab()
    yield 1
    yield from w.picture("long_words")
    job.is_running, job.progress, job.seconds_left = True, 0.07, 5100.0
    job.doing = "measuring how many samples it takes"
    w.area.tag_redraw()
    yield 2
    yield from w.picture("long_words_running")
    job.is_running = False
    yield 0.1
