"""OpenEXR by NumPy and zlib: what is written comes back, the OpenEXR package agrees, broken files are refused."""

import struct

import numpy as np
import pytest

from addon_tests.pure.frame_makers import NEEDS_OPENEXR
from xihenet.io import exr
from xihenet.io.exr import OtherExr, exr_attributes, exr_sizes, read_exr, read_stored_exr, write_exr
from xihenet.io.picture_size import picked_pixels

KINDS = (np.float32, np.float16, np.uint32)
LONG_NAME = "A view layer with a name longer than short names may be.Combined.R"
COMPRESSION = b"compression\0compression\0\1\0\0\0"
NASTY = [np.nan, np.inf, -np.inf, -0.0, 1e-45, 3.4e38, 65504.0, 1e10]


def noise(seed, size, kind=np.float32):
    generator = np.random.default_rng(seed)
    if kind == np.uint32:
        return generator.integers(0, 2**32, size, np.uint32)
    values = generator.normal(0, 100, size)
    values.flat[: len(NASTY)] = NASTY[: values.size]
    with np.errstate(over="ignore", under="ignore"):  # What a half float cannot hold is part of the noise.
        return values.astype(kind)


def picture(seed, height, width):
    """Channels of all types, one of them smooth, so that ZIP stores some chunks deflated and others as they are."""
    channels = {f"Layer.{kind.__name__}": noise(seed, (height, width), kind) for kind in KINDS}
    smooth = np.linspace(0, 1, height * width, dtype=np.float32).reshape(height, width)
    return channels | {LONG_NAME: smooth, "R": noise(seed + 1, (height, width)), "flat": np.zeros_like(smooth)}


def assert_equal(back, channels):
    assert sorted(back) == sorted(channels)
    for name, values in channels.items():
        assert back[name].dtype == np.float32
        np.testing.assert_array_equal(back[name], values.astype(np.float32), err_msg=name)


FORMS = pytest.mark.parametrize("compression", ["none", "ZIPS", "ZIP"])


@FORMS
@pytest.mark.parametrize("size", [(1, 1), (1, 7), (16, 3), (17, 5), (33, 64), (600, 3)])
def test_what_is_written_comes_back(tmp_path, compression, size):
    channels = picture(3, *size)
    write_exr(tmp_path / "a.exr", channels, compression=compression, attributes={"time": 0.25})
    assert_equal(read_exr(tmp_path / "a.exr"), channels)
    said, stored = read_stored_exr(tmp_path / "a.exr")
    assert said == exr_attributes(tmp_path / "a.exr") and said["time"] == 0.25
    assert {name: values.dtype for name, values in stored.items()} == {name: v.dtype for name, v in channels.items()}
    assert_equal({name: values.astype(np.float32) for name, values in stored.items()}, channels)


def test_rows_without_compression_may_lie_anywhere(tmp_path):
    channels, n_rows = picture(8, 600, 5), 600
    write_exr(tmp_path / "a.exr", channels, compression="none")
    content = (tmp_path / "a.exr").read_bytes().replace(b"xiheCrc32\0", b"otherOne_\0")  # As other programs write it
    row_bytes = 8 + 5 * sum(values.itemsize for values in channels.values())
    start = len(content) - n_rows * row_bytes
    table = start - 8 * n_rows
    offsets = np.frombuffer(content, "<u8", n_rows, table)
    assert offsets[0] == start and (np.diff(offsets) == row_bytes).all()
    order = np.random.default_rng(2).permutation(n_rows)
    rows = b"".join(content[at : at + row_bytes] for at in offsets[order].tolist())
    (tmp_path / "b.exr").write_bytes(content[:table] + offsets[np.argsort(order)].tobytes() + rows)
    assert_equal(read_exr(tmp_path / "b.exr"), channels)
    (tmp_path / "b.exr").write_bytes(content[:table] + offsets[order].tobytes() + content[start:])
    with pytest.raises(ValueError, match=r"b\.exr: its pixels cannot be read"):
        read_exr(tmp_path / "b.exr")


@NEEDS_OPENEXR
@FORMS
@pytest.mark.parametrize("size", [(1, 1), (17, 5), (33, 64)])
def test_the_openexr_package_reads_what_is_written(tmp_path, compression, size):
    import OpenEXR

    channels = picture(4, *size)
    write_exr(tmp_path / "a.exr", channels, compression=compression)
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        back = {name: channel.pixels for name, channel in file.parts[0].channels.items()}
    assert {name: values.dtype for name, values in back.items()} == {name: v.dtype for name, v in channels.items()}
    assert_equal({name: values.astype(np.float32) for name, values in back.items()}, channels)


@NEEDS_OPENEXR
@pytest.mark.parametrize("compression", ["NO", "ZIPS", "ZIP"])
@pytest.mark.parametrize("n_parts", [1, 3])
@pytest.mark.parametrize("size", [(1, 1), (17, 5), (33, 64)])
def test_what_the_openexr_package_writes_is_read(tmp_path, compression, n_parts, size):
    import OpenEXR

    pictures = [picture(seed, *size) for seed in range(n_parts)]
    named = [{f"{index}.{name}": v for name, v in channels.items()} for index, channels in enumerate(pictures)]
    header = {"compression": getattr(OpenEXR, f"{compression}_COMPRESSION"), "type": OpenEXR.scanlineimage}
    parts = [OpenEXR.Part(dict(header), dict(channels), f"part {index}") for index, channels in enumerate(named)]
    with OpenEXR.File(parts) as file:
        file.write(str(tmp_path / "a.exr"))
    assert_equal(read_exr(tmp_path / "a.exr"), {name: v for channels in named for name, v in channels.items()})


@NEEDS_OPENEXR
def test_a_tiled_file_is_said_to_be_of_another_form(tmp_path):
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.tiledimage}
    header["tiles"] = OpenEXR.TileDescription()
    with OpenEXR.File(header, {"R": noise(0, (40, 40))}) as file:
        file.write(str(tmp_path / "a.exr"))
    with pytest.raises(OtherExr, match="tile"):
        read_exr(tmp_path / "a.exr")


def test_a_subsampled_channel_and_another_compression_are_of_another_form(tmp_path):
    write_exr(tmp_path / "a.exr", {"R": noise(0, (4, 4))})
    content = (tmp_path / "a.exr").read_bytes()
    sampling = content.index(b"R\0", 20) + 2 + 8
    for changed, said in (
        (content[:sampling] + struct.pack("<i", 2) + content[sampling + 4 :], "subsampled"),
        (content.replace(COMPRESSION + b"\3", COMPRESSION + b"\4"), "PIZ"),
        (content.replace(COMPRESSION + b"\3", COMPRESSION + b"\15"), "ZSTD"),
        (content.replace(COMPRESSION + b"\3", COMPRESSION + b"\77"), "number 63"),
    ):
        assert changed != content
        (tmp_path / "b.exr").write_bytes(changed)
        with pytest.raises(OtherExr, match=said):
            read_exr(tmp_path / "b.exr")
        assert exr_sizes(tmp_path / "b.exr") == {"R": (4, 4)}


@pytest.mark.parametrize("size", [(1, 7), (17, 5), (33, 64)])
@pytest.mark.parametrize("most_pixels", [1, 50, None])
def test_what_is_asked_for_is_what_all_of_it_holds_there(tmp_path, size, most_pixels):
    write_exr(tmp_path / "a.exr", picture(3, *size))
    whole = read_exr(tmp_path / "a.exr")
    asked = read_exr(tmp_path / "a.exr", {"R", LONG_NAME, "none"}, most_pixels=most_pixels)
    picked = np.ix_(*picked_pixels(*size, most_pixels))
    assert_equal(asked, {name: whole[name][picked] for name in ("R", LONG_NAME)})
    assert exr_sizes(tmp_path / "a.exr") == dict.fromkeys(whole, size)


@pytest.mark.parametrize("most", [1, 5, 100, None])
@pytest.mark.parametrize("size", [(1, 1), (1, 1000), (30, 40)])
def test_picked_pixels_are_few_enough_and_evenly_spaced(size, most):
    for n, picked in zip(size, picked_pixels(*size, most), strict=True):
        assert len(picked) == n or most is not None
        assert (picked >= 0).all() and (picked < n).all() and (np.diff(picked) > 0).all()
        assert np.ptp(np.diff(picked, prepend=-1 - picked[0], append=2 * n - 1 - picked[-1])) <= 2
    n_picked = np.prod([len(side) for side in picked_pixels(*size, most)])
    assert most is None or n_picked <= most or 1 in size


def test_rows_that_would_take_gigabytes_are_not_unpacked(tmp_path, monkeypatch):
    write_exr(tmp_path / "a.exr", {"R": np.zeros((64, 16384), np.float32)})
    monkeypatch.setattr(exr, "LARGEST_CHUNK", 2**20 - 1)
    with pytest.raises(ValueError, match=r"a\.exr: 16 of its rows take 1 MB: save fewer channels"):
        read_exr(tmp_path / "a.exr")


@FORMS
def test_a_file_that_is_cut_short_anywhere_is_refused(tmp_path, compression):
    write_exr(tmp_path / "a.exr", picture(5, 17, 4), compression=compression)
    content = (tmp_path / "a.exr").read_bytes()
    for length in range(0, len(content), 7):
        (tmp_path / "b.exr").write_bytes(content[:length])
        with pytest.raises(ValueError, match=r"b\.exr"):
            read_exr(tmp_path / "b.exr")


@pytest.mark.parametrize(
    "channels",
    [
        {},
        {"R": np.zeros((0, 3), np.float32)},
        {"R": np.zeros(3, np.float32)},
        {"R": np.zeros((2, 3), np.float32), "G": np.zeros((3, 2), np.float32)},
        {"R": np.zeros((2, 3))},
        {"R": np.zeros((2, 3), np.uint8)},
    ],
)
def test_what_is_no_picture_is_not_written(tmp_path, channels):
    with pytest.raises(ValueError, match="write_exr: expected"):
        write_exr(tmp_path / "a.exr", channels)
    assert not (tmp_path / "a.exr").exists()


def test_what_is_no_openexr_file_is_refused(tmp_path):
    (tmp_path / "a.exr").write_bytes(b"\x89PNG and more")
    with pytest.raises(ValueError, match="expected an OpenEXR file"):
        read_exr(tmp_path / "a.exr")


@pytest.mark.parametrize("compression", ["none", "ZIP"])
def test_a_nan_that_signals_is_read_as_any_other(tmp_path, compression):
    signalling = np.full((17, 5), 0x7F800001, np.uint32).view(np.float32)
    write_exr(tmp_path / "a.exr", {"R": signalling}, compression=compression)
    pixels = read_exr(tmp_path / "a.exr")["R"]
    assert np.isnan(pixels.astype(np.float64)).all()
