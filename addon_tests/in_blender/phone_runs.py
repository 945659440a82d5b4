"""The phone of a run without the run: the path is captured and effects are planned; things that stand in its way."""

from dataclasses import replace

import bpy
from previs_runs import SMALL
from tiny_scenes import box

from xihe_blender.capture.render import RenderSettings
from xihe_blender.capture.scanner import open_scanner
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.previs.phone_capture import PhoneCapture
from xihe_blender.previs.plan import plan_previs

IPAD = replace(SMALL, phone="ipad_pro_lidar")


def planned(scene, out, settings, exposure=1.0):
    """The phone of a run whose path has been captured, and the capture of its first frame."""
    plan = plan_previs(scene, settings)
    phone = PhoneCapture(scene, plan, RunOutputs(out, "untitled"), settings, exposure)
    with open_scanner(scene, RenderSettings((32, 24), samples=4, denoise=False)) as scanner:
        scanner.exposure = exposure
        phone.prepare(scanner)
        captured = []
        for frame in plan.frames:
            scanner.move_to(frame)
            captured.append(scanner.acquire_environment_scan())
            phone.keep(scanner, frame)
            phone.notice(captured[-1])
    phone.plan()
    return phone, captured[0]


def state(phone, name):
    return phone.effects[name].state


def principled(name, **inputs):
    made = bpy.data.materials.new(name)
    if made.node_tree is None:
        made.use_nodes = True
    shader = next(node for node in made.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    for key, value in inputs.items():
        shader.inputs[key.replace("_", " ")].default_value = value
    return made


def pane(scene, look):
    """A board between the phone and the room, turned, in the middle of the picture of frame 1."""
    item = box(scene, "Pane", (-0.7, -0.9, 1.28), (0.5, 0.02, 0.5), look)
    item.rotation_euler = (0, 0, 0.3)
    return item
