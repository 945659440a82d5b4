"""Xihe's science: from RGB-D frames to spherical-harmonic light, in NumPy. Never imports Blender.

The public names can be imported from here. Each is looked up when it is asked for: `import xihenet` imports nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from xihenet import backend as backend
    from xihenet import buffers as buffers
    from xihenet import camera as camera
    from xihenet import codec as codec
    from xihenet import completeness as completeness
    from xihenet import controller as controller
    from xihenet import estimators as estimators
    from xihenet import metrics as metrics
    from xihenet import records as records
    from xihenet import sampling as sampling
    from xihenet import sh as sh
    from xihenet import sphere as sphere
    from xihenet import trigger as trigger
    from xihenet.backend import InferenceBackend as InferenceBackend
    from xihenet.backend import LocalBackend as LocalBackend
    from xihenet.buffers import merge as merge
    from xihenet.camera import project_points as project_points
    from xihenet.camera import unproject_frame as unproject_frame
    from xihenet.codec import decode_cloud as decode_cloud
    from xihenet.codec import encode_cloud as encode_cloud
    from xihenet.completeness import coverage as coverage
    from xihenet.completeness import joint_entropy as joint_entropy
    from xihenet.controller import ControllerSettings as ControllerSettings
    from xihenet.controller import XiheController as XiheController
    from xihenet.records import Intrinsics as Intrinsics
    from xihenet.records import LightEstimate as LightEstimate
    from xihenet.records import PointCloud as PointCloud
    from xihenet.records import RgbdFrame as RgbdFrame
    from xihenet.records import StepReport as StepReport
    from xihenet.records import TriggerDecision as TriggerDecision
    from xihenet.records import UnitSphereCloud as UnitSphereCloud
    from xihenet.sampling import sample_unit_sphere as sample_unit_sphere
    from xihenet.sphere import AnchorLattice as AnchorLattice
    from xihenet.trigger import TriggerSettings as TriggerSettings
    from xihenet.trigger import decide_trigger as decide_trigger

__version__ = "0.1.0"

_MODULES = {
    "backend": ("InferenceBackend", "LocalBackend"),
    "buffers": ("merge",),
    "camera": ("project_points", "unproject_frame"),
    "codec": ("decode_cloud", "encode_cloud"),
    "completeness": ("coverage", "joint_entropy"),
    "controller": ("ControllerSettings", "XiheController"),
    "estimators": (),
    "metrics": (),
    "records": (
        "Intrinsics", "LightEstimate", "PointCloud", "RgbdFrame", "StepReport", "TriggerDecision", "UnitSphereCloud",
    ),
    "sampling": ("sample_unit_sphere",),
    "sh": (),
    "sphere": ("AnchorLattice",),
    "trigger": ("TriggerSettings", "decide_trigger"),
}  # fmt: skip
"""Public modules, and what of them is offered here."""

__all__ = sorted({*_MODULES, *(name for names in _MODULES.values() for name in names)})


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return importlib.import_module(f"{__name__}.{name}")
    for module, names in _MODULES.items():
        if name in names:
            return getattr(importlib.import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
