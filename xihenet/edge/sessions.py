"""Sessions: which clouds belong together, who may use them, and how long they are kept.

All state of the service stands behind `SessionStore`, which knows nothing of HTTP or of inference: `MemoryStore` keeps
it in this process, `redis_store` outside of it. Records are immutable and replaced whole.

A session of the published client has no owner, and its id is all that protects it. Sessions of our own clients have
tokens, of which the store keeps SHA-256 alone: one of the owner, who may list and delete, and one for each client that
joined by the id. Memory is bounded by `StoreLimits`: a full store first forgets what has expired, then the session that
was idle longest if that was long enough, and else refuses.
"""

from __future__ import annotations

import hashlib
import secrets
import time
import uuid
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Protocol

from xihenet.edge.axes import PUBLISHED_AXES
from xihenet.estimators.base import Target
from xihenet.records import ArrayF64, KeyLight, UnitSphereCloud


@dataclass(frozen=True)
class StoreLimits:
    """How much is kept, and how long. One position of 1280 anchors takes some 60 kB."""

    n_sessions: int = 1000
    n_positions: int = 4096  # of all sessions together: some 250 MB
    n_positions_of_session: int = 16
    n_clients_of_session: int = 16
    idle_s: float = 600.0  # after so long without a request a session is forgotten
    least_idle_s: float = 60.0  # before which none is forgotten to make room


class StoreFull(Exception):
    """There is no room; the message says for what."""


class SessionFull(StoreFull):
    """There is no room in this session, however long one waits."""


class SessionGone(Exception):
    """There is no such session, or it has expired."""


class StoreLost(Exception):
    """The store does not answer, or refuses, and may work again in a moment; the cause says why, when it was asked."""


@dataclass(frozen=True)
class Session:
    """What is known of a session besides its clouds. Without an owner it is a published client's."""

    id: str
    n_anchors: int
    target: Target
    axes: str = PUBLISHED_AXES  # of a client that does not say its own
    owner: str = ""  # SHA-256 of the token
    clients: frozenset[str] = frozenset()  # of the tokens of those who joined
    is_joinable: bool = True
    created_s: float = 0.0  # Unix time

    @property
    def is_published(self) -> bool:
        return not self.owner

    def admits(self, token: str) -> bool:
        """Whether the holder of a token may estimate in it."""
        hashed = hash_of(token)
        return bool(token) and any(secrets.compare_digest(hashed, known) for known in (self.owner, *self.clients))

    def is_owned_by(self, token: str) -> bool:
        return bool(token and self.owner) and secrets.compare_digest(hash_of(token), self.owner)


@dataclass(frozen=True, eq=False)
class SeenPosition:
    """What a session knows of one estimation position. Each record, a changed copy too, has a `mark` of its own."""

    cloud: UnitSphereCloud  # merged from all frames
    exposure: float = 1.0  # that the cloud's colours and the light carry: that of the first frame, or the one replacing
    position_m: ArrayF64 | None = None  # (3,) in the session's world, our axes
    key: KeyLight | None = None  # of the last answer that was asked for one
    n_frames: int = 0
    mark: int = field(init=False, default_factory=lambda: secrets.randbits(64))


class SessionStore(Protocol):
    """Where sessions are. A session that is unknown or has expired is None; whatever finds one keeps it alive.

    Anything that is asked of a store outside the process may be a `StoreLost`.
    """

    name: str
    n_unreadable: int  # records that could not be read, and count as sessions that are gone

    def check(self) -> None:
        """`StoreLost` if the store does not answer."""

    def close(self) -> None:
        """Let go of what it takes to ask; sessions stay."""

    def add(self, session: Session) -> None:
        """Keep a new session; `StoreFull` where there is no room."""

    def session(self, session_id: str, *, is_fresh: bool = True) -> Session | None:
        """The session.

        If it need not be fresh a store may answer from memory, which does not keep the session alive, and may be wrong
        of one that has changed or is gone: for callers that put a position next, which a session that is gone refuses.
        """

    def replace(self, session: Session, before: Session) -> bool:
        """Keep a session that has changed; nothing if it is gone.

        False, and nothing is kept, if it is no longer as it was `before`: look again, since another was faster.
        """

    def delete(self, session_id: str) -> None: ...

    def owned_by(self, token: str) -> list[Session]:
        """Sessions of an owner, oldest first; looking does not keep them alive."""

    def position(self, session_id: str, name: str) -> SeenPosition | None:
        """What is known of it.

        A store may answer from memory, as above. If another worker has changed the position since, `put_position`
        refuses what is merged with it, and the next answer is new.
        """

    def positions(self, session_id: str) -> dict[str, SeenPosition]:
        """By name; empty for a session that is not there."""

    def put_position(self, session_id: str, name: str, seen: SeenPosition, before: SeenPosition | None) -> bool:
        """Keep what is known of a position. `StoreFull` for a new one without room, `SessionGone` without its session.

        False, and nothing is kept, if what is there is not `before` (None: there is nothing), which `seen` was merged
        with: look and merge again, since another was faster.
        """

    def delete_position(self, session_id: str, name: str) -> bool:
        """Forget a position; whether there was one."""

    def counts(self) -> tuple[int, int]:
        """Sessions and positions."""


def new_session(n_anchors: int, target: Target, axes: str, owner_token: str = "", *, joinable: bool = True) -> Session:
    """A session with a new id; without a token it is a published client's."""
    owner = hash_of(owner_token) if owner_token else ""
    return Session(
        str(uuid.uuid4()), n_anchors, target, axes, owner, is_joinable=joinable, created_s=round(time.time(), 3)
    )


def new_token() -> str:
    """256 random bits, as text."""
    return secrets.token_urlsafe(32)


def hash_of(token: str) -> str:
    """What is kept of a token."""
    return hashlib.sha256(token.encode("utf-8", "surrogatepass")).hexdigest()


@dataclass
class _Kept:
    session: Session
    used_s: float
    positions: dict[str, SeenPosition] = field(default_factory=dict)


class MemoryStore:
    """Sessions in this process. Not safe between threads: the event loop alone calls it."""

    name, n_unreadable = "memory", 0

    def __init__(self, limits: StoreLimits | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        self.limits, self._clock = limits or StoreLimits(), clock
        # Least recently used first, as dictionaries keep their order and a session that is used moves to the end.
        self._kept: dict[str, _Kept] = {}
        self._n_positions = 0

    def check(self) -> None:
        """It is always there."""

    def close(self) -> None:
        """Nothing is held."""

    def add(self, session: Session) -> None:
        if len(self._kept) >= self.limits.n_sessions:
            self._make_room(f"{self.limits.n_sessions} sessions are open")
        self._kept[session.id] = _Kept(session, self._clock())

    def session(self, session_id: str, *, is_fresh: bool = True) -> Session | None:
        kept = self._used(session_id)
        return None if kept is None else kept.session

    def replace(self, session: Session, before: Session) -> bool:
        kept = self._used(session.id)
        if kept is not None and kept.session != before:
            return False
        if kept is not None:
            kept.session = session
        return True

    def delete(self, session_id: str) -> None:
        kept = self._kept.pop(session_id, None)
        if kept is not None:
            self._n_positions -= len(kept.positions)

    def owned_by(self, token: str) -> list[Session]:
        self.expire()
        owned = [kept.session for kept in self._kept.values() if kept.session.is_owned_by(token)]
        return sorted(owned, key=lambda session: session.created_s)

    def position(self, session_id: str, name: str) -> SeenPosition | None:
        kept = self._used(session_id)
        return None if kept is None else kept.positions.get(name)

    def positions(self, session_id: str) -> dict[str, SeenPosition]:
        kept = self._used(session_id)
        return {} if kept is None else dict(kept.positions)

    def put_position(self, session_id: str, name: str, seen: SeenPosition, before: SeenPosition | None) -> bool:
        kept = self._used(session_id)
        if kept is None:
            raise SessionGone
        if _mark_of(kept.positions.get(name)) != _mark_of(before):
            return False
        if name not in kept.positions:
            if len(kept.positions) >= self.limits.n_positions_of_session:
                raise SessionFull(f"a session has {self.limits.n_positions_of_session} positions at most")
            if self._n_positions >= self.limits.n_positions:
                self._make_room(f"{self.limits.n_positions} positions are known", but=session_id)
            self._n_positions += 1
        kept.positions[name] = seen
        return True

    def delete_position(self, session_id: str, name: str) -> bool:
        kept = self._used(session_id)
        if kept is None or name not in kept.positions:
            return False
        del kept.positions[name]
        self._n_positions -= 1
        return True

    def counts(self) -> tuple[int, int]:
        return len(self._kept), self._n_positions

    def expire(self) -> int:
        """Forget all sessions that were idle too long; how many those were."""
        now, n = self._clock(), 0
        while self._kept and now - next(iter(self._kept.values())).used_s > self.limits.idle_s:
            self.delete(next(iter(self._kept)))
            n += 1
        return n

    def _used(self, session_id: str) -> _Kept | None:
        kept = self._kept.get(session_id)
        if kept is None:
            return None
        now = self._clock()
        if now - kept.used_s > self.limits.idle_s:
            self.expire()
            return None
        kept.used_s = now
        self._kept[session_id] = self._kept.pop(session_id)
        return kept

    def _make_room(self, full: str, but: str = "") -> None:
        """Forget what has expired or else one idle session; `StoreFull` if there is none.

        With `but`, the session that wants it, room is for a position: forgetting sessions without any makes none.
        """
        n_before = self._n_positions
        if self.expire() and not (but and self._n_positions == n_before):
            return
        makes_room = (name for name, kept in self._kept.items() if name != but and (kept.positions or not but))
        oldest = next(makes_room, None)
        if oldest is None or self._clock() - self._kept[oldest].used_s < self.limits.least_idle_s:
            raise StoreFull(full)
        self.delete(oldest)


def _mark_of(seen: SeenPosition | None) -> int | None:
    return None if seen is None else seen.mark


def joined(session: Session, token: str, limits: StoreLimits) -> Session:
    """The session with one client more; `SessionFull` where there are too many."""
    if len(session.clients) >= limits.n_clients_of_session:
        raise SessionFull(f"a session has {limits.n_clients_of_session} clients beside its owner at most")
    return replace(session, clients=session.clients | {hash_of(token)})
