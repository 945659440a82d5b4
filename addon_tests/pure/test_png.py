"""PNG files that every reader understands."""

import zlib

import numpy as np
import pytest

from xihenet.io.png import SIGNATURE, encode_png, write_png


def decode_png(content):
    """A decoder for 8-bit RGB and RGBA with filters 0 and 1, written from the specification, and strict."""
    assert content.startswith(SIGNATURE)
    offset, chunks = len(SIGNATURE), {}
    while offset < len(content):
        size = int.from_bytes(content[offset : offset + 4], "big")
        kind, body = content[offset + 4 : offset + 8], content[offset + 8 : offset + 8 + size]
        assert zlib.crc32(kind + body) == int.from_bytes(content[offset + 8 + size : offset + 12 + size], "big")
        chunks[kind] = body
        offset += 12 + size
    channels = {2: 3, 6: 4}[chunks[b"IHDR"][9]]
    assert list(chunks)[-1] == b"IEND" and chunks[b"IHDR"][8] == 8 and chunks[b"IHDR"][10:] == bytes([0, 0, 0])
    width, height = (int.from_bytes(chunks[b"IHDR"][k : k + 4], "big") for k in (0, 4))
    rows = np.frombuffer(zlib.decompress(chunks[b"IDAT"]), np.uint8).reshape(height, 1 + channels * width)
    assert set(rows[:, 0]) <= {0, 1}
    pixels = rows[:, 1:].reshape(height, width, channels)
    filtered = rows[:, 0, None, None] == 1
    return np.where(filtered, np.cumsum(pixels, axis=1, dtype=np.uint64).astype(np.uint8), pixels)


@pytest.mark.parametrize("channels", [3, 4])
@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (5, 1), (48, 64)])
def test_pixels_come_back(shape, channels):
    pixels = np.random.default_rng(0).integers(0, 256, (*shape, channels), dtype=np.uint8)
    np.testing.assert_array_equal(decode_png(encode_png(pixels)), pixels)


def test_a_view_that_is_not_contiguous_comes_back(tmp_path):
    pixels = np.random.default_rng(1).integers(0, 256, (9, 8, 3), dtype=np.uint8)[::-1, ::2]
    write_png(tmp_path / "a.png", pixels)
    np.testing.assert_array_equal(decode_png((tmp_path / "a.png").read_bytes()), pixels)


@pytest.mark.parametrize("wrong", [np.zeros((4, 4, 3)), np.zeros((4, 4), np.uint8), np.zeros((0, 4, 3), np.uint8)])
def test_what_is_no_picture_is_refused(wrong):
    with pytest.raises(ValueError, match="expected uint8"):
        encode_png(wrong)
