"""Rooms as data: what is sampled could stand in a house."""

import functools
import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from xihe_blender.lab.rooms.arrange import FLAT_M, blocks_hole, collide, zones
from xihe_blender.lab.rooms.light_plan import DARK
from xihe_blender.lab.rooms.outline import Outline, Rect, alcove_plan, box_plan, l_plan, turned
from xihe_blender.lab.rooms.room_data import Room
from xihe_blender.lab.rooms.rooms import BY_DAY, VARIED, is_chosen, room_generator, sample_room
from xihe_blender.lab.rooms.varied_rooms import CLUTTER, SIZES, sample_varied_room
from xihenet.training.rooms import split_of

N_SEEDS, N_VARIED, N_BY_DAY = 200, 60, 100
HANGING = ("picture", "mirror", "cupboard")
PLANS = [box_plan(4, 3), l_plan(5, 4, (2, 1.5)), alcove_plan(4, 3, (-1, 1), 0.8)]


@functools.cache
def usual_rooms() -> list[Room]:
    """Not drawn where tests are only collected, which every process does."""
    return [sample_room(room_generator(7, i)) for i in range(N_SEEDS)]


@functools.cache
def varied_rooms() -> list[Room]:
    return [sample_varied_room(room_generator(8, i)) for i in range(N_VARIED)]


@functools.cache
def by_day_rooms() -> list[Room]:
    return [sample_room(room_generator(7, i), by_day=True) for i in range(N_BY_DAY)]


def all_rooms() -> enumerate[Room]:
    """Usual ones, then varied ones, each with its number."""
    return enumerate(usual_rooms() + varied_rooms())


@pytest.mark.slow
def test_a_room_is_the_same_when_it_is_drawn_again_and_differs_from_others():
    assert [sample_room(room_generator(7, i)) for i in range(20)] == usual_rooms()[:20]
    assert [sample_varied_room(room_generator(8, i)) for i in range(5)] == varied_rooms()[:5]
    assert len({room.outline for room in usual_rooms()}) == N_SEEDS


def test_furniture_stands_inside_the_room():
    for i, room in all_rooms():
        for piece in room.pieces:
            assert room.outline.holds_rect(piece.footprint), f"{i}: {piece.kind}"
            assert piece.z >= 0, f"{i}: {piece.kind}"
            assert piece.top_m <= room.ceiling_at(piece.footprint.centre), f"{i}: {piece.kind}"


def test_pieces_do_not_overlap():
    for i, room in all_rooms():
        for one, other in itertools.combinations(room.pieces, 2):
            assert not collide(one, other), f"{i}: {one.kind} and {other.kind}"


def test_what_does_not_stand_on_the_floor_hangs_on_a_wall_or_lies_on_something():
    for i, room in all_rooms():
        for piece in room.pieces:
            if piece.z == 0 or piece.kind in HANGING:
                continue
            under = [p for p in room.pieces if p.top_m == piece.z and p.footprint.overlaps(piece.footprint)]
            assert under, f"{i}: {piece.kind} floats"


def test_what_hangs_touches_a_wall():
    for i, room in all_rooms():
        for piece in (p for p in room.pieces if p.kind in HANGING):
            assert not room.outline.holds_rect(piece.footprint.grown(0.05)), f"{i}: {piece.kind}"


def test_doors_can_be_opened():
    for i, room in all_rooms():
        doors = zones(room.outline, tuple(h for h in room.holes if h.is_door))
        for piece in (p for p in room.pieces if p.size[2] >= FLAT_M):
            assert not blocks_hole(piece, doors), f"{i}: {piece.kind}"


def test_openings_lie_within_their_walls_and_apart():
    for i, room in all_rooms():
        for hole in room.holes:
            assert 0 < hole.low < hole.high < room.outline.walls[hole.wall].length, i
            assert 0 <= hole.bottom < hole.top < room.height, i
        for one, other in itertools.combinations(room.holes, 2):
            assert one.wall != other.wall or one.high < other.low or other.high < one.low, i


def test_every_room_has_light():
    for i, room in all_rooms():
        has_window = any(not hole.is_door for hole in room.holes)
        has_lamp = any(lamp.watts > 0 for lamp in room.lamps)
        assert has_lamp or (has_window and room.daylight.strength > 0), i
        assert all(1400 <= lamp.kelvin <= 16000 for lamp in room.lamps if lamp.watts > 0), i


def test_lamps_hang_or_stand_inside_the_room():
    for i, room in all_rooms():
        for lamp in room.lamps:
            assert room.outline.holds((lamp.x, lamp.y)), f"{i}: {lamp.kind}"
            assert lamp.z <= room.ceiling_at((lamp.x, lamp.y)) + 1e-9, f"{i}: {lamp.kind}"


def test_all_shapes_and_hours_occur():
    corners = {len(room.outline.corners) for room in usual_rooms()}
    assert corners == {4, 6, 8}
    assert {len(room.slopes) for room in usual_rooms()} == {0, 1, 2}
    assert {room.regime for room in usual_rooms()} == {"day", "sunny", "mixed", "evening", "night"}
    assert len({room.kind for room in usual_rooms()}) == 8


@pytest.mark.slow
def test_half_of_the_rooms_by_day_have_a_sun_from_hazy_to_far_brighter_than_the_sky():
    suns = [room.daylight.sun for room in by_day_rooms() if room.windows]
    assert 0.4 < np.mean([sun is not None for sun in suns]) < 0.7
    irradiance = [sun.irradiance for sun in suns if sun is not None]
    assert min(irradiance) < 5 and max(irradiance) > 100, "W/m² where skies have a radiance of 0.8 to 14"


def test_varied_rooms_have_all_sizes_clutter_and_lamps_and_some_have_windows_alone():
    assert {room.kind for room in varied_rooms()} == {f"varied {kind}" for kind in SIZES}
    assert {piece.kind for room in varied_rooms() for piece in room.pieces} >= set(CLUTTER)
    assert {lamp.kind for room in varied_rooms() for lamp in room.lamps} >= {"spot", "strip", "bulb", "candle", "floor"}
    assert 5 < sum(not any(lamp.watts > 0 for lamp in room.lamps) for room in varied_rooms()) < 25
    assert max(len(room.pieces) for room in varied_rooms()) > 100


def test_some_varied_rooms_are_lit_by_large_and_dim_lights_alone():
    soft = [
        lit
        for room in varied_rooms()
        if (lit := [lamp for lamp in room.lamps if lamp.watts > 0])
        and all(lamp.kind == "uplight" or (lamp.kind == "panel" and lamp.size_m >= 1) for lamp in lit)
    ]
    assert len(soft) > 0.15 * len(varied_rooms())


@pytest.mark.parametrize("key", [VARIED, BY_DAY])
def test_training_rooms_alone_are_varied_or_by_day_and_a_larger_share_adds_to_a_smaller_one(key):
    none, few, many, every = ({i for i in range(500) if is_chosen(3, i, share, key)} for share in (0, 0.2, 0.5, 1))
    trained = {i for i in range(500) if split_of((3, i)) == "train"}
    assert not none and few < many < every == trained
    assert len(few) == pytest.approx(0.2 * len(trained), rel=0.25)
    assert many != {i for i in range(500) if is_chosen(3, i, 0.5, VARIED + BY_DAY - key)}


@pytest.mark.parametrize("plan", PLANS)
def test_a_plan_turned_by_a_quarter_keeps_its_area_and_what_it_holds(plan):
    points = np.random.default_rng(1).uniform(-3, 3, (200, 2))
    for quarters in range(5):
        other = turned(plan, quarters)
        assert other.area == pytest.approx(plan.area)
        c, s = [(1, 0), (0, 1), (-1, 0), (0, -1)][quarters % 4]
        for x, y in points.tolist():
            assert other.holds((c * x - s * y, s * x + c * y)) == plan.holds((x, y))


@given(plan=st.sampled_from(PLANS), x=st.floats(-3, 3), y=st.floats(-3, 3), w=st.floats(0.01, 4), d=st.floats(0.01, 4))
def test_a_plan_holds_a_rectangle_only_if_it_holds_points_all_over_it(plan, x, y, w, d):
    rect = Rect.around((x, y), (w, d))
    grid = itertools.product(np.linspace(rect.x0, rect.x1, 7)[1:-1], np.linspace(rect.y0, rect.y1, 7)[1:-1])
    if plan.holds_rect(rect):
        assert all(plan.holds(point) for point in grid)


def test_walls_look_outwards():
    for plan in PLANS:
        for wall in plan.walls:
            assert plan.holds(wall.point(wall.length / 2, 0.05))
            assert not plan.holds(wall.point(wall.length / 2, -0.05))


@pytest.mark.parametrize(
    "corners",
    [((0, 0), (1, 0), (1, 1)), ((0, 0), (0, 1), (1, 1), (1, 0)), ((0, 0), (2, 1), (2, 2), (0, 2))],
    ids=["three walls", "clockwise", "slanted"],
)
def test_a_plan_that_is_none_is_refused(corners):
    with pytest.raises(ValueError, match="Outline"):
        Outline(corners)


def test_a_room_by_day_is_the_same_room_with_its_lamps_off_and_one_without_windows_keeps_them():
    for usual, by_day in zip(usual_rooms()[:N_BY_DAY], by_day_rooms(), strict=True):
        assert (usual.pieces, usual.windows) == (by_day.pieces, by_day.windows)
        if by_day.windows:
            assert by_day.regime not in DARK and not any(lamp.watts for lamp in by_day.lamps)
        else:
            assert by_day == usual and any(lamp.watts for lamp in usual.lamps)
