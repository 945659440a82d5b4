"""NumPy 1, which Blender 4 has, makes integers of 32 bits on Windows where nothing else is asked for."""

from addon_tests.pure.commands import fresh_python
from addon_tests.pure.recordings import SMALL, walk
from xihenet import estimators
from xihenet.backend import LocalBackend
from xihenet.controller import XiheController

AS_ON_WINDOWS = """
import numpy as np

def narrow(make):
    def made(*given, dtype=None, **how):
        array = make(*given, **how) if dtype is None else make(*given, dtype=dtype, **how)
        return array.astype(np.int32) if dtype is None and array.dtype == np.int64 else array
    return made

np.arange, np.indices = narrow(np.arange), narrow(np.indices)

from addon_tests.pure.test_windows_integers import light_of_a_walk
print(light_of_a_walk().tobytes().hex())
"""


def light_of_a_walk():
    controller = XiheController(LocalBackend(estimators.load("lattice")))
    controller.add_position("Vase", (0.4, 0.3, -0.5))
    for frame in walk(SMALL, 2):
        controller.step(frame, active=["Vase"])
    return controller.light("Vase").sh_radiance


def test_the_light_is_the_same_with_integers_of_32_bits():
    assert fresh_python(AS_ON_WINDOWS).stdout.strip() == light_of_a_walk().tobytes().hex()
