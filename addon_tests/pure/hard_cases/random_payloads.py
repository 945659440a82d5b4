"""Random payloads for the wire, and whether what is read of them is what they say."""

import numpy as np

from addon_tests.pure.made import looked_at
from xihenet.codec import METHODS, EncodingMethod, decode_cloud, encode_cloud


def taken_for_something_else(given: tuple[int, EncodingMethod], seed: int = 2) -> int:
    """Of that many random payloads, how many are accepted and do not say what their cloud says."""
    rng = np.random.default_rng(seed)
    return sum(is_taken_for_something_else(random_payload(rng, given[1]), given[1]) for _ in range(given[0]))


def random_payload(rng: np.random.Generator, method: EncodingMethod, n: int = 40) -> bytes:
    """Bytes for `n` anchors: any, or records that are right but for some bytes."""
    size = METHODS[method].bytes_per_record
    n_records = min(int(rng.integers(0, 6)), n) if METHODS[method].is_stripped else n
    if rng.random() < 0.3:
        return rng.bytes(int(rng.integers(0, 130)))
    payload = np.zeros(n_records, METHODS[method].record)
    payload["distance_m"] = rng.random(n_records)
    if METHODS[method].is_stripped:
        payload["anchor"] = rng.permutation(n)[:n_records]
    changed = bytearray(payload.tobytes())
    for _ in range(int(rng.integers(0, 3)) if changed else 0):
        changed[int(rng.integers(len(changed)))] = int(rng.integers(256))
    assert len(changed) == n_records * size
    return bytes(changed)


def is_taken_for_something_else(payload: bytes, method: EncodingMethod, n: int = 40) -> bool:
    """An accepted payload must come back when its cloud is written: sorted, its zero distances raised or unset."""
    try:
        cloud = decode_cloud(payload, n, method)
    except ValueError as error:
        assert str(error).startswith("codec:")
        return False
    return len(looked_at(cloud)) != n or canonical(payload, method) != encode_cloud(cloud, method)


def canonical(payload: bytes, method: EncodingMethod) -> bytes:
    sent = np.frombuffer(payload, METHODS[method].record).copy()
    is_zero = sent["distance_m"] == 0
    sent["srgb"] = np.abs(sent["srgb"])  # -0 is 0
    if METHODS[method].is_stripped:
        sent = sent[np.argsort(sent["anchor"])]
        sent["distance_m"] = np.clip(sent["distance_m"], 2.0**-24, 65504)
    else:
        sent["srgb"][is_zero] = 0
        sent["distance_m"] = np.where(is_zero, 0, np.clip(sent["distance_m"], 2.0**-24, 65504))
    return sent.tobytes()
