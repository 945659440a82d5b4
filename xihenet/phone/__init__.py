"""The phone, and what it makes of a perfect capture: an effect's settings, rule and work in one file, profiles as data.

`load_profile` names the device, `PhoneCamera` turns perfect frames into that device's, `arrival_frames` says when its
estimates come back, and `PhoneProfile.required_effects` which effects a session shows, by `facts_of_session`.
"""

from xihenet.phone.camera_chain import PhoneCamera, SessionTrack
from xihenet.phone.depth_dropout import SurfaceFacts
from xihenet.phone.frame_facts import FrameFacts, facts_of_frame, facts_of_session
from xihenet.phone.motion import CameraMotion, motion_between
from xihenet.phone.network import LINKS, EstimatesUnderWay, Link, Request, arrival_frames
from xihenet.phone.profile import EFFECTS, NETWORK, PHONE_EFFECTS, PhoneProfile, load_profile, profile_names
from xihenet.phone.settings import SessionFacts

__all__ = [
    "EFFECTS", "LINKS", "NETWORK", "PHONE_EFFECTS", "CameraMotion", "EstimatesUnderWay", "FrameFacts", "Link",
    "PhoneCamera", "PhoneProfile", "Request", "SessionFacts", "SessionTrack", "SurfaceFacts", "arrival_frames",
    "facts_of_frame", "facts_of_session", "load_profile", "motion_between", "profile_names",
]  # fmt: skip
