"""An AR session without Blender: the frames of one stored room, one after the other, and the light at one position.

    python docs/session_without_blender.py addon_tests/data/test_rooms/room_000033.npz

Replace `frames` by those of your own phone: colour, plane depth in metres, intrinsics and pose, in Blender's axes.
"""

import sys

import numpy as np

import xihenet


def frames(path):
    """The views of a stored room as `RgbdFrame`s; docs/rooms.md has the format."""
    with np.load(path) as room:
        width, height, *focal_and_centre = room["intrinsics"].tolist()
        camera = xihenet.Intrinsics(int(width), int(height), *focal_and_centre)
        views = zip(room["srgb_u8"], room["plane_depth_m"].astype(np.float32), room["world_from_camera"], strict=True)
        for srgb_u8, plane_depth_m, world_from_camera in views:
            yield xihenet.RgbdFrame(srgb_u8, plane_depth_m, camera, world_from_camera, float(room["exposure"]))


def main(path):
    with np.load(path) as room:
        position_m = room["positions_m"][room["is_in_view"].sum(axis=0).argmax()]
    estimator = xihenet.estimators.load("lattice", target="hdr")
    trigger = xihenet.TriggerSettings(theta=0.005, ignored_share=0.25)
    settings = xihenet.ControllerSettings(trigger, learns_out_of_view=True)
    session = xihenet.XiheController(xihenet.LocalBackend(estimator), settings)
    session.add_position("vase", position_m)
    for number, frame in enumerate(frames(path)):
        report = session.step(frame).get("vase")
        if report is None:
            print(f"frame {number}: the vase is not in view")
            continue
        print(f"frame {number}: {report.decision.reason}, {sum(report.stage_ms.values()):.1f} ms", end="")
        if report.estimate is not None:
            light = report.estimate.sh_radiance / report.estimate.exposure
            print(f", {report.estimate.coverage:.0%} seen, mean radiance {light[0] * 0.2820948}", end="")
        print()


if __name__ == "__main__":
    main(sys.argv[1])
