"""What does a real phone make of a perfect capture? One file per effect, profiles as data, one chain.

`load_profile` names the device, `PhoneCamera` turns perfect frames into that device's, `arrival_frames` says when its
estimates come back, and `plan_phone` says which effects a session can show at all, from `facts_from_frames`.
"""

from xihenet.phone.called_for import EffectState, SessionFacts, calls_for_network, plan_phone
from xihenet.phone.camera_chain import PhoneCamera, PixelCounts, SessionTrack
from xihenet.phone.holes import SurfaceFacts
from xihenet.phone.motion import CameraMotion, motion_between
from xihenet.phone.network import LINKS, Link, arrival_frames, first_frame_after
from xihenet.phone.profile import EFFECTS, PhoneProfile, load_profile, profile_names
from xihenet.phone.session_facts import FrameFacts, facts_from_frames, facts_of_frame, facts_of_session
from xihenet.phone.under_way import EstimatesUnderWay, Request

__all__ = [
    "EFFECTS",
    "LINKS",
    "CameraMotion",
    "EffectState",
    "EstimatesUnderWay",
    "FrameFacts",
    "Link",
    "PhoneCamera",
    "PhoneProfile",
    "PixelCounts",
    "Request",
    "SessionFacts",
    "SessionTrack",
    "SurfaceFacts",
    "arrival_frames",
    "calls_for_network",
    "facts_from_frames",
    "facts_of_frame",
    "facts_of_session",
    "first_frame_after",
    "load_profile",
    "motion_between",
    "plan_phone",
    "profile_names",
]
