"""A recorded session: its frames go through the chain again with other settings, here or by other tools.

One OpenEXR file per frame in a folder, whole or absent, and a session.json that says what the numbers mean. Chosen over
one big file because a recording that is cut short is still a recording, and a run can resume on it. Of a frame:

    R, G, B      half, linear Rec.709, clipped at white: the bytes of the picture, decoded, and no other numbers
    Z            float, plane depth in metres, 0 where there is none, NaN where the colour is not to be used either
    confidence   half, 0, 1 or 2, where the sensor says one
    header       worldFromCamera, fx, fy, cx, cy, exposure, time, frame; ambient and whiteBalance where they are known;
                 invalid, what was left out before, as "reason count, reason count"

Paper: section 5, `XiheRecorder`; `EnvironmentScanner` is what a phone, a renderer or a recording can stand behind.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from xihenet.colour import LINEAR_OF_CODE, linear_to_srgb
from xihenet.invalid import Counts
from xihenet.io.exr import Attribute, exr_attributes, exr_sizes, read_stored_exr, write_exr
from xihenet.io.json_files import read_json
from xihenet.io.whole_files import written_whole
from xihenet.records import ArrayF64, ArrayU8, Intrinsics, RgbdFrame
from xihenet.trigger import TriggerSettings

SESSION_FILE, FORMAT, VERSION = "session.json", "xihe session", 1
FRAME_FILES = "frame_*.exr"
MOST_PLAIN_PIXELS = 320 * 240
"""Frames with no more, as depth sensors of phones have, are not compressed.

They are read in a fifth of the time, and half as large again.
"""

LIGHT_OF_BYTES = LINEAR_OF_CODE.astype(np.float16)
"""(256,): no two bytes have the same."""

LARGEST_HALF = 65504.0
INFINITE_HALF = 0x7C00  # Its bits; those of NaN, but for the sign, are more


class EnvironmentScanner(Protocol):
    """Whatever delivers frames."""

    def acquire_environment_scan(self) -> RgbdFrame: ...


def save_frame(path: Path, frame: RgbdFrame) -> None:
    """Write `frame` to `path` (.exr). OSError if it cannot be written; an older file then stays as it was.

    ValueError for a frame number that 32 bits do not hold.
    """
    channels: dict[str, Any] = dict(zip("RGB", np.moveaxis(LIGHT_OF_BYTES[frame.srgb_u8], 2, 0), strict=True))
    channels["Z"] = frame.plane_depth_m
    if frame.confidence is not None:
        channels["confidence"] = frame.confidence.astype(np.float16)
    if not -(2**31) <= frame.frame < 2**31:
        raise ValueError(f"save_frame: expected a frame number of 32 bits, got {frame.frame}")
    k = frame.intrinsics
    header: dict[str, Attribute] = {"worldFromCamera": frame.world_from_camera}
    header |= {"fx": float(k.fx), "fy": float(k.fy), "cx": float(k.cx), "cy": float(k.cy)}
    header |= {"exposure": frame.exposure, "time": float(frame.time_s), "frame": int(frame.frame)}
    if frame.ambient is not None:
        header["ambient"] = frame.ambient
    if frame.white_balance is not None:
        header["whiteBalance"] = frame.white_balance
    if frame.invalid:
        header["invalid"] = ", ".join(f"{reason} {n}" for reason, n in frame.invalid.items())
    compression = "none" if frame.plane_depth_m.size <= MOST_PLAIN_PIXELS else "ZIP"
    with written_whole(path) as beside:
        write_exr(beside, channels, compression=compression, attributes=header)


def load_frame(path: Path) -> RgbdFrame:
    """Read what `save_frame` wrote. ValueError naming the file if it is no such file, OSError if it cannot be read."""
    try:
        said, channels = read_stored_exr(path)
        header = _header(said, channels["Z"].shape)
        srgb_u8 = np.stack([_bytes_of_light(channels[name]) for name in "RGB"], axis=-1)
        confidence = _confidence_of(channels["confidence"]) if "confidence" in channels else None
        plane_depth_m = channels["Z"].astype(np.float32, copy=False)
        return RgbdFrame(srgb_u8, plane_depth_m, confidence=confidence, **vars(header))
    except (LookupError, ValueError, OverflowError) as error:
        raise _no_frame(path, error) from None


@dataclass(frozen=True, eq=False)
class FrameHeader:
    """What is known of a recorded frame before its pixels are read; the fields are those of `RgbdFrame`."""

    intrinsics: Intrinsics
    world_from_camera: ArrayF64
    exposure: float
    ambient: ArrayF64 | None
    time_s: float
    frame: int
    invalid: Counts
    white_balance: ArrayF64 | None


def read_header(path: Path) -> FrameHeader:
    """Of a recorded frame; raises as `load_frame`."""
    try:
        return _header(exr_attributes(path), exr_sizes(path)["Z"])
    except (LookupError, ValueError, OverflowError) as error:
        raise _no_frame(path, error) from None


def _no_frame(path: Path, error: Exception) -> ValueError:
    reason = str(error).removeprefix(f"{path}: ")
    return ValueError(f"{path}: not a recorded frame ({reason})")


def _header(said: Mapping[str, Attribute], size: tuple[int, ...]) -> FrameHeader:
    height, width = size
    return FrameHeader(
        Intrinsics(width, height, *(_number(said, name) for name in ("fx", "fy", "cx", "cy"))),
        _finite(said["worldFromCamera"], "worldFromCamera"),
        _number(said, "exposure"),
        _finite(said["ambient"], "ambient") if "ambient" in said else None,
        _number(said, "time"),
        int(_number(said, "frame")),
        _counts(str(said.get("invalid", ""))),
        _finite(said["whiteBalance"], "whiteBalance") if "whiteBalance" in said else None,
    )


def _number(said: Mapping[str, Attribute], name: str) -> float:
    value = said[name]
    if not isinstance(value, int | float) or not np.isfinite(value):
        raise ValueError(f"{name}: expected a finite number, got {value!r:.80}")
    return float(value)


def _finite(value: Attribute, name: str) -> ArrayF64:
    if not isinstance(value, np.ndarray) or not np.isfinite(value).all():
        raise ValueError(f"{name}: expected finite numbers, got {value!r:.80}")
    return value


def _counts(text: str) -> dict[str, int]:
    """By reason; ValueError for what is no count of 1 or more."""
    counts = {}
    for entry in filter(None, text.split(", ")):
        reason, _, n = entry.rpartition(" ")
        counts[reason] = int(n)
        if counts[reason] < 1 or not reason:
            raise ValueError(f"invalid: expected reasons with counts of 1 or more, got {entry!r:.80}")
    return counts


@functools.cache
def _bytes_of_halves() -> NDArray[np.uint8]:
    """(65536,) the nearest byte by the bits of a half; what is below 0 is black, and 255 above white or infinite."""
    with np.errstate(invalid="ignore"):  # NaN, of which there are two thousand
        light = np.arange(2**16, dtype=np.uint16).view(np.float16).astype(np.float64)
    bytes_of: NDArray[np.uint8] = np.rint(linear_to_srgb(np.nan_to_num(light, posinf=1.0).clip(0, 1)) * 255)
    return bytes_of.astype(np.uint8)


def _bytes_of_light(light: NDArray[Any]) -> ArrayU8:
    """(H, W) uint8 sRGB of linear light in any float type. ValueError for NaN."""
    if light.dtype != np.float16:
        light = light.astype(np.float32).clip(-LARGEST_HALF, LARGEST_HALF).astype(np.float16)
    bits = light.view(np.uint16)
    if (bits & 0x7FFF).max() > INFINITE_HALF:
        raise ValueError("a colour is NaN")
    return np.asarray(_bytes_of_halves().take(bits))


def _confidence_of(stored: NDArray[Any]) -> ArrayU8:
    """(H, W) uint8. ValueError for what no byte holds."""
    if not ((stored >= 0) & (stored <= 255)).all():
        raise ValueError("confidence: expected 0, 1 or 2, got a negative or larger number, or NaN")
    return stored.astype(np.uint8)


@dataclass(frozen=True)
class SessionFacts:
    """What session.json says beside the frames.

    Parameters
    ----------
    source : where the frames come from, in words
    not_known : what the source does not say, in sentences
    reference_exposure : that light carries; None takes that of the first frame
    trigger : with which the session was run first; None where it was not
    files : names of the frames' files in order; empty takes all frame_*.exr, by name
    """

    source: str = ""
    not_known: tuple[str, ...] = ()
    reference_exposure: float | None = None
    trigger: TriggerSettings | None = None
    files: tuple[str, ...] = ()


def session_as_json(facts: SessionFacts) -> dict[str, Any]:
    """The content of session.json."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "source": facts.source,
        "world": "right-handed, +Z up, metres; the origin is the source's",
        "camera": "worldFromCamera: rows of a 4x4, applied to columns; the camera looks along -Z, +Y is up",
        "pixels": "fx, fy, cx, cy in pixels of this file, pixel centres at +0.5, row 0 is the top",
        "colour": "R, G, B: linear Rec.709 times exposure and whiteBalance, clipped at 1, of 8 bits in sRGB",
        "depth": "Z: plane depth, metres; 0 or infinite: none; NaN: the colour is not to be used either",
        "time": "seconds since the start",
        "ambient": "linear radiance of the scene that the light sensor reports",
        "not_known": list(facts.not_known),
        "reference_exposure": facts.reference_exposure,
        "trigger": None if facts.trigger is None else asdict(facts.trigger),
        "files": list(facts.files),
    }


def read_session(path: Path) -> SessionFacts:
    """Of a session.json. ValueError naming it for what is none, OSError if it cannot be read."""
    content = read_json(path)
    try:
        if not isinstance(content, dict) or content.get("format") != FORMAT:
            raise ValueError(f"expected a JSON object with format {FORMAT!r}")
        if content.get("version") != VERSION:
            raise ValueError(f"version: expected {VERSION}, got {content.get('version')!r:.80}")
        exposure, trigger = content.get("reference_exposure"), content.get("trigger")
        if exposure is not None and not (isinstance(exposure, int | float) and 0 < exposure < np.inf):
            raise ValueError(f"reference_exposure: expected a positive factor, got {exposure!r:.80}")
        return SessionFacts(
            str(content.get("source", "")),
            _texts(content, "not_known"),
            None if exposure is None else float(exposure),
            None if trigger is None else TriggerSettings(**trigger),
            _texts(content, "files"),
        )
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from error


def _texts(content: Mapping[str, Any], name: str) -> tuple[str, ...]:
    texts = content.get(name, [])
    if not isinstance(texts, list) or not all(isinstance(text, str) for text in texts):
        raise ValueError(f"{name}: expected a list of texts")
    return tuple(texts)


def write_session(folder: Path, facts: SessionFacts) -> None:
    """Write session.json, whole or not at all. OSError if it cannot be written."""
    with written_whole(folder / SESSION_FILE) as beside:
        beside.write_text(json.dumps(session_as_json(facts), indent=1, allow_nan=False) + "\n", encoding="utf-8")


class SessionRecorder:
    """Keeps every frame it is given in `folder`, which is made if it is not there.

    FileExistsError if the folder already holds a recording: nothing is overwritten.
    """

    def __init__(self, folder: Path, facts: SessionFacts = SessionFacts()) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        if (folder / SESSION_FILE).exists() or any(folder.glob(FRAME_FILES)):
            raise FileExistsError(f"{folder}: already holds a recording; choose another folder")
        write_session(folder, facts)
        self.folder = folder
        self.n_frames = 0

    def record(self, frame: RgbdFrame) -> None:
        """Add one frame; the order of recording is the order of replay."""
        save_frame(self.folder / f"frame_{self.n_frames:06d}.exr", frame)
        self.n_frames += 1


class ReplayScanner:
    """Delivers the frames of a recording one after the other.

    FileNotFoundError if `folder` holds none; `acquire_environment_scan` raises StopIteration after the last.
    """

    def __init__(self, folder: str | Path) -> None:
        self.files: Sequence[Path] = sorted(Path(folder).glob(FRAME_FILES))
        if not self.files:
            raise FileNotFoundError(f"{folder}: no recorded frames ({FRAME_FILES}) in this folder")
        self._frames = iter(self)

    def __len__(self) -> int:
        return len(self.files)

    def __iter__(self) -> Iterator[RgbdFrame]:
        return (load_frame(file) for file in self.files)

    def acquire_environment_scan(self) -> RgbdFrame:
        """The next frame of the recording."""
        return next(self._frames)
