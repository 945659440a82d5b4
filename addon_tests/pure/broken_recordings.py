"""What may be wrong with a recording, by format: how it is done to one that is sound, and what is said of it.

Of readers that formats share, each format shows that it asks them. What they refuse is shown once: of JSON in
`test_json_records.py`, of images, numbers, sizes and matrices in `test_frame_files.py`, of quaternions and places by
Record3D.

A case is a function that changes the recording and a text: of the one line on stderr, or, after "note: ", of what is
said of one that is read all the same; "read" where nothing is said.
"""

import json
import shutil
import zipfile

import numpy as np
from PIL import Image

from addon_tests.pure.recordings import (
    SMALL,
    as_nerfstudio,
    as_plain,
    as_polycam,
    as_record3d,
    as_seven_scenes,
    as_stray_of_one_camera,
    as_tum,
    walk,
)
from xihenet.io.exr import exr_attributes, read_exr, write_exr
from xihenet.io.recording import SessionRecorder
from xihenet.records import Intrinsics

READ, NOTE = "read", "note: "
GARBAGE = bytes(range(256)) * 4
MIRRORED = np.diag([-1.0, 1, 1, 1])


def put(name, content):
    """A file of the recording with other content."""

    def harm(path):
        target = path / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if isinstance(content, bytes):
            target.write_bytes(content)
        else:
            target.write_text(content)

    return harm


def remove(name):
    return lambda path: (path / name).unlink()


def cut(name, n=None):
    def harm(path):
        whole = (path / name).read_bytes()
        (path / name).write_bytes(whole[: len(whole) // 2 if n is None else n])

    return harm


def folder_in_place_of(name):
    def harm(path):
        (path / name).unlink()
        (path / name).mkdir()

    return harm


def without_none(entries):
    return {name: value for name, value in entries.items() if value is not None}


def with_entries(name, **entries):
    """JSON in which entries of an object are others; None leaves one out."""

    def harm(path):
        content = {**json.loads((path / name).read_text()), **entries}
        (path / name).write_text(json.dumps(without_none(content)))

    return harm


def picture(name, pixels):
    return lambda path: Image.fromarray(pixels).save(path / name)


def other_units(name):
    """Metres where millimetres are expected: all is a thousand times nearer."""

    def harm(path):
        units = np.asarray(Image.open(path / name))
        Image.fromarray(np.maximum(1, units // 1000).astype(np.uint16)).save(path / name)

    return harm


def wired(colour, plane_depth, confidence=None, missing="without colour or depth left out"):
    """Whether pictures that are files are read at all, and missing ones noted."""
    cases = {
        "colour is garbage": (put(colour, GARBAGE), "expected an image"),
        "colour is a folder": (folder_in_place_of(colour), NOTE + missing),
        "depth is garbage": (put(plane_depth, GARBAGE), "expected an image"),
        "depth is missing": (remove(plane_depth), NOTE + missing),
    }
    if confidence:
        cases |= {
            "confidence is garbage": (put(confidence, GARBAGE), "expected an image"),
            "confidence is missing": (remove(confidence), NOTE + "1 frame has no confidence: all of its depth is used"),
        }
    return cases


def of_pictures(colour, plane_depth, confidence=None):
    """What may be wrong with pictures, asked of one format for each of the two readers that all formats share.

    They are 48 pixels high, 64 wide.
    """
    sideways = picture(plane_depth, np.ones((64, 48), np.uint16))
    cases = wired(colour, plane_depth, confidence) | {
        "colour of another field": (picture(colour, np.zeros((64, 48, 3), np.uint8)), "the same ratio"),
        "depth of 8 bits": (picture(plane_depth, np.ones((48, 64), np.uint8)), "a grey image of 16 bits"),
        "depth of another field": (sideways, "expected 48x64, as depth has" if confidence else "the same ratio"),
        "depth of another unit": (other_units(plane_depth), READ),
    }
    if confidence:
        cases |= {
            "confidence of another size": (picture(confidence, np.ones((24, 32), np.uint8)), "as depth has"),
            "confidence in colour": (picture(confidence, np.ones((48, 64, 3), np.uint8)), "a grey image of 8 bits"),
        }
    return cases


# ---------------------------------------------------------------------------------------------------------- Record3D


def member(name, content):
    """A member of the .r3d with other content, a function of what it had, or None for none."""

    def harm(path):
        with zipfile.ZipFile(path) as file:
            members = {one: file.read(one) for one in file.namelist()}
        if callable(content):
            members[name] = content(members[name])
        else:
            members[name] = content
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
            for one, stored in members.items():
                if stored is not None:
                    file.writestr(one, stored)

    return harm


def metadata(**entries):
    def changed(content):
        return json.dumps(without_none({**json.loads(content), **entries}))

    return member("metadata", changed)


def in_metadata(name, n, value):
    """One entry of a list, such as a pose."""

    def changed(content):
        loaded = json.loads(content)
        loaded[name][n] = value
        return json.dumps(loaded)

    return member("metadata", changed)


def whole(change):
    """The bytes of the file, changed."""
    return lambda path: path.write_bytes(change(path.read_bytes()))


def marked_encrypted(content):
    """Every member of the central directory has the flag of encryption."""
    at, marked = content.find(b"PK\x01\x02"), bytearray(content)
    while at >= 0:
        marked[at + 8] |= 1
        at = content.find(b"PK\x01\x02", at + 4)
    return bytes(marked)


def packed(content):
    """LZFSE."""

    def of(_):
        import lzfse

        return lzfse.compress(content)

    return of


DEPTH, CONF = "rgbd/1.depth", "rgbd/1.conf"
RECORD3D = {
    "garbage": (whole(lambda _: GARBAGE), "no whole zip file"),
    "cut short": (whole(lambda content: content[: len(content) // 2]), "no whole zip file"),
    "a broken member": (whole(lambda c: c.replace(b"bvx2", b"XXXX", 1)), "cannot be read"),
    "another zip": (member("metadata", None), "if another app made it, unpack the zip"),
    "metadata begins with a byte order mark": (member("metadata", lambda said: b"\xef\xbb\xbf" + said), READ),
    "metadata is no JSON": (member("metadata", GARBAGE), "expected JSON"),
    "metadata is a list": (member("metadata", b"[]"), "expected a JSON object"),
    "metadata is a bomb": (member("metadata", bytes(2**26 + 1)), "expected at most"),
    "LZFSE is a bomb": (member(DEPTH, packed(bytes(2**23))), "unpacks to more than"),
    "encrypted": (whole(marked_encrypted), "cannot be read"),
    "a pose that is NaN": (
        in_metadata("poses", 1, [float("nan")] * 7),
        NOTE + "1 frame without colour, depth or a pose",
    ),
    "neither a pose nor intrinsics": (
        lambda path: [
            in_metadata(name, 1, values)(path)
            for name, values in (("poses", [float("nan")] * 7), ("perFrameIntrinsicCoeffs", [0.0] * 4))
        ],
        NOTE + "1 frame without colour, depth or a pose",
    ),
    "poses that are all NaN": (metadata(poses=[[float("nan")] * 7] * 3), "no frame has colour, depth and a pose"),
    "a pose that is text": (in_metadata("poses", 1, ["x"] * 7), "poses, frame 1: expected 7 numbers"),
    "a pose of six numbers": (in_metadata("poses", 1, [0.0] * 6), "poses, frame 1: expected 7 numbers"),
    "a quaternion of zeros": (in_metadata("poses", 1, [0.0] * 7), "poses, frame 1: expected a quaternion"),
    "a quaternion that is huge": (in_metadata("poses", 1, [1e300] * 4 + [0.0] * 3), "a quaternion of length 1"),
    "a place that is huge": (in_metadata("poses", 1, [0, 0, 0, 1, 1e300, 0, 0]), "within 1e+06 m"),
    "no poses": (metadata(poses=[]), "record with LiDAR"),
    "poses of the face sensor": (
        metadata(poses=[[0, 0, 0, 1, 0, 0, 0]] * 3, initPose=[0, 0, 0, 1, 0, 0, 0]),
        NOTE + "No pose turns or moves, as where Record3D has none: record with LiDAR",
    ),
    "poses are not there": (metadata(poses=None), "record with LiDAR"),
    "poses are an object": (metadata(poses={}), "poses: expected a list"),
    "a start of zeros": (metadata(initPose=[0] * 7), "a quaternion of length 1"),
    "a negative width": (metadata(w=-256), "w: expected a whole number of pixels"),
    "a depth that is huge": (metadata(dw=1e6, dh=1e6), "more than are read"),
    "no intrinsics": (metadata(K=None, perFrameIntrinsicCoeffs=None), "K: expected 9 numbers"),
    "intrinsics of too few": (metadata(perFrameIntrinsicCoeffs=[[99, 99, 128, 96]] * 2), NOTE + "1 frame without"),
    "times of too few": (metadata(frameTimestamps=[0.0]), NOTE + "2 frames without"),
    "times that are text": (metadata(frameTimestamps="soon"), "frameTimestamps: expected"),
    "no frames a second": (metadata(frameTimestamps=None, fps=0), "fps: expected"),
    "no depth at all": (lambda path: [member(f"rgbd/{n}.depth", None)(path) for n in range(3)], "record with LiDAR"),
    "depth is garbage": (member(DEPTH, GARBAGE), "expected LZFSE"),
    "depth is empty": (member(DEPTH, b""), "expected LZFSE"),
    "depth is cut short": (member(DEPTH, lambda content: content[:-50]), "expected LZFSE"),
    "depth of another size": (member(DEPTH, packed(bytes(400))), "expected 64x48 distances"),
    "confidence is garbage": (member(CONF, GARBAGE), "expected LZFSE"),
    "confidence of another size": (member(CONF, packed(bytes(400))), "expected 64x48 bytes"),
    "colour is garbage": (member("rgbd/1.jpg", GARBAGE), "expected an image"),
    "colour that lies otherwise": (metadata(w=192, h=256, dw=48, dh=64), "the same ratio"),
    "depth said otherwise": (metadata(dw=48, dh=64), NOTE + "is taken as 64x48, since colour lies so"),
    "no size of depth": (metadata(dw=None, dh=None), READ),
    "one K for all": (metadata(perFrameIntrinsicCoeffs=None), READ),
    "colour is missing": (member("rgbd/1.jpg", None), NOTE + "1 frame without colour, depth or a pose"),
    "depth is missing": (member(DEPTH, None), NOTE + "1 frame without colour, depth or a pose"),
    "confidence is missing": (member(CONF, None), NOTE + "1 frame has no confidence: all of its depth is used"),
    "K row by row": (
        metadata(perFrameIntrinsicCoeffs=None, K=[160, 0, 128, 0, 160, 96, 0, 0, 1]),
        NOTE + "In 3 frames the principal point lies at the edge of the picture or outside of it, at 0, 0 of 256x192 "
        "pixels: check cx and cy, and that K is stored column by column.",
    ),
    "times that go back": (metadata(frameTimestamps=[5.0, 4.0, 6.0]), NOTE + "Times go back once"),
    "milliseconds": (metadata(frameTimestamps=[0, 33, 67]), NOTE + "though a picture comes every 33.5 s"),
    "times that are not known": (metadata(frameTimestamps=None), READ),
    "depth in millimetres": (member(DEPTH, packed(np.full(64 * 48, 2000, "<f4").tobytes())), READ),
    "depth beyond all numbers": (member(DEPTH, packed(np.full(64 * 48, np.inf, "<f4").tobytes())), READ),
    "up is not known": (metadata(initPose=None), NOTE + "Which way is up is not given"),
}

# ------------------------------------------------------------------------------------------------------ Stray Scanner

VIDEO, ODOMETRY, MATRIX = "rgb.mp4", "odometry.csv", "camera_matrix.csv"
HEAD = "timestamp, frame, x, y, z, qx, qy, qz, qw\n"


def another_codec(path):
    content = (path / VIDEO).read_bytes()
    assert any(name in content for name in (b"hev1", b"hvc1", b"avc1"))
    for name in (b"hev1", b"hvc1", b"avc1"):
        content = content.replace(name, b"zzzz")
    (path / VIDEO).write_bytes(content)


def video_that_ends(path):
    """Of six pictures, and the header comes first, as for streaming; half of the last one is not there any more."""
    shutil.rmtree(path)
    as_stray_of_one_camera(path, walk(SMALL, 6))
    move_header_to_the_start(path / VIDEO)
    cut(VIDEO, -10)(path)


def move_header_to_the_start(path):
    import av

    beside = path.with_suffix(".part.mp4")
    with av.open(str(path)) as video, av.open(str(beside), "w", options={"movflags": "faststart"}) as out:
        stream = out.add_stream_from_template(video.streams.video[0])
        for packet in video.demux(video.streams.video[0]):
            if packet.size:
                packet.stream = stream
                out.mux(packet)
    beside.replace(path)


def npy(content):
    def harm(path):
        (path / "depth/000001.png").unlink()
        if isinstance(content, bytes):
            (path / "depth/000001.npy").write_bytes(content)
        else:
            np.save(path / "depth/000001.npy", content, allow_pickle=True)

    return harm


def odometry(*lines):
    return put(ODOMETRY, HEAD + "\n".join(lines) + "\n")


OLDEST = "x, y, z, qx, qy, qz, qw"
POSED = "0, 0, 0, 0, 0, 0, 1"
NPY_THAT_SAYS = b"\x93NUMPY\x01\x00\x76\x00" + (
    b"{'descr': '<u2', 'fortran_order': False, 'shape': (1000000000, 1000000000), }".ljust(117) + b"\n"
)
STRAY = {
    **{
        case: how
        for case, how in wired("depth/000001.png", "depth/000001.png", "confidence/000001.png").items()
        if not case.startswith("colour")
    },
    "the video is garbage": (put(VIDEO, GARBAGE), "expected a video"),
    "the video is a list of others": (put(VIDEO, "#EXTM3U\n#EXTINF:1,\nfile:///etc/passwd\n"), "expected a video"),
    "the video is cut short": (cut(VIDEO), "expected a video"),
    "the codec is not known": (another_codec, "its codec is not known"),
    "the video ends early": (video_that_ends, NOTE + "The video ends early, after 5 frames of 6"),
    "the video is missing": (remove(VIDEO), "no recording that is known"),
    "odometry is a folder": (folder_in_place_of(ODOMETRY), "no recording that is known"),
    "odometry is empty": (put(ODOMETRY, ""), "expected a line for each frame"),
    "odometry is only a head": (put(ODOMETRY, HEAD), "expected a line for each frame"),
    "odometry is garbage": (put(ODOMETRY, GARBAGE), "expected lines of numbers"),
    "a word": (odometry(f"0, 0, {POSED}", f"soon, 1, {POSED}"), "line 3: expected 9 numbers"),
    "NaN": (odometry("0, 0, nan, 0, 0, 0, 0, 0, 1"), "expected finite numbers"),
    "a quaternion of zeros": (
        odometry("0, 0, 0, 0, 0, 0, 0, 0, 0"),
        "frame 0: pose: expected a quaternion of length 1",
    ),
    "a short line": (odometry("0, 0, 0, 0"), "line 2: expected timestamp"),
    "a short line, of the oldest": (
        put(ODOMETRY, f"{OLDEST}\n0\n"),
        "expected x, y, z, qx, qy, qz, qw, got ['0']: copy",
    ),
    "a word, of the oldest": (put(ODOMETRY, f"{OLDEST}\n{POSED}\nsoon{POSED[1:]}\n"), "line 3: expected 7 numbers"),
    "a frame below 0": (odometry(f"0, -1, {POSED}"), "a number of a frame"),
    "half a frame": (odometry(f"0, 0.5, {POSED}"), "a number of a frame"),
    "a frame that comes twice": (odometry(f"0, 0, {POSED}", f"1, 0, {POSED}"), "some come twice"),
    "frames that are not there": (odometry(f"0, 70, {POSED}"), "no line of odometry.csv has depth"),
    "fewer lines than frames": (odometry(f"0, 1, {POSED}"), NOTE + "2 frames of the video without a line of odometry"),
    "more lines than frames": (odometry(f"0, 0, {POSED}", f"1, 9, {POSED}"), NOTE + "after 3 frames of 10"),
    "times that go back": (odometry(f"5, 0, {POSED}", f"4, 1, {POSED}"), NOTE + "Times go back once"),
    "intrinsics of two lines": (put(MATRIX, "1, 0, 1\n0, 1, 1\n"), "expected three lines"),
    "intrinsics that are text": (put(MATRIX, "a, b, c\n" * 3), "expected 3 numbers"),
    "intrinsics are missing": (remove(MATRIX), "cannot read"),
    "depth is pickled": (npy(np.array([[{}]], object)), "could not read it"),
    "depth that is empty, as .npy": (npy(b""), "could not read it"),
    "depth that says it is huge, as .npy": (npy(NPY_THAT_SAYS), "could not read it"),
    "depth with three axes": (npy(np.zeros((2, 2, 2))), "in rows and columns"),
    "depth that is text, as .npy": (npy(np.array([["far"]])), "in rows and columns"),
    "depth with numbers beyond all": (npy(np.full((48, 64), 1e300)), READ),
}

# ------------------------------------------------------------------------------------------------------------ Polycam

STEM = "60829420707"
CAMERA = f"keyframes/corrected_cameras/{STEM}.json"


def polycam(**entries):
    return with_entries(CAMERA, **entries)


def gone(name):
    """A folder with other a name."""
    return lambda path: (path / name).rename(path / f"{name}_of_old")


POLYCAM = {
    **of_pictures(
        f"keyframes/corrected_images/{STEM}.jpg", f"keyframes/depth/{STEM}.png", f"keyframes/confidence/{STEM}.png"
    ),
    "a camera is garbage": (put(CAMERA, GARBAGE), "expected JSON"),
    "a camera is a list": (put(CAMERA, "[]"), "expected a JSON object"),
    "a camera is a folder": (folder_in_place_of(CAMERA), NOTE + "1 frame without colour or depth"),
    "a camera is missing": (remove(CAMERA), READ),
    "a width below 0": (polycam(width=-1), "width: expected a whole number"),
    "half a pixel": (polycam(height=0.5), "height: expected a whole number"),
    "a pose that is NaN": (polycam(t_00=float("nan")), "t_00: expected a number"),
    "a huge place": (polycam(t_03=1e300), "within 1e+06 m"),
    "no depth": (gone("keyframes/depth"), "no camera has colour and depth"),
    "no pictures": (gone("keyframes/corrected_images"), "no camera has colour and depth"),
    "no cameras": (
        gone("keyframes"),
        "Convert other recordings to a plain folder: camera.json, colour/, depth/ and poses/",
    ),
    "names that are no times": (put("keyframes/corrected_cameras/thumb.json", "{}"), NOTE + "Times are not known"),
    "a name of many digits": (put(f"keyframes/corrected_cameras/{'9' * 99}.json", "{}"), NOTE + "Times are not known"),
}

# ------------------------------------------------------------------------------------------------------- plain folder

CAMERA_FILE, POSES = "camera.json", "poses.txt"


def plain(**entries):
    return with_entries(CAMERA_FILE, **entries)


PLAIN = {
    **wired("colour/2.png", "depth/2.png", "confidence/2.png", "without depth or a pose left out"),
    "colour is a folder": (folder_in_place_of("colour/2.png"), "expected a line for each of 2 pictures, got 3"),
    "the camera is a list": (put(CAMERA_FILE, "[]"), "expected a JSON object"),
    "the camera is garbage": (put(CAMERA_FILE, GARBAGE), "expected JSON"),
    "a width of other pictures": (plain(width=128), "depth/1.png: the intrinsics are for 128x48 pixels"),
    "a pose in the camera": (plain(world_from_camera=np.eye(4).tolist()), "there is no such key"),
    "a principal point in the corner": (plain(cx=0, cy=0), NOTE + "at 0, 0 of 64x48 pixels: check cx and cy."),
    "a principal point far away": (plain(cx=1e9), NOTE + "at 1e+09, 24 of 64x48 pixels: check cx and cy."),
    "a principal point that is shifted": (plain(cx=1, cy=47), READ),
    "units of 0": (plain(metres_per_unit=0), "expected positive numbers"),
    "units that are large": (plain(metres_per_unit=10), READ),
    "no frames a second": (plain(frames_per_second=0), "expected positive numbers"),
    "colour is empty": (
        lambda path: [one.unlink() for one in (path / "colour").iterdir()],
        "colour: expected pictures",
    ),
    "no poses": (gone(POSES), "no picture of colour/ has depth and a pose"),
    "poses are garbage": (put(POSES, b"\xff\xfe" + GARBAGE), "expected numbers as text"),
    "poses of another number": (put(POSES, "0 0 0 0 0 0 0 1\n"), "expected a line for each of 3"),
    "poses of nine numbers": (put(POSES, "1 2 3 4 5 6 7 8 9\n" * 3), "pose 1: expected 16 numbers with spaces"),
    "poses that are text": (put(POSES, "a b c d e f g h\n" * 3), "expected 8 numbers"),
    "poses that are NaN": (put(POSES, "0 0 0 nan 0 0 0 1\n" * 3), "expected finite numbers"),
    "a pose that is NaN": (
        put(POSES, "0 0 0 0 0 0 0 1\n1 nan nan nan nan nan nan nan\n2 0 0 0 0 0 0 1\n"),
        NOTE + "1 frame without depth or a pose left out",
    ),
    "a pose of minus infinity": (
        put(POSES, f"{'-inf ' * 16}\n" + "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n" * 2),
        NOTE + "1 frame without depth or a pose left out",
    ),
    "a time that is NaN": (put(POSES, "nan 0 0 0 0 0 0 1\n" * 3), "expected finite numbers"),
    "a pose that mirrors": (put(POSES, "-1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n" * 3), "pose of 1.png: "),
    "a quaternion of zeros": (
        put(POSES, "0 0 0 0 0 0 0 1\n" + "0 0 0 0 0 0 0 0\n" * 2),
        "pose 2: expected a quaternion",
    ),
    "times that go back": (put(POSES, "5 0 0 0 0 0 0 1\n4 0 0 0 0 0 0 1\n6 0 0 0 0 0 0 1\n"), NOTE + "Times go back"),
    "no times": (put(POSES, "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n" * 3), NOTE + "Times are not known"),
}

# ---------------------------------------------------------------------------------------- Nerfstudio, TUM and 7-Scenes

TRANSFORMS, TRUTH = "transforms.json", "groundtruth.txt"


def in_frames(n, **entries):
    """Other entries of the first `n` frames."""

    def harm(path):
        content = json.loads((path / TRANSFORMS).read_text())
        for frame in content["frames"][:n]:
            frame.update(entries)
        (path / TRANSFORMS).write_text(json.dumps(content))

    return harm


NERFSTUDIO = {
    **of_pictures("images/2.png", "depth/2.png"),
    "garbage": (put(TRANSFORMS, GARBAGE), "expected JSON"),
    "a list": (put(TRANSFORMS, "[]"), "expected frames"),
    "a scale of 0": (with_entries(TRANSFORMS, applied_scale=0), "applied_scale: expected a positive number"),
    "units of 0": (with_entries(TRANSFORMS, integer_depth_scale=0), "expected metres of a unit of depth, such as"),
    "units that are text": (with_entries(TRANSFORMS, depth_unit_scale_factor="mm"), "transforms.json: depth_unit"),
    "a fish-eye": (with_entries(TRANSFORMS, camera_model="OPENCV_FISHEYE"), "'OPENCV_FISHEYE' is no pinhole camera"),
    "a fish-eye of instant-ngp": (with_entries(TRANSFORMS, is_fisheye=True), "a fish-eye is no pinhole camera"),
    "no fish-eye": (with_entries(TRANSFORMS, is_fisheye=False), NOTE + "Times are not known"),
    "a panorama": (with_entries(TRANSFORMS, camera_model="EQUIRECTANGULAR"), "undistort the pictures"),
    "a camera of OpenCV": (with_entries(TRANSFORMS, camera_model="OPENCV"), NOTE + "Times are not known"),
    "a focal length that is text": (with_entries(TRANSFORMS, fl_x="40"), "fl_x: expected a number"),
    "half a pixel": (with_entries(TRANSFORMS, w=0.5), "w: expected a whole number of pixels"),
    "missing": (remove(TRANSFORMS), "no recording that is known"),
    "no frames": (with_entries(TRANSFORMS, frames=[]), "expected frames, a list with at least one"),
    "frames are no list": (with_entries(TRANSFORMS, frames={}), "expected frames"),
    "a frame is a number": (with_entries(TRANSFORMS, frames=[1]), "expected frames"),
    "no pose": (in_frames(1, transform_matrix=None), "frame 1"),
    "a pose that mirrors": (in_frames(1, transform_matrix=MIRRORED.tolist()), "frame 1"),
    "no colour": (in_frames(1, file_path=None), "file_path is missing"),
    "a picture elsewhere": (in_frames(1, file_path="../../etc/passwd"), "lies outside"),
    "no colour at all": (
        in_frames(3, file_path="images/elsewhere.png"),
        "no frame has both a file_path and a depth_file_path that are there, and the first has 'images/elsewhere.png'",
    ),
    "depth elsewhere": (in_frames(1, depth_file_path="/etc/passwd"), "lies outside"),
    "no depth at all": (in_frames(3, depth_file_path=None), "and no name of depth: record with depth"),
}
TUM = {
    **wired("rgb/0.033333.png", "depth/0.033333.png", missing="without colour, depth or a pose left out"),
    "no poses near": (put(TRUTH, "99 0 0 0 0 0 0 1\n"), "no colour picture has depth and a pose"),
    "poses are garbage": (put(TRUTH, GARBAGE), "expected lines of a time"),
    "a pose that is NaN": (
        put(TRUTH, f"0 0 0 0 0 0 0 1\n0.0333 {'nan ' * 7}\n0.0667 0 0 0 0 0 0 1\n"),
        NOTE + "1 frame without colour, depth or a pose left out",
    ),
    "a quaternion of zeros": (put(TRUTH, "0 0 0 0 0 0 0 0\n"), "groundtruth.txt: pose at 0 s: expected a quaternion"),
    "a list is a folder": (folder_in_place_of("rgb.txt"), "no recording that is known"),
    "a short line": (put(TRUTH, "# short\n1 2 3\n"), "line 2: expected lines of a time and 7 more"),
    "the only pose is NaN": (put(TRUTH, "1 0 0 0 0 0 0 nan\n"), "tracking was lost in all lines"),
    "no picture": (put("rgb.txt", "# nothing\n"), "expected lines of a time and 1 more"),
    "a time that is text": (put("rgb.txt", "soon rgb/1.png\n"), "got ['soon']"),
    "a picture elsewhere": (put("rgb.txt", "0.0 ../../x.png\n"), "lies outside"),
    "no depth near": (put("depth.txt", "5 depth/1.png\n"), "no colour picture has depth and a pose"),
}
POSE = "frame-000002.pose.txt"
SEVEN_SCENES = {
    **wired("frame-000002.color.png", "frame-000002.depth.png"),
    "a pose is empty": (put(POSE, ""), "expected four rows"),
    "a pose is garbage": (put(POSE, b"\xff\xfe" + GARBAGE), POSE),
    "a pose that is text": (put(POSE, "x " * 16), POSE),
    "a pose is NaN": (put(POSE, "nan nan nan nan\n" * 4), "expected finite numbers"),
    "a pose is missing": (remove(POSE), READ),
    "JPEGs, as 3RScan has them": (
        lambda path: [one.rename(one.with_suffix(".jpg")) for one in path.glob("*.color.png")],
        ".depth.png, beside it: copy all files, or convert the recording to a plain folder",
    ),
}

# -------------------------------------------------------------------------------------------------------- our sessions

SESSION, FRAME = "session.json", "frame_000001.exr"


def in_header(**entries):
    """What the second frame's header says; None leaves an entry out."""

    def harm(folder):
        said = {**exr_attributes(folder / FRAME), **entries}
        write_exr(folder / FRAME, read_exr(folder / FRAME), attributes=without_none(said))

    return harm


def channels(**entries):
    def harm(folder):
        found = {**read_exr(folder / FRAME), **entries}
        write_exr(folder / FRAME, without_none(found), attributes=exr_attributes(folder / FRAME))

    return harm


def as_session(folder, frames):
    recorder = SessionRecorder(folder)
    for frame in frames:
        recorder.record(frame)
    return folder


def no_frames(folder):
    for path in folder.glob("*.exr"):
        path.unlink()


XIHE = {
    "no JSON": (put(SESSION, "{"), "session.json"),
    "a list": (put(SESSION, "[]"), "expected a JSON object"),
    "another format": (with_entries(SESSION, format="other"), "expected a JSON object with format"),
    "a later version": (with_entries(SESSION, version=2), "version: expected 1, got 2"),
    "a negative exposure": (
        with_entries(SESSION, reference_exposure=-1),
        "reference_exposure: expected a positive factor",
    ),
    "a trigger of words": (with_entries(SESSION, trigger={"magic": 1}), "session.json"),
    "files that are no list": (with_entries(SESSION, files="frame.exr"), "files: expected a list of texts"),
    "a file elsewhere": (with_entries(SESSION, files=["../x.exr"]), "lies outside"),
    "a file that is not there": (with_entries(SESSION, files=["frame_000009.exr"]), "frame_000009.exr"),
    "no frames": (no_frames, "record again"),
    "a frame between is gone": (remove(FRAME), NOTE + "1 frame missing between the others"),
    "half a header": (cut(FRAME, 60), FRAME),
    "a frame cut short": (cut(FRAME, 900), FRAME),
    "a folder for a frame": (folder_in_place_of(FRAME), FRAME),
    "a NaN pose": (in_header(worldFromCamera=np.full((4, 4), np.nan)), "worldFromCamera: expected finite numbers"),
    "a left-handed pose": (in_header(worldFromCamera=MIRRORED), "it mirrors"),
    "no pose": (in_header(worldFromCamera=None), "worldFromCamera"),
    "a pose of words": (in_header(worldFromCamera="here"), "worldFromCamera"),
    "no focal length": (in_header(fx=None), "fx"),
    "no exposure": (in_header(exposure=0.0), "exposure"),
    "time that is NaN": (in_header(time=float("nan")), "time: expected a finite number"),
    "a white balance of 0": (in_header(whiteBalance=np.zeros(3)), "white_balance"),
    "no depth": (channels(Z=None), FRAME),
    "no red": (channels(R=None), FRAME),
    "a NaN colour": (channels(G=np.full((24, 32), np.nan, np.float32)), "a colour is NaN"),
}

SMALL_TUM = Intrinsics(64, 48, 52.5, 52.5, 32.0, 24.0)
SMALL_SCENES = Intrinsics(64, 48, 58.5, 58.5, 32.0, 24.0)
FORMATS = {
    "Record3D": (as_record3d, SMALL, RECORD3D),
    "Stray Scanner": (as_stray_of_one_camera, SMALL, STRAY),
    "Polycam": (as_polycam, SMALL, POLYCAM),
    "plain folder": (as_plain, SMALL, PLAIN),
    "Nerfstudio": (as_nerfstudio, SMALL, NERFSTUDIO),
    "TUM RGB-D": (as_tum, SMALL_TUM, TUM),
    "7-Scenes": (as_seven_scenes, SMALL_SCENES, SEVEN_SCENES),
    "Xihe session": (as_session, Intrinsics(32, 24, 20.0, 20.0, 16.0, 12.0), XIHE),
}
"""What writes a sound recording of each format, intrinsics for its pictures, and cases."""
