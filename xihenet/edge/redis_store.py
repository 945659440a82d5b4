"""Sessions in Redis, so that several server processes share them and they outlive each of these.

A session is one hash, with its own record and one field for each position, and Redis itself forgets it when nobody has
used it for `StoreLimits.idle_s`. Each operation is one Lua script: one round trip, and nothing comes between its
steps. A sorted set of sessions by last use, with the number of positions of each, keeps the limits; since it learns of
what Redis forgot only when room is needed or counts are asked for, they hold approximately.

Each worker remembers the sessions and positions that it read or wrote last, so that a request of a phone that stays at
one worker is one call, which puts the position: if the session is gone, or another worker has changed the position,
that call says so and keeps nothing.

Calls wait for Redis in the event loop, a tenth of a millisecond on the same machine, and never longer than `TIMEOUT_S`;
`redis.asyncio` was rejected, since it costs more processor time than the wait. A store that failed is left alone for
`PAUSE_S`, in which every call is a `StoreLost` at once, and then asked again.

Not for Redis Cluster: the scripts find their keys by themselves.
"""

from __future__ import annotations

import hashlib
import re
import time
from collections import OrderedDict
from collections.abc import Callable
from typing import Any, TypeVar

import redis

from xihenet.edge.sessions import (
    SeenPosition,
    Session,
    SessionFull,
    SessionGone,
    StoreFull,
    StoreLimits,
    StoreLost,
    hash_of,
)
from xihenet.edge.stored import mark_bytes, position_from_bytes, position_to_bytes, session_from_bytes, session_to_bytes

MOST_REMEMBERED = 512
"""Sessions, and positions of some 60 kB at most."""

TIMEOUT_S = 0.25
PAUSE_S = 1.0
LOST = "Redis, which keeps the sessions, does not answer"
REFUSES = "Redis, which keeps the sessions, refuses what it is asked"

Read = TypeVar("Read")
Key = TypeVar("Key")

_ID = re.compile(r"[0-9a-f-]{36}")
_POSITION = b"at:"

# What all scripts begin with. Times are milliseconds; the 1 in the keys is the version of all that lies there. Use is
# noted when a hundredth of the time to live has gone by, so that the calls of one request write it once. A position's
# mark has a field of its own, so that telling whether it changed does not copy it. What takes no memory is written
# first: where memory is full a script may go on to write after that, so that sessions can be used and forgotten.
_SHARED = """
local id, idle, least_idle = ARGV[1], tonumber(ARGV[2]), tonumber(ARGV[3])
local most_sessions, most_positions, most_of_session = tonumber(ARGV[4]), tonumber(ARGV[5]), tonumber(ARGV[6])
local field, new, before = ARGV[7], ARGV[8], ARGV[9]
local time = redis.call('TIME')
local now = time[1] * 1000 + math.floor(time[2] / 1000)
local used, sizes, total = 'xihe:1:used', 'xihe:1:sizes', 'xihe:1:positions'

local function key_of(id) return 'xihe:1:session:' .. id end
local function mark_of(field) return 'mark of ' .. field end
local function owner_key(owner) return 'xihe:1:owner:' .. owner end

local function use(id)
    local last = tonumber(redis.call('ZSCORE', used, id) or 0)
    if now - last < idle / 100 then return end
    redis.call('PEXPIRE', key_of(id), idle)
    redis.call('ZADD', used, now, id)
    local owner = redis.call('HGET', key_of(id), 'owner')
    if owner then redis.call('PEXPIRE', owner_key(owner), idle) end
end

local function find(id)
    local found = redis.call('HGET', key_of(id), 'session')
    if found then use(id) end
    return found
end

local function forget(id)
    redis.call('DEL', key_of(id))
    redis.call('DECRBY', total, redis.call('HGET', sizes, id) or 0)
    redis.call('HDEL', sizes, id)
    redis.call('ZREM', used, id)
end

local function expire()
    local gone = redis.call('ZRANGEBYSCORE', used, '-inf', now - idle, 'LIMIT', 0, 1000)
    for _, one in ipairs(gone) do forget(one) end
    return #gone
end

local function n_known() return tonumber(redis.call('GET', total) or 0) end

local function make_room(but)
    local before = n_known()
    if expire() > 0 and (but == '' or n_known() < before) then return true end
    for _, one in ipairs(redis.call('ZRANGEBYSCORE', used, '-inf', now - least_idle)) do
        local has_some = but == '' or tonumber(redis.call('HGET', sizes, one) or 0) > 0
        if one ~= but and has_some then
            forget(one)
            return true
        end
    end
    return false
end
"""

_SCRIPTS = {
    "add": """
if redis.call('ZCARD', used) >= most_sessions and not make_room('') then return 'full' end
redis.call('HSET', key_of(id), 'session', new)
if field ~= '' then
    redis.call('HSET', key_of(id), 'owner', field)
    redis.call('SADD', owner_key(field), id)
end
use(id)
""",
    "session": "return find(id)",
    "replace": """
local found = find(id)
if found and found ~= before then return 'overtaken' end
if found then redis.call('HSET', key_of(id), 'session', new) end
""",
    "delete": "forget(id)",
    "owned_by": """
local owned = {}
for _, one in ipairs(redis.call('SMEMBERS', owner_key(field))) do
    local found = redis.call('HGET', key_of(one), 'session')
    if found then
        owned[#owned + 1] = one
        owned[#owned + 1] = found
    else
        redis.call('SREM', owner_key(field), one)
    end
end
return owned
""",
    "position": "return find(id) and redis.call('HGET', key_of(id), field)",
    "positions": "return find(id) and redis.call('HGETALL', key_of(id)) or {}",
    "put_position": """
if not find(id) then return end
local known = redis.call('HGET', key_of(id), mark_of(field))
if (known or '') ~= before then return 'overtaken' end
if not known then
    if tonumber(redis.call('HGET', sizes, id) or 0) >= most_of_session then return 'session is full' end
    if n_known() >= most_positions and not make_room(id) then return 'full' end
    redis.call('HINCRBY', sizes, id, 1)
    redis.call('INCR', total)
end
redis.call('HSET', key_of(id), field, new, mark_of(field), string.sub(new, 1, 9))
return 'kept'
""",
    "delete_position": """
if not find(id) or redis.call('HDEL', key_of(id), field, mark_of(field)) == 0 then return 0 end
redis.call('HINCRBY', sizes, id, -1)
redis.call('DECR', total)
return 1
""",
    "counts": """
expire()
return {redis.call('ZCARD', used), n_known()}
""",
}

_HASHES = {name: hashlib.sha1((_SHARED + text).encode()).hexdigest() for name, text in _SCRIPTS.items()}


class _WrongType(Exception):
    """At a key of ours lies something else."""


class RedisStore:
    """Sessions in the Redis at an address such as redis://127.0.0.1:6379/0.

    ValueError for an address that is none. Nothing is asked before the first call. Bytes that are not ours count as no
    session, which is then deleted, and in `n_unreadable`.
    """

    name = "redis"

    def __init__(self, url: str, limits: StoreLimits | None = None) -> None:
        self.limits = limits or StoreLimits()
        connections = redis.ConnectionPool.from_url(url, socket_timeout=TIMEOUT_S, socket_connect_timeout=TIMEOUT_S)
        # One connection, since one event loop asks; redis-py's `Redis` around it would take as long again.
        self._connection: Any = connections.make_connection()
        kept = self.limits
        self._limits = (
            max(1, round(1e3 * kept.idle_s)),
            round(1e3 * kept.least_idle_s),
            kept.n_sessions,
            kept.n_positions,
            kept.n_positions_of_session,
        )
        self._sessions: OrderedDict[str, Session] = OrderedDict()
        self._positions: OrderedDict[tuple[str, str], SeenPosition] = OrderedDict()
        self._silent_until_s = 0.0
        self.n_unreadable = 0

    def add(self, session: Session) -> None:
        if self._run("add", session.id, session.owner, session_to_bytes(session)) == b"full":
            raise StoreFull(f"{self.limits.n_sessions} sessions are open")

    def session(self, session_id: str, *, is_fresh: bool = True) -> Session | None:
        session = None if is_fresh else self._sessions.get(session_id)
        if session is None:
            stored = self._run("session", session_id)
            session = None if stored is None else self._read(session_id, session_from_bytes, session_id, stored)
        _remember(self._sessions, session_id, session)
        return session

    def replace(self, session: Session, before: Session) -> bool:
        new, was = session_to_bytes(session), session_to_bytes(before)
        return self._run("replace", session.id, "", new, was) != b"overtaken"

    def delete(self, session_id: str) -> None:
        self._run("delete", session_id)

    def owned_by(self, token: str) -> list[Session]:
        stored = self._run("owned_by", "", hash_of(token))
        ids = [one.decode() for one in stored[::2]]
        read = [self._read(one, session_from_bytes, one, kept) for one, kept in zip(ids, stored[1::2], strict=True)]
        owned = [session for session in read if session is not None and session.is_owned_by(token)]
        return sorted(owned, key=lambda session: session.created_s)

    def position(self, session_id: str, name: str) -> SeenPosition | None:
        seen = self._positions.get((session_id, name))
        if seen is None:
            stored = self._run("position", session_id, _field(name))
            seen = None if stored is None else self._read(session_id, position_from_bytes, stored)
        _remember(self._positions, (session_id, name), seen)
        return seen

    def positions(self, session_id: str) -> dict[str, SeenPosition]:
        stored = self._run("positions", session_id) or []
        fields = [pair for pair in zip(stored[::2], stored[1::2], strict=True) if pair[0].startswith(_POSITION)]
        return self._read(session_id, _positions_from, fields) or {}

    def put_position(self, session_id: str, name: str, seen: SeenPosition, before: SeenPosition | None) -> bool:
        was = b"" if before is None else mark_bytes(before)
        said = self._run("put_position", session_id, _field(name), position_to_bytes(seen), was)
        _remember(self._positions, (session_id, name), seen if said == b"kept" else None)
        if said is None:
            _remember(self._sessions, session_id, None)
            raise SessionGone
        if said == b"session is full":
            raise SessionFull(f"a session has {self.limits.n_positions_of_session} positions at most")
        if said == b"full":
            raise StoreFull(f"{self.limits.n_positions} positions are known")
        return said != b"overtaken"

    def delete_position(self, session_id: str, name: str) -> bool:
        _remember(self._positions, (session_id, name), None)
        return bool(self._run("delete_position", session_id, _field(name)))

    def counts(self) -> tuple[int, int]:
        n_sessions, n_positions = self._run("counts")
        return n_sessions, n_positions

    def keeps_a_file(self) -> bool:
        """Whether what it holds outlives it: its append-only file is on."""
        return b"aof_enabled:1" in self._asked("INFO", "persistence")

    def check(self) -> None:
        # Which changes nothing, and is refused where nothing may be written, unlike PING.
        self._asked("HDEL", "xihe:1:sizes", "")

    def close(self) -> None:
        self._connection.disconnect()

    def _run(
        self, script: str, session_id: str = "", field: str | bytes = "", new: bytes = b"", before: Any = ""
    ) -> Any:
        """What the script answers; None for a session that cannot be, since its id is none."""
        if session_id and not _ID.fullmatch(session_id):
            return None
        arguments = (0, session_id, *self._limits, field, new, before)
        try:
            try:
                return self._asked("EVALSHA", _HASHES[script], *arguments)
            except redis.exceptions.NoScriptError:  # It is new to this Redis, which keeps it from here on.
                return self._asked("EVAL", _SHARED + _SCRIPTS[script], *arguments)
        except redis.OutOfMemoryError:
            raise StoreFull("the store's memory is full") from None
        except _WrongType:
            self._forget_unreadable(session_id)
            return None

    def _asked(self, *command: Any) -> Any:
        if time.monotonic() < self._silent_until_s:
            raise StoreLost(LOST)
        try:
            try:
                return self._answer(command)
            except redis.ConnectionError:  # Once more, so that a store that was restarted costs no request.
                return self._answer(command)
        except (redis.exceptions.NoScriptError, redis.OutOfMemoryError):
            raise
        except redis.RedisError as error:
            if "WRONGTYPE" in str(error):
                raise _WrongType from None
            self._silent_until_s = time.monotonic() + PAUSE_S
            is_refused = isinstance(error, redis.ResponseError)
            raise StoreLost(REFUSES if is_refused else LOST) from error

    def _answer(self, command: tuple[Any, ...]) -> Any:
        """A connection that is not there is made, and one that failed is closed."""
        self._connection.send_command(*command)
        return self._connection.read_response()

    def _read(self, session_id: str, read: Callable[..., Read], *stored: Any) -> Read | None:
        try:
            return read(*stored)
        except ValueError:
            self._forget_unreadable(session_id)
            return None

    def _forget_unreadable(self, session_id: str) -> None:
        self.n_unreadable += 1
        self._asked("DEL", f"xihe:1:session:{session_id}")


def _remember(memory: OrderedDict[Key, Read], key: Key, value: Read | None) -> None:
    """As what was used last; None forgets."""
    memory.pop(key, None)
    if value is not None:
        memory[key] = value
    if len(memory) > MOST_REMEMBERED:
        memory.popitem(last=False)


def _field(name: str) -> bytes:
    return _POSITION + name.encode()


def _positions_from(fields: list[tuple[bytes, bytes]]) -> dict[str, SeenPosition]:
    return {name[len(_POSITION) :].decode(): position_from_bytes(stored) for name, stored in fields}
