"""Profiles of phones, as data files: what each sensor does, with the source of every number.

A profile is a TOML file with a name, a summary, its metering (highlights where it says none) and one table for each
effect that the device has. Users add their own file and pass its path.
Chosen: tables named as the effects are, so that a plan, a profile and a report use one vocabulary.
Rejected: profiles in Python, which users could not add without touching the package.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from xihenet.effects import Requirement
from xihenet.io.json_files import named
from xihenet.phone.depth import DistanceNoise, EdgeBleeding, Quantisation, RangeLimits
from xihenet.phone.depth_dropout import DarkDropout, GlossyDropout, GrazingDropout, SpanDropout, TransparentDropout
from xihenet.phone.exposure import AutoExposure, FrameRate
from xihenet.phone.light_sensor import LightSensor
from xihenet.phone.metering import Metering, checked_metering
from xihenet.phone.motion import PoseDrift, RollingShutter
from xihenet.phone.network import Link
from xihenet.phone.settings import Section, SessionFacts, section_from_table

PROFILES_FOLDER = Path(__file__).parent / "profiles"

EFFECTS: Mapping[str, type[Section]] = {
    "frame_rate": FrameRate,
    "rolling_shutter": RollingShutter,
    "auto_exposure": AutoExposure,
    "edge_bleeding": EdgeBleeding,
    "noise": DistanceNoise,
    "range": RangeLimits,
    "quantisation": Quantisation,
    "dark_dropout": DarkDropout,
    "glossy_dropout": GlossyDropout,
    "transparent_dropout": TransparentDropout,
    "grazing_dropout": GrazingDropout,
    "span_dropout": SpanDropout,
    "pose_drift": PoseDrift,
    "light_sensor": LightSensor,
}
"""Every sensor effect and its settings, in the order in which they are shown."""

NETWORK = "network"
PHONE_EFFECTS = (*EFFECTS, NETWORK)  # of the phone and the session; the network belongs to no phone


@dataclass(frozen=True)
class PhoneProfile:
    """A device."""

    name: str
    summary: str
    sections: Mapping[str, Section]  # settings by the names of EFFECTS, of those that the device has
    metering: Metering = "highlights"  # of an exposure locked for the session or, with `auto_exposure`, of each frame

    def __post_init__(self) -> None:
        for key, text in (("name", self.name), ("summary", self.summary)):
            if not isinstance(text, str) or not text.strip():
                raise ValueError(f"{key}: expected some text, got {text!r}")
        try:
            checked_metering(self.metering)
        except ValueError as error:
            raise ValueError(f"metering: {error}") from None
        for effect, section in self.sections.items():
            if effect not in EFFECTS:
                raise ValueError(f"{effect}: there is no such effect; choose from {', '.join(EFFECTS)}")
            if not isinstance(section, EFFECTS[effect]):
                raise ValueError(f"{effect}: expected {EFFECTS[effect].__name__}, got {type(section).__name__}")
        ordered = {effect: self.sections[effect] for effect in EFFECTS if effect in self.sections}
        object.__setattr__(self, "sections", ordered)

    @property
    def effects(self) -> frozenset[str]:
        """The effects that the device has."""
        return frozenset(self.sections)

    def required_effects(self, facts: SessionFacts, link: Link | None = None) -> dict[str, Requirement]:
        """What a session of such `facts` over `link` requires of each of PHONE_EFFECTS; a lacking one is not."""
        lacking = dict.fromkeys(EFFECTS, f"{self.name} does not have it")
        lacking[NETWORK] = "the phone estimates by itself"
        sections: Mapping[str, Section | None] = {**self.sections, NETWORK: link}
        required = {name: Requirement(False, reason, {}, {}) for name, reason in lacking.items()}
        return required | {name: one.requirement(facts) for name, one in sections.items() if one is not None}


def profile_names() -> list[str]:
    return sorted(file.stem for file in PROFILES_FOLDER.glob("*.toml"))


def load_profile(name_or_path: str | Path) -> PhoneProfile:
    """A profile by its name, or from a user's TOML file; ValueError names file and key, or lists the names."""
    names = profile_names()
    path = PROFILES_FOLDER / f"{name_or_path}.toml" if str(name_or_path) in names else Path(name_or_path)
    if not path.is_file():
        if path.suffix.lower() == ".toml":
            raise ValueError(f"{path}: there is no such file")
        raise ValueError(
            f"there is no phone profile {str(name_or_path)!r}: choose one of {', '.join(names)}, "
            "or give the path of a .toml file"
        )
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except UnicodeDecodeError:
        raise ValueError(f"{path}: this is no TOML file, which is in UTF-8: save it in that encoding") from None
    except (OSError, ValueError) as error:
        raise ValueError(f"{path}: this is no TOML file ({error})") from None
    except RecursionError:
        raise ValueError(f"{path}: this is no TOML file (its brackets are nested too deeply)") from None
    with named(path):
        return _profile_from_tables(tables)


def _profile_from_tables(tables: dict[str, object]) -> PhoneProfile:
    texts = {key: tables.pop(key, None) for key in ("name", "summary")}
    metering = tables.pop("metering", "highlights")
    sections = {}
    for effect, table in tables.items():
        if effect not in EFFECTS:
            raise ValueError(f"[{effect}]: there is no such effect; choose from {', '.join(EFFECTS)}")
        try:
            sections[effect] = section_from_table(EFFECTS[effect], table)
        except ValueError as error:
            raise ValueError(f"[{effect}] {error}") from None
    return PhoneProfile(sections=sections, metering=metering, **texts)  # type: ignore[arg-type]
