"""Records that pass between the stages of the chain: frozen, and they check themselves.

Each record is checked once, where it is made, so that no stage has to doubt its input. Arrays are converted to the
stated type and kept as read-only views; the caller's own array stays writable. Poses and other small ones in float64
are copied, since a program may write each pose into the array of the one before. A wrong shape, a wrong type or a value
out of range raises ValueError with what was expected and what came.

Frames of reference: Blender world, right-handed, +Z up, metres. Cameras look down -Z with +Y up.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from xihenet.invalid import UNKNOWN, Counts, n_left_out

ArrayF32 = NDArray[np.float32]
ArrayF64 = NDArray[np.float64]
ArrayU8 = NDArray[np.uint8]
ArrayBool = NDArray[np.bool_]
ArrayInt = NDArray[np.intp]

COPIED = 27  # Numbers of an array, at most: poses, places, and lights of order 2
POSE_TOLERANCE = 1e-3  # As poses are written with four digits

FLOAT32_TO_M = 8192.0
"""Distance from the world's origin from which on float32 has steps of a millimetre; 5,000 km from it, as in the
coordinates of maps, they are half a metre."""

SHORTEST_FOCAL_PX, FARTHEST_PX = 1e-6, 1e9
"""Of intrinsics, beyond any camera: squares of what lies along such rays fit float32, so that no stage has to ask."""

TriggerReason = Literal["first", "colour", "coverage", "light", "moved", "none"]


def _keep(record: object, dtype: Any, **shapes: tuple[int | None, ...]) -> None:
    """Check arrays of a record while it is made, and keep read-only views as `dtype`; None in a shape is any length."""
    for name, shape in shapes.items():
        array = getattr(record, name)
        if not (type(array) is np.ndarray and array.dtype == dtype):  # Else matrices and masks reach every stage.
            if isinstance(array, np.ma.MaskedArray) and array.mask.any():
                raise ValueError(
                    f"{type(record).__name__}.{name}: expected an array without masked values: fill them, with NaN or "
                    "0 where nothing is known"
                )
            with np.errstate(over="ignore"):  # What float32 cannot hold becomes infinite, which each record judges.
                array = np.asarray(array, dtype=dtype)
        if array.ndim != len(shape) or any(
            want not in (None, got) for want, got in zip(shape, array.shape, strict=True)
        ):
            expected = "(" + ", ".join("any" if want is None else str(want) for want in shape) + ")"
            raise ValueError(
                f"{type(record).__name__}.{name}: expected an array of shape {expected}, got {array.shape}"
            )
        view = array.copy() if dtype is np.float64 and array.size <= COPIED else array.view()
        view.flags.writeable = False
        object.__setattr__(record, name, view)


@dataclass(frozen=True)
class Intrinsics:
    """Pinhole camera in pixels; pixel centres lie at +0.5, row 0 is the top row.

    Parameters
    ----------
    width, height : image size in pixels, each at least 1
    fx, fy : focal lengths in pixels, 1e-6 to 1e9
    cx, cy : principal point in pixels from the top left corner of the image; may lie outside (lens shift), by 1e9 at
        most
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        if not all(side >= 1 and side % 1 == 0 for side in (self.width, self.height)):
            raise ValueError(f"Intrinsics: expected whole pixels, one at least, got {self.width} x {self.height}")
        for name in ("width", "height"):  # JSON and tables often have them as floats.
            object.__setattr__(self, name, int(getattr(self, name)))
        if not all(SHORTEST_FOCAL_PX <= focal <= FARTHEST_PX for focal in (self.fx, self.fy)):
            raise ValueError(
                f"Intrinsics: focal lengths must be positive, {SHORTEST_FOCAL_PX:g} to {FARTHEST_PX:g} pixels, got "
                f"fx={self.fx}, fy={self.fy}"
            )
        if not all(abs(place) <= FARTHEST_PX for place in (self.cx, self.cy)):
            raise ValueError(
                f"Intrinsics: the principal point must be within {FARTHEST_PX:g} pixels, got cx={self.cx}, cy={self.cy}"
            )


def check_last_row(pose: ArrayF64, name: str) -> None:
    """ValueError unless that of a pose (4, 4) is 0 0 0 1."""
    usual = (0, 0, 0, 1)
    if np.abs(pose[3] - usual).max() > POSE_TOLERANCE:
        is_transposed = np.abs(pose[:, 3] - usual).max() <= POSE_TOLERANCE
        fix = "transpose it" if is_transposed else "write the camera's axes and place in the first three rows"
        raise ValueError(f"{name}: expected the last row 0 0 0 1, got {pose[3].tolist()}: {fix}")


@dataclass(frozen=True, eq=False)
class RgbdFrame:
    """What the phone delivers at one moment.

    Parameters
    ----------
    srgb_u8 : (H, W, 3) uint8, sRGB-encoded after `exposure` and clipping
    plane_depth_m : (H, W) float32, metres along the optical axis; 0 or infinite where the sensor has none, which makes
        the pixel light from far away, and NaN where the pixel's colour is not to be used either
    intrinsics : of both images
    world_from_camera : (4, 4) float64, row by row: its last row is 0 0 0 1, the last column says where the camera is,
        and the first three are its axes, of length 1. They may mirror or shear, as those of cameras in Blender do
    exposure : factor that was applied to linear radiance before clipping and encoding, positive
    ambient : (3,) linear scene radiance that the ambient light sensor reports, or None without a sensor
    time_s : seconds since the start of the session, finite
    frame : number of the frame in its source
    invalid : how many pixels were left out or clamped before, by reason; see `xihenet.camera.invalid_pixels`
    white_balance : (3,) factors that were applied beside `exposure`, one for each channel, positive; None stands for 1
    confidence : (H, W) uint8 of plane depth as ARKit has it, 0 low, 1 medium, 2 high; None where the sensor says none
    """

    srgb_u8: ArrayU8
    plane_depth_m: ArrayF32
    intrinsics: Intrinsics
    world_from_camera: ArrayF64
    exposure: float = 1.0
    ambient: ArrayF64 | None = None
    time_s: float = 0.0
    frame: int = 0
    invalid: Counts = field(default_factory=dict)
    white_balance: ArrayF64 | None = None
    confidence: ArrayU8 | None = None

    def __post_init__(self) -> None:
        colour_type = np.asarray(self.srgb_u8).dtype
        if colour_type != np.uint8:
            raise ValueError(f"RgbdFrame.srgb_u8: expected uint8, got {colour_type}")
        _keep(self, np.float64, world_from_camera=(4, 4))
        if not np.isfinite(self.world_from_camera).all():
            raise ValueError("RgbdFrame.world_from_camera: expected finite numbers, got NaN or infinity")
        check_last_row(self.world_from_camera, "RgbdFrame.world_from_camera")
        lengths = np.linalg.norm(self.world_from_camera[:3, :3], axis=0)
        if not np.abs(lengths - 1).max() <= POSE_TOLERANCE:
            raise ValueError(
                "RgbdFrame.world_from_camera: expected axes, its first three columns, of length 1, got lengths of "
                f"{', '.join(f'{one:.4g}' for one in lengths)}: divide them by these, and give the place in metres"
            )
        if not (np.isfinite(self.exposure) and self.exposure > 0):
            raise ValueError(f"RgbdFrame.exposure: expected a positive factor, got {self.exposure}")
        object.__setattr__(self, "exposure", float(self.exposure))
        if not np.isfinite(self.time_s):
            raise ValueError(f"RgbdFrame.time_s: expected finite seconds, got {self.time_s}")
        if self.ambient is not None:
            _keep(self, np.float64, ambient=(3,))
            if not (np.isfinite(self.ambient).all() and (self.ambient >= 0).all()):
                raise ValueError(f"RgbdFrame.ambient: expected finite radiance >= 0, got {self.ambient}")
        if self.white_balance is not None:
            _keep(self, np.float64, white_balance=(3,))
            if not (np.isfinite(self.white_balance).all() and (self.white_balance > 0).all()):
                raise ValueError(f"RgbdFrame.white_balance: expected positive factors, got {self.white_balance}")
        depth_type = np.asarray(self.plane_depth_m).dtype
        if depth_type.kind != "f":
            raise ValueError(
                f"RgbdFrame.plane_depth_m: expected metres, as floats, got {depth_type}: multiply it by metres per "
                "unit, 0.001 for millimetres"
            )
        size = (self.intrinsics.height, self.intrinsics.width)
        if self.confidence is not None:
            _keep(self, np.uint8, confidence=size)
        _keep(self, np.uint8, srgb_u8=(*size, 3))
        _keep(self, np.float32, plane_depth_m=size)


FAR_M = 64.0
"""As far from the camera as this is the light of pixels without a distance taken to be, metres."""

FAR_FROM_M = FAR_M / 2
"""An anchor from here on is far away: a step of 2 m moves it by less than half of the 6 degrees between two anchors."""


@dataclass(frozen=True, eq=False)
class FarPixels:
    """Pixels whose colour is known and whose distance is not: sky, what is behind a window, what the sensor missed."""

    pixels: ArrayInt  # (K,) their numbers
    rays: ArrayF32  # (3, K) world, unit, away from the camera

    def __post_init__(self) -> None:
        _keep(self, np.intp, pixels=(None,))
        _keep(self, np.float32, rays=(3, len(self.pixels)))


@dataclass(frozen=True, eq=False)
class PixelGrid:
    """How the points of a frame lie in its picture: point `row * width + column` is that of a pixel."""

    height: int
    width: int
    camera_m: ArrayF64  # (3,) world, metres: from where the points were seen
    far: FarPixels | None = None  # pixels whose points are NaN and whose colours still say what light comes from there
    openings: ArrayInt | None = None  # (K,) pixels whose point is where light from far away comes through an opening

    def __post_init__(self) -> None:
        if self.height < 1 or self.width < 1:
            raise ValueError(f"PixelGrid: expected at least one pixel, got {self.width} x {self.height}")
        _keep(self, np.float64, camera_m=(3,))


def _needs_float64(points_m: ArrayLike) -> bool:
    """Whether float32 would round points by millimetres. NaN and infinite coordinates say nothing."""
    points = np.asarray(points_m)
    if points.dtype.kind not in "iuf" or np.can_cast(points.dtype, np.float32):
        return False
    return bool(np.any((np.abs(points) > FLOAT32_TO_M) & np.isfinite(points)))


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Coloured points of one frame in the world. Points may be NaN or infinite: sampling skips and counts them.

    Parameters
    ----------
    points_m : (P, 3) float32, world, metres; P may be 0. float64 stays what it is if a point is beyond FLOAT32_TO_M
    srgb : (P, 3) float32, sRGB-encoded colour in [0, 1] at the session's reference exposure
    invalid : how many of the points are not finite, by reason, as far as that is known
    grid : how the points lie in the picture; None for points without a picture, which then are points and no surfaces
    """

    points_m: ArrayF32 | ArrayF64
    srgb: ArrayF32
    invalid: Counts = field(default_factory=dict)
    grid: PixelGrid | None = None

    def __post_init__(self) -> None:
        _keep(self, np.float64 if _needs_float64(self.points_m) else np.float32, points_m=(None, 3))
        n = len(self.points_m)
        if self.grid is not None and n != self.grid.height * self.grid.width:
            raise ValueError(f"PointCloud.grid: expected {n} pixels, got {self.grid.width} x {self.grid.height}")
        if np.asarray(self.srgb).dtype == np.uint8:
            raise ValueError("PointCloud.srgb: expected colours in [0, 1], got uint8: divide them by 255")
        _keep(self, np.float32, srgb=(n, 3))

    @functools.cached_property
    def has_finite_colours(self) -> bool:
        """Whether no colour is NaN or infinite; found out once, however many positions sample the cloud."""
        return not len(self.srgb) or bool(np.isfinite(self.srgb.min()) and np.isfinite(self.srgb.max()))


@dataclass(frozen=True, eq=False)
class AnchorSurfaces:
    """What surface each anchor of a cloud shows, as far as one frame's depth can tell. All 0 where nothing is known.

    Parameters
    ----------
    facing : (N,) float32, cosine between the surface's normal, on the side that the camera saw, and the direction from
        the surface to the position, against the anchor's own: 1 faces the position, below 0 it would see the other
        side. Known where a neighbour along each axis of the picture is of the same surface, elsewhere 0 (or NaN)
    camera_distance_m : (N,) float32, from the camera to the surface
    view_direction : (N, 3) float32, unit, from the surface to the camera: under which angle its colour was seen
    """

    facing: ArrayF32
    camera_distance_m: ArrayF32
    view_direction: ArrayF32

    def __post_init__(self) -> None:
        _keep(self, np.float32, facing=(None,))
        _keep(self, np.float32, camera_distance_m=(len(self),), view_direction=(len(self), 3))
        if (np.abs(self.facing) > 1).any():
            raise ValueError("AnchorSurfaces.facing: expected cosines from -1 to 1, got values outside")

    def __len__(self) -> int:
        return len(self.facing)

    @classmethod
    def of_facing(cls, facing: ArrayLike) -> AnchorSurfaces:
        """Surfaces of which only `facing` (N,) is known."""
        zeros = np.zeros(len(np.asarray(facing)), np.float32)
        return cls(np.asarray(facing), zeros, np.zeros((len(zeros), 3), np.float32))

    def with_far_light(self, is_far: ArrayBool, rays: ArrayLike) -> AnchorSurfaces:
        """Where anchors `is_far` (N,) show light from far away, along `rays` (K, 3), they face the position."""
        view_direction = self.view_direction.copy()
        view_direction[is_far] = -np.asarray(rays).reshape(-1, 3)
        camera_distance_m = np.where(is_far, np.float32(FAR_M), self.camera_distance_m)
        return AnchorSurfaces(np.where(is_far, np.float32(1), self.facing), camera_distance_m, view_direction)


@dataclass(frozen=True, eq=False)
class UnitSphereCloud:
    """What is known of the light that arrives at one position: a colour and a distance for each anchor that is set.

    Parameters
    ----------
    srgb : (N, 3) float32 in [0, 1], sRGB-encoded; 0 where the anchor is not set
    distance_m : (N,) float32, finite and >= 0; 0 where the anchor is not set
    is_set : (N,) bool; this and nothing else says whether an anchor was seen
    invalid : how many points of a frame were left out, by reason (not finite, at the position itself, ...)
    surfaces : what surface each anchor shows, for estimators and the trigger; None where nobody looked
    beside_m : (N, 3) float32, world, metres: by how much what an anchor shows lies beside its own direction since the
        position has moved, so that many small moves add up; None where it has not
    """

    srgb: ArrayF32
    distance_m: ArrayF32
    is_set: ArrayBool
    invalid: Counts = field(default_factory=dict)
    surfaces: AnchorSurfaces | None = None
    beside_m: ArrayF32 | None = None

    def __post_init__(self) -> None:
        _keep(self, np.bool_, is_set=(None,))
        n = len(self)
        _keep(self, np.float32, srgb=(n, 3), distance_m=(n,))
        srgb, distance_m = self.srgb, self.distance_m
        if n and not (srgb.min() >= 0 and srgb.max() <= 1):
            raise ValueError("UnitSphereCloud.srgb: expected colours in [0, 1], got values outside or NaN")
        if n and not (distance_m.min() >= 0 and distance_m.max() < np.inf):
            raise ValueError(
                "UnitSphereCloud.distance_m: expected finite distances >= 0, got negative, infinite or NaN"
            )
        # Nothing is negative here, so a sum of 0 says that all are 0, twenty times as fast as looking at each.
        unset = (~self.is_set).astype(np.float32)
        if unset.dot(srgb).any() or unset.dot(distance_m) > 0:
            raise ValueError("UnitSphereCloud: an anchor that is not set must have colour and distance 0")
        if self.surfaces is not None and len(self.surfaces) != n:
            raise ValueError(f"UnitSphereCloud.surfaces: expected {n} anchors, got {len(self.surfaces)}")
        if self.beside_m is not None:
            _keep(self, np.float32, beside_m=(n, 3))

    @classmethod
    @functools.lru_cache(maxsize=8)  # Records are read-only, so one serves all.
    def empty(cls, n_anchors: int) -> UnitSphereCloud:
        """A cloud of `n_anchors` anchors of which none is set."""
        return cls(np.zeros((n_anchors, 3), np.float32), np.zeros(n_anchors, np.float32), np.zeros(n_anchors, bool))

    @classmethod
    def trusted(
        cls, srgb: ArrayF32, distance_m: ArrayF32, is_set: ArrayBool, invalid: Counts, surfaces: AnchorSurfaces | None,
        beside_m: ArrayF32 | None = None,
    ) -> UnitSphereCloud:  # fmt: skip
        """A cloud of arrays that hold what the record promises by the way they were made, so nothing is looked at.

        They are of the stated types and the caller's own: they become read-only. Looking at them takes a third of the
        time in which a cloud is decoded, or two are merged.
        """
        for array in (srgb, distance_m, is_set):
            array.setflags(write=False)
        cloud = object.__new__(cls)
        known = {"srgb": srgb, "distance_m": distance_m, "is_set": is_set, "invalid": invalid}
        cloud.__dict__.update(known, surfaces=surfaces, beside_m=beside_m)
        return cloud

    def __len__(self) -> int:
        return len(self.is_set)

    @property
    def n_invalid_points(self) -> int:
        """Points of a frame that were left out."""
        return n_left_out(self.invalid)


@dataclass(frozen=True)
class TriggerDecision:
    """Whether a new estimate is worth its cost, and why."""

    fire: bool  # make a new estimate
    reason: TriggerReason  # "first" without a previous cloud
    # The largest pooled colour change, for "coverage" the newly seen share of the sphere, for "light" the share by
    # which it differs, for "moved" the metres from where the last estimate was made; None for "first".
    change: float | None
    threshold: float  # what `change` was held against
    # Whose own pooled change exceeds the threshold, or newly seen ones for "coverage"; 0 for "light".
    n_changed_anchors: int = 0


@dataclass(frozen=True, eq=False)
class KeyLight:
    """A disc of even radiance, far away: the part of a light that casts a shadow.

    Parameters
    ----------
    direction : (3,) float64, unit, world, towards the light
    irradiance : (3,) float64, on a surface that faces it, linear Rec.709, carrying the estimate's exposure
    angular_radius : radians, from its middle to its rim
    is_seen : whether the phone saw it; else it is what the estimate implies
    certainty : 0 to 1, how large it is beside the error that the estimator expects of itself, see
        `xihenet.light.key_light.certainty_of`; 1 where that expects none
    """

    direction: ArrayF64
    irradiance: ArrayF64
    angular_radius: float
    is_seen: bool
    certainty: float = 1.0


@dataclass(frozen=True, eq=False)
class Reflections:
    """What glossy things reflect: the light from each direction of a lattice.

    Parameters
    ----------
    radiance : (N, 3) float32, not negative, linear Rec.709, carrying the estimate's exposure
    seen_share : of the directions that the phone has seen, 0 to 1
    """

    radiance: ArrayF32
    seen_share: float


@dataclass(frozen=True, eq=False)
class ObjectLight:
    """What lights an object.

    Parameters
    ----------
    sh : (9, 3) radiance coefficients of all of it
    key : the key light, a part of it; None for none
    reflections : the same light as glossy things show it; None shows them `sh` and `key`
    at : of an object that is bigger than one position can stand for, where its positions are ((3,) world, metres) and
        the light there, of which this is the mean; empty for an object with one
    """

    sh: ArrayF64
    key: KeyLight | None = None
    reflections: Reflections | None = None
    at: tuple[tuple[ArrayF64, ObjectLight], ...] = ()

    def tobytes(self) -> bytes:
        """All that decides what it looks like: the same for lights that look the same."""
        parts: list[Any] = [self.sh]
        for place_m, light in self.at:
            parts += [place_m, np.frombuffer(light.tobytes(), np.uint8)]
        if self.key is not None:
            key = self.key
            parts += [key.direction, key.irradiance, np.array([key.angular_radius, key.is_seen, key.certainty])]
        if self.reflections is not None:
            parts.append(self.reflections.radiance)
        return b"".join(part.tobytes() for part in parts)


@dataclass(frozen=True, eq=False)
class LightEstimate:
    """The light at one position.

    Parameters
    ----------
    sh_radiance : (9, 3) float64, radiance coefficients, linear Rec.709, carrying `exposure`
    exposure : the session's reference exposure; dividing by it gives scene radiance
    coverage : share of the anchors that were set, 0 to 1
    estimator : its registered name
    is_valid : False where the light could not be known; the coefficients are then 0 and must not be used
    expected_error : SHC RMSE that the estimator expects of itself, or None
    unknown_because : reason of `xihenet.invalid.UNKNOWN` where the light could not be known, else empty
    others : (9, 3) by name, what other estimators say of the same cloud, those that know
    key : the key light that is a part of it; None for none, and where the session asks for none
    other_keys : the key lights that are a part of `others`, of those that have one
    other_ms : milliseconds by name that the other estimators took, those that did not know too
    reflected : what was seen so far, on the finer lattice of reflections; None where nobody asked for it
    seen : what the estimate's frame alone showed, see `xihenet.light.carried_light`; None where nobody knows
    """

    sh_radiance: ArrayF64
    exposure: float
    coverage: float
    estimator: str
    is_valid: bool = True
    expected_error: float | None = None
    unknown_because: str = ""
    others: Mapping[str, ArrayF64] = field(default_factory=dict)
    key: KeyLight | None = None
    other_keys: Mapping[str, KeyLight] = field(default_factory=dict)
    other_ms: Mapping[str, float] = field(default_factory=dict)
    reflected: UnitSphereCloud | None = None
    seen: UnitSphereCloud | None = None

    def __post_init__(self) -> None:
        _keep(self, np.float64, sh_radiance=(9, 3))
        if not np.isfinite(self.sh_radiance).all():
            raise ValueError("LightEstimate.sh_radiance: expected finite coefficients, got NaN or infinity")
        if not (np.isfinite(self.exposure) and self.exposure > 0):
            raise ValueError(f"LightEstimate.exposure: expected a positive factor, got {self.exposure}")
        if not 0 <= self.coverage <= 1:
            raise ValueError(f"LightEstimate.coverage: expected a share from 0 to 1, got {self.coverage}")
        if self.expected_error is not None and not 0 <= self.expected_error < np.inf:
            raise ValueError(f"LightEstimate.expected_error: expected a finite error, got {self.expected_error}")
        if self.unknown_because and (self.is_valid or self.unknown_because not in UNKNOWN):
            raise ValueError(
                f"LightEstimate.unknown_because: expected one of {', '.join(UNKNOWN)} and only where the light is not "
                f"valid, got {self.unknown_because!r}"
            )


@dataclass(frozen=True, eq=False)
class StepReport:
    """What one step of the chain did for one position."""

    decision: TriggerDecision
    estimate: LightEstimate | None  # None if the trigger did not fire
    # Milliseconds per stage: unproject, sample, merge, trigger, encode, estimate; only stages that ran.
    stage_ms: Mapping[str, float] = field(default_factory=dict)
    payload_bytes: int = 0  # of the encoded cloud, 0 if none was encoded
    coverage: float = 0.0  # share of the anchors that are known, this frame's among them
    # Points of this frame that were left out and distances that were clamped, by reason.
    invalid: Counts = field(default_factory=dict)
    # Reason of `xihenet.invalid.UNKNOWN` why this frame could not tell the light, so that the last one stays; empty
    # where it could, or where the trigger saw no need.
    unknown_because: str = ""
    n_followed_anchors: int = 0  # out of view, whose colour was changed as the light in view did, a guess

    @property
    def n_invalid_points(self) -> int:
        """Points of this frame that were left out."""
        return n_left_out(self.invalid)
