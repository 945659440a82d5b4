"""The chain of one session: unproject, sample, merge, trigger, encode, estimate, at every estimation position.

`XiheController` holds all the state there is: the buffers, the last decision and the light in use of each position.
Capture comes before this chain, apply and compare after it; they belong to whoever has a camera and a picture.

Paper: section 5 and its table of classes; section 4.3.2 for active positions.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike

from xihenet.backend import LightBackend, as_inference_backend, estimate_light, estimate_lights
from xihenet.buffers import FrameAtPosition, PositionBuffers, merge, merge_in_sight
from xihenet.camera import in_view, unproject_frame
from xihenet.codec import EncodingMethod, encode_cloud, n_clamped_distances
from xihenet.estimators.base import EstimateContext
from xihenet.invalid import Counts, counted
from xihenet.io.recording import SessionRecorder
from xihenet.light import BetweenEstimates
from xihenet.light.carried_light import CarriedLight
from xihenet.light.key_light import find_key_light
from xihenet.light.reflections import N_DIRECTIONS, N_NEIGHBOURS, thinned
from xihenet.light_change import LightFollowing, follow_coarser, follow_light
from xihenet.records import (
    ArrayBool,
    ArrayF64,
    Intrinsics,
    KeyLight,
    LightEstimate,
    PointCloud,
    RgbdFrame,
    StepReport,
    TriggerDecision,
    UnitSphereCloud,
)
from xihenet.sampling import checked_position, sample_again, sample_unit_sphere
from xihenet.sphere import TABLE_SIZE, AnchorLattice, NearestMethod
from xihenet.trigger import LastSeen, TriggerSettings, decide_trigger

MOVED_M = 0.02
"""A position that is no further from where its light was estimated counts as still there."""


@dataclass(frozen=True)
class ControllerSettings:
    """How a session runs."""

    trigger: TriggerSettings = field(default_factory=TriggerSettings)
    # What `payload_bytes` counts: the record that carries all the estimators are told, facing among it.
    codec: EncodingMethod = "uint8_float16_facing_stripped"
    nearest: NearestMethod = "exact"  # how points find their anchor, see `AnchorLattice.nearest`
    table_size: tuple[int, int] = TABLE_SIZE
    reference_exposure: float | None = None  # that anchors and estimates carry; None takes the first frame's
    # How what is out of view follows a change of the light; None lets it be, as the paper does.
    following: LightFollowing | None = field(default_factory=LightFollowing)
    # Whether positions out of view see the frames as well; in the paper they cost nothing, and learn nothing.
    learns_out_of_view: bool = False
    # Whether estimates say which part of their light is a key light, see `xihenet.light.key_light`.
    has_key_light: bool = False
    # Whether they say what was seen on the finer lattice of reflections, see `xihenet.light.reflections`.
    has_reflections: bool = False
    # What becomes of the light in use until the next estimate: carried on as the room's light changes, see
    # `xihenet.light.carried_light`, or kept as it was estimated, as in the paper.
    between_estimates: BetweenEstimates = "kept"

    def __post_init__(self) -> None:
        if self.between_estimates not in get_args(BetweenEstimates):
            raise ValueError(
                f"ControllerSettings.between_estimates: expected 'carried' or 'kept', got {self.between_estimates!r}"
            )
        if self.reference_exposure is not None and not 0 < self.reference_exposure < np.inf:
            raise ValueError(
                f"ControllerSettings.reference_exposure: expected a positive factor, got {self.reference_exposure}"
            )


class XiheController:
    """One AR session: positions go in, frames go in, light comes out.

    `backend` makes the estimates; its `n_anchors` is the session's. `others` answer beside it, for the same clouds:
    their light is in `LightEstimate.others`, and their time in `LightEstimate.other_ms`.

    A session is not safe between threads: call it from one, or under a lock. Sessions may share an estimator. Whatever
    takes a position's name raises KeyError for one that was not added.
    """

    def __init__(
        self, backend: LightBackend, settings: ControllerSettings | None = None, *, others: Sequence[LightBackend] = ()
    ) -> None:
        self.backend, self.others = as_inference_backend(backend), [as_inference_backend(other) for other in others]
        self.settings = settings or ControllerSettings()
        self.lattice = AnchorLattice(backend.n_anchors)
        looks_finely = self.settings.has_key_light or self.settings.has_reflections
        self.fine_lattice = AnchorLattice(N_DIRECTIONS) if looks_finely else None
        self.reference_exposure = self.settings.reference_exposure
        # Tables are built on first use; built here, no frame pays for them.
        self.lattice.nearest(self.lattice.directions[:1], self.settings.nearest, self.settings.table_size)
        self.lattice.neighbours(min(self.settings.trigger.n_neighbours, len(self.lattice)))
        if self.fine_lattice is not None:
            self.fine_lattice.nearest(self.fine_lattice.directions[:1])
            self.fine_lattice.neighbours(N_NEIGHBOURS)
        self._positions: dict[str, _Position] = {}
        self.out_of_view_ms: dict[str, float] = {}
        """Of the last step, by stage, at positions that were out of view."""
        self._frame: RgbdFrame | None = None
        self._recorder: SessionRecorder | None = None

    def add_position(self, name: str, position_m: ArrayLike) -> None:
        """Estimate the light at `position_m` ((3,), world, metres) from now on; a name that is known is moved there."""
        fine = None if self.fine_lattice is None else UnitSphereCloud.empty(self.fine_lattice.n)
        self._positions[name] = _Position(
            checked_position(position_m), PositionBuffers.empty(self.backend.n_anchors), reflected=fine
        )

    def move_position(self, name: str, position_m: ArrayLike) -> None:
        """Have position `name` at `position_m` ((3,), world, metres) from now on, with what is known of the room."""
        position, place = self._positions[name], checked_position(position_m)
        if not np.array_equal(place, position.position_m):
            position.buffers = position.buffers.moved(place - position.position_m, self.lattice)
            if position.reflected is not None and self.fine_lattice is not None:
                moved_m = place - position.position_m
                position.reflected = sample_again(position.reflected, moved_m, self.fine_lattice)
            position.carried, position.seen = position.carried and position.carried.moved(), None
            position.position_m = place

    @property
    def positions(self) -> dict[str, ArrayF64]:
        """World position of every estimation position, by name."""
        return {name: position.position_m for name, position in self._positions.items()}

    def light(self, name: str) -> LightEstimate | None:
        """The light in use at a position: its last valid estimate, or None before there is one.

        Carried on to the last frame that the position has learned from, where the settings say so.
        """
        position = self._positions[name]
        return position.light if position.carried is None else position.carried.light

    def gain(self, name: str) -> ArrayF64:
        """(3,) what the last estimate is multiplied by to be the light in use; 1 without one, and where kept."""
        carried = self._positions[name].carried
        return np.ones(3) if carried is None else carried.gain

    def seen(self, name: str) -> UnitSphereCloud | None:
        """What the last frame that a position has learned from showed of it; None before there was one."""
        return self._positions[name].seen

    def coverage(self, name: str) -> float:
        """Share of a position's anchors that are known."""
        return self._positions[name].buffers.coverage()

    def known(self, name: str) -> UnitSphereCloud:
        """What the session knows of the light that arrives at a position, the last frame included."""
        buffers = self._positions[name].buffers
        return merge(buffers.persistent, buffers.temporary)

    def active(self, intrinsics: Intrinsics, world_from_camera: ArrayF64) -> list[str]:
        """Names of the positions inside a camera's view; the others cost nothing and keep their light."""
        if not self._positions:
            return []
        points = np.stack([position.position_m for position in self._positions.values()])
        seen = in_view(points, intrinsics, world_from_camera)
        return [name for name, is_active in zip(self._positions, seen, strict=True) if is_active]

    def step(
        self,
        frame: RgbdFrame,
        truth: dict[str, ArrayF64] | None = None,
        *,
        active: Sequence[str] | None = None,
        points: PointCloud | None = None,
    ) -> dict[str, StepReport]:
        """Run the chain on one frame for every active position.

        `truth` has the (9, 3) coefficients of the rendered light probe by position, for estimators that need them.
        `active` names the positions in view, for whoever knows the true pose of a frame whose own has drifted;
        `points` are those of the frame at the session's exposure, for whoever has unprojected it.

        StepReport by position, active ones only: the others may learn from the frame, see `learns_out_of_view`, but
        nothing is sent and no light changes before they are in view. Unprojecting is shared; its time stands in the
        first report, or where there is none in `out_of_view_ms`.
        """
        if self._recorder is not None:
            self._recorder.record(frame)
        if self.reference_exposure is None:
            self.reference_exposure = frame.exposure
        self._frame = frame
        if active is None:
            active = self.active(frame.intrinsics, frame.world_from_camera)
        learning = [name for name in self._positions if name not in active] if self.settings.learns_out_of_view else []
        self.out_of_view_ms = {}
        if not active and not learning:
            return {}
        clock = StageClock()
        if points is None:
            with clock.stage("unproject"):
                points = unproject_frame(frame, reference_exposure=self.reference_exposure)
        self._reflect([*active, *learning], frame, points, clock)
        looks = []
        for name in active:
            looks.append(self._look(name, frame, points, (truth or {}).get(name), clock))
            clock = StageClock()
        self._ask([look for look in looks if look.context is not None])
        reports = {name: self._answered(look) for name, look in zip(active, looks, strict=True)}
        for name in learning:
            self._learn(name, frame, points, clock)
        self.out_of_view_ms = clock.stage_ms
        return reports

    def _reflect(self, names: Sequence[str], frame: RgbdFrame, points: PointCloud, clock: StageClock) -> None:
        """Take the frame in on the finer lattice, where the session has one; nothing of it is sent."""
        if self.fine_lattice is None:
            return
        with clock.stage("reflect"):
            points = thinned(points)
            for position in (self._positions[name] for name in names):
                sampled = sample_unit_sphere(points, position.position_m, self.fine_lattice, with_surfaces=False)
                assert position.reflected is not None
                sight = FrameAtPosition(frame, position.position_m, self.fine_lattice)
                position.reflected = merge_in_sight(position.reflected, sampled, sight)

    def _learn(self, name: str, frame: RgbdFrame, points: PointCloud, clock: StageClock) -> None:
        position = self._positions[name]
        with clock.stage("sample"):
            sampled = self._sample(points, position.position_m)
        with clock.stage("merge"):
            sampled = position.buffers.in_sight(sampled, FrameAtPosition(frame, position.position_m, self.lattice))
            self._follow(position, sampled)
            position.buffers = position.buffers.with_frame(sampled)
            position.see(sampled, self.lattice)

    def _look(
        self, name: str, frame: RgbdFrame, points: PointCloud, truth_sh: ArrayF64 | None, clock: StageClock
    ) -> _Look:
        """Take the frame in at an active position, and get ready to ask for its light if the trigger fires."""
        position, settings = self._positions[name], self.settings
        with clock.stage("sample"):
            sampled = self._sample(points, position.position_m)
        with clock.stage("merge"):
            sampled = position.buffers.in_sight(sampled, FrameAtPosition(frame, position.position_m, self.lattice))
            buffers = position.buffers.with_frame(sampled)
        with clock.stage("trigger"):
            before, now = buffers.persistent, buffers.temporary
            seen = LastSeen(position.buffers.last_seen(), sampled)
            decision = decide_trigger(
                before, now, self.lattice, settings.trigger, last=position.decision, last_seen=seen
            )
            if not decision.fire and position.moved_m > MOVED_M and sampled.is_set.any():
                decision = TriggerDecision(True, "moved", position.moved_m, MOVED_M)
            position.see(sampled, self.lattice)
        look = _Look(position, sampled, decision, clock, buffers)
        if decision.fire:
            with clock.stage("merge"):
                is_followed = self._follow(position, sampled)
                buffers = position.buffers.with_frame(sampled)
                persistent = self._followed(buffers.persistent, buffers.temporary)
                is_followed |= (persistent.srgb != buffers.persistent.srgb).any(axis=1)
                look.followed, look.n_followed = replace(buffers, persistent=persistent), int(is_followed.sum())
                look.reflected = self._followed_finely(position.reflected, buffers.persistent, persistent)
            with clock.stage("encode"):
                look.payload = encode_cloud(look.followed.temporary, settings.codec)
            look.context = EstimateContext(frame, points, position.position_m, truth_sh, self.reference_exposure)
            # Where only more came into view, older views of a surface are as true as newer ones.
            is_changed = decision.reason != "coverage" or look.n_followed > 0
            look.fired = look.followed.fired(is_changed=is_changed)
        position.buffers, position.decision = buffers, decision
        return look

    def _ask(self, looks: Sequence[_Look]) -> None:
        """Ask for the light of all positions that fired in a frame, together; each has its share of the time."""
        whole = StageClock()
        with whole.stage("estimate"):
            clouds = [look.fired.persistent for look in looks]
            contexts = [look.context for look in looks if look.context is not None]
            lights = estimate_lights(self.backend, clouds, contexts, self.reference_exposure or 1.0)
        for look, light in zip(looks, lights, strict=True):
            look.clock.stage_ms["estimate"] = whole.stage_ms["estimate"] / len(looks)
            look.estimate = light

    def _answered(self, look: _Look) -> StepReport:
        """After the answer, if one was asked for: the light in use, and what was done."""
        position, invalid = look.position, look.sampled.invalid
        estimate, unknown_because = look.estimate, "" if look.sampled.is_set.any() else "nothing_seen"
        if estimate is not None and look.context is not None:
            cloud, unknown_because = look.fired.persistent, estimate.unknown_because
            invalid = {**invalid, **self._clamped(look.followed.temporary, cloud)}
            if estimate.is_valid:
                position.reflected = look.reflected
                with look.clock.stage("estimate"):
                    before = position.light.key if position.light else None
                    estimate = replace(estimate, key=self._key_light(estimate, position, before))
                estimate = self._with_others(estimate, cloud, look.context, position)
                reflected = position.reflected if self.settings.has_reflections else None
                estimate = replace(estimate, reflected=reflected, seen=look.sampled)
                position.buffers, position.light, position.lit_at_m = look.fired, estimate, position.position_m
                position.carried = CarriedLight(estimate) if self.settings.between_estimates == "carried" else None
            # Else what was seen is still unanswered, and the trigger goes on to ask: against what the light in use was
            # made from, so that only the temporary cloud has followed the light.
        return StepReport(
            look.decision,
            estimate,
            look.clock.stage_ms,
            len(look.payload),
            position.buffers.coverage(),
            invalid,
            unknown_because,
            look.n_followed,
        )

    def _sample(self, points: PointCloud, position_m: ArrayLike) -> UnitSphereCloud:
        how = self.settings
        return sample_unit_sphere(points, position_m, self.lattice, method=how.nearest, table_size=how.table_size)

    def _follow(self, position: _Position, sampled: UnitSphereCloud) -> ArrayBool:
        """Have what a position has seen since its last estimate change as the light did; which anchors (N,) did."""
        before = position.buffers.temporary
        temporary = self._followed(before, sampled)
        position.reflected = self._followed_finely(position.reflected, before, temporary)
        position.buffers = replace(position.buffers, temporary=temporary)
        return np.asarray((temporary.srgb != before.srgb).any(axis=1))

    def _followed(self, old: UnitSphereCloud, new: UnitSphereCloud) -> UnitSphereCloud:
        """`old`, changed as the light did where `new` shows nothing, if the settings say so."""
        following = self.settings.following
        return old if following is None else follow_light(old, new, following)

    def _followed_finely(
        self, fine: UnitSphereCloud | None, before: UnitSphereCloud, after: UnitSphereCloud
    ) -> UnitSphereCloud | None:
        """`fine`, of the sphere of reflections, changed as anchors beside were from `before` to `after`."""
        if fine is None or self.fine_lattice is None or after is before:
            return fine
        return follow_coarser(fine, before, after, self.lattice.nearest(self.fine_lattice.directions))

    def _key_light(self, light: LightEstimate, position: _Position, previous: KeyLight | None) -> KeyLight | None:
        """Where the session asks for one."""
        if not self.settings.has_key_light:
            return None
        seen, lattice = position.reflected, self.fine_lattice
        return find_key_light(light.sh_radiance, seen, lattice, previous, expected_error=light.expected_error)

    def _with_others(
        self, estimate: LightEstimate, cloud: UnitSphereCloud, context: EstimateContext, position: _Position
    ) -> LightEstimate:
        """With what the other estimators say, those for which the light can be known."""
        clock, lights, keys = StageClock(), {}, {}
        previous = position.light.other_keys if position.light else {}
        for other in self.others:
            name = other.name
            with clock.stage(name):
                light = estimate_light(other, cloud, context, self.reference_exposure or 1.0)
                key = self._key_light(light, position, previous.get(name)) if light.is_valid else None
            if light.is_valid:
                lights[name] = light.sh_radiance
            if key is not None:
                keys[name] = key
        return replace(estimate, others=lights, other_keys=keys, other_ms=clock.stage_ms)

    def _clamped(self, sent: UnitSphereCloud, used: UnitSphereCloud) -> Counts:
        """Distances that the wire or the network takes for others."""
        beyond = used.distance_m > self.backend.farthest_m
        return counted(distance_on_wire=n_clamped_distances(sent), distance_in_network=int(np.count_nonzero(beyond)))

    def estimate_at(self, position_m: ArrayLike) -> LightEstimate:
        """The light at `position_m` as far as the last frame shows it, now and whatever the trigger thinks.

        The session's positions are left as they are; `add_position` makes one that is followed.
        ValueError before the first frame. Without a point in view the estimate says `is_valid=False`.
        """
        if self._frame is None or self.reference_exposure is None:
            raise ValueError("estimate_at: no frame yet; call step(frame) first")
        points = unproject_frame(self._frame, reference_exposure=self.reference_exposure)
        sampled = self._sample(points, position_m)
        position = np.asarray(position_m, np.float64)
        context = EstimateContext(self._frame, points, position, None, self.reference_exposure)
        return estimate_light(self.backend, sampled, context, self.reference_exposure)

    def start_recording(self, path: str | Path) -> None:
        """Keep every frame that `step` gets in the folder `path`; FileExistsError if that holds a recording."""
        self._recorder = SessionRecorder(Path(path))

    def stop_recording(self) -> int:
        """Stop, and return how many frames were kept; 0 if nothing was being recorded."""
        recorder, self._recorder = self._recorder, None
        return recorder.n_frames if recorder else 0


@dataclass
class _Position:
    """What a session knows of one estimation position."""

    position_m: ArrayF64
    buffers: PositionBuffers
    decision: TriggerDecision | None = None
    light: LightEstimate | None = None
    lit_at_m: ArrayF64 | None = None
    """Where the light in use was estimated."""
    reflected: UnitSphereCloud | None = None
    """All that was seen, on the finer lattice of reflections, in which the key light is looked for too."""
    carried: CarriedLight | None = None
    """The light in use, where the session carries it on to the next estimate."""
    seen: UnitSphereCloud | None = None
    """The last frame, of which a position has learned."""

    def see(self, sampled: UnitSphereCloud, lattice: AnchorLattice) -> None:
        """Have the light in use go on to a frame."""
        before, self.seen = self.seen, sampled
        if self.carried is not None:
            self.carried = self.carried.after(sampled, before, lattice.directions)

    @property
    def moved_m(self) -> float:
        """How far that is from here; 0 without a light."""
        return 0.0 if self.lit_at_m is None else float(np.linalg.norm(self.position_m - self.lit_at_m))


@dataclass
class _Look:
    """A frame at one active position: what it showed, whether it calls for an estimate, and that."""

    position: _Position
    sampled: UnitSphereCloud
    decision: TriggerDecision
    clock: StageClock
    followed: PositionBuffers
    """With the frame, and as it is with what is out of view changed as the light did where the trigger fired."""
    n_followed: int = 0
    reflected: UnitSphereCloud | None = None
    """That of the position, followed as the persistent cloud was; it takes its place once there is an answer."""
    payload: bytes = b""
    context: EstimateContext | None = None
    """None where nothing is asked for."""
    fired: PositionBuffers = field(init=False)
    estimate: LightEstimate | None = None

    def __post_init__(self) -> None:
        self.fired = self.followed


class StageClock:
    """Milliseconds per stage."""

    def __init__(self) -> None:
        self.stage_ms: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time of the block to stage `name`."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.stage_ms[name] = self.stage_ms.get(name, 0.0) + 1e3 * (time.perf_counter() - start)
