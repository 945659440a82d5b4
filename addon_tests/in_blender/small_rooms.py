"""Rooms of the data set, small: as settings of a build, and as plans of which nothing is rendered."""

from xihe_blender.lab.rooms.build_room import build_room
from xihe_blender.lab.rooms.rooms import room_generator, sample_room
from xihe_blender.lab.rooms.settings import BuildSettings, RoomRenderSettings
from xihe_blender.lab.rooms.views import RoomRays, RoomTooFull, sample_positions, sample_views

SMALL = RoomRenderSettings((32, 24), 1, 16, 4, 16)


def small_build(n_rooms, seed=5, **settings):
    return BuildSettings(n_rooms, seed, 1, SMALL, **settings)


def places_of(index, **how):
    """A room of seed 11 without pictures: the room, its rays, positions and free views."""
    rng = room_generator(11, index)
    for _ in range(20):
        room = sample_room(rng, **how)
        rays = RoomRays.of(build_room(room))
        try:
            positions = sample_positions(rng, room, rays)
            return room, rays, positions, sample_views(rng, room, rays, positions)
        except RoomTooFull:
            continue
    raise AssertionError("no room with places in 20 draws")
