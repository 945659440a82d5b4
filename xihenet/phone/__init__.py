"""What does a real phone make of a perfect capture? One file per effect, profiles as data, one chain.

`load_profile` names the device, `PhoneCamera` turns perfect frames into that device's, `arrival_frames` says when its
estimates come back, and `plan_phone` says which effects a session can show at all, from `facts_from_frames`.
"""

from xihenet.phone.called_for import EffectState, SessionFacts, plan_phone
from xihenet.phone.camera_chain import PhoneCamera, PixelCounts, SessionTrack
from xihenet.phone.holes import SurfaceFacts
from xihenet.phone.motion import CameraMotion, motion_between
from xihenet.phone.network import LINKS, Link, arrival_frames, first_frame_after
from xihenet.phone.profile import EFFECTS, PhoneProfile, load_profile, profile_names
from xihenet.phone.session_facts import facts_from_frames

__all__ = [
    "EFFECTS",
    "LINKS",
    "CameraMotion",
    "EffectState",
    "Link",
    "PhoneCamera",
    "PhoneProfile",
    "PixelCounts",
    "SessionFacts",
    "SessionTrack",
    "SurfaceFacts",
    "arrival_frames",
    "facts_from_frames",
    "first_frame_after",
    "load_profile",
    "motion_between",
    "plan_phone",
    "profile_names",
]
