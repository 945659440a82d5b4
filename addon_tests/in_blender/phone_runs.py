"""The phone of a small run, and things that stand in its way."""

import shutil
from dataclasses import replace

from effect_scenes import shader_look
from previs_runs import SMALL
from tiny_scenes import box

from xihe_blender.io.outputs import RunOutputs
from xihe_blender.jobs import run_blocking
from xihe_blender.previs.plan import plan_previs
from xihe_blender.previs.prepare import prepare_run
from xihe_blender.previs.run_chain import walk_path
from xihe_blender.previs.settings import load_estimator
from xihe_blender.previs.survey import survey_path
from xihenet.recording import load_frame

IPAD = replace(SMALL, phone="ipad_pro_lidar")


def kept(out):
    """Where a run keeps what it renders."""
    return RunOutputs(out, "untitled")


def planned(scene, out, settings):
    """The phone of a small run of few samples whose path has been walked, and the capture of its first frame.

    What an earlier run has left in `out` goes.
    """
    shutil.rmtree(out, ignore_errors=True)
    settings = replace(settings, size=(32, 24), samples=2, exposure=1.0)
    plan = plan_previs(scene, settings)
    survey, estimator = survey_path(scene, plan), load_estimator(settings)
    run = run_blocking(prepare_run(scene, plan, survey, kept(out), settings, estimator))
    phone = run_blocking(walk_path(run)).phone
    return phone, load_frame(kept(out).capture(plan.frames[0]))


def state(phone, name):
    return phone.effects[name].state


def principled(name, **inputs):
    return shader_look(name, "BsdfPrincipled", **inputs)


def pane(scene, look):
    """A board between the phone and the room, turned, in the middle of the picture of frame 1."""
    item = box(scene, "Pane", (-0.7, -0.9, 1.28), (0.5, 0.02, 0.5), look)
    item.rotation_euler = (0, 0, 0.3)
    return item
