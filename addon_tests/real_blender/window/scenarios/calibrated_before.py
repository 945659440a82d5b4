"""A Blender whose user has calibrated before: what the tab says of it in a file that is opened now."""

from calibrate import sentences_drawn

from xihe_blender.addon.planning_operators import calibration_line


def scenario(w):
    yield from w.open_tab()
    w.facts["said"] = calibration_line()
    w.facts["drawn"] = yield from sentences_drawn(w)
    yield from w.picture("calibrated_before")
    yield from w.find("xihe.calibrate(")
