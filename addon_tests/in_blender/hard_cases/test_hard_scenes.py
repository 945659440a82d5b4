"""Hard cases of scenes: what Blender lets a user build, from an object without faces to a lamp of NaN watts."""

import math

import pytest

from addon_tests.hard_case import case
from addon_tests.in_blender.hard_cases.broken_scenes import (
    add_block,
    add_empty_instance,
    add_mesh,
    add_shell,
    background,
    feed_panel,
    lamp_alone,
    lamp_that_breaks,
    move_all,
    move_vertex,
    no_light_threshold,
    no_world,
    paint_walls,
    panel,
    put,
    remove,
    scale_all,
    sky,
    to_phone,
    virtual_lamp,
)
from addon_tests.in_blender.hard_cases.outcome import believed, lit, previsualised, refused, same_light, says

STAGE = "blender"
AS_IT_IS = same_light("of the room as it is")
DARK = says("Neither the phone nor a light probe saw any light")
NEVER_SEEN = says("No virtual object was in view of the camera")
BEYOND_CLIPS = says("camera's clip range")
NAN_PLACE = (math.nan, 0, 0)

FLAT = [(0, 0, 0), (0.1, 0, 0), (0.2, 0, 0)]
FAN = [(0, 0, 0), (0.2, 0, 0), (0, 0.2, 0), (0, -0.2, 0), (0, 0, 0.2)]
FAN_FACES = [(0, 1, 2), (0, 1, 3), (0, 1, 4), (1, 0, 4)]

MESHES = [
    case(
        "a mesh without vertices, edges alone, faces without area and an instance of nothing change nothing",
        [add_mesh(), add_mesh(FLAT, [(0, 1)]), add_mesh(FLAT, (), [(0, 1, 2)]), add_empty_instance(is_virtual=False)],
        AS_IT_IS,
    ),
    case(
        "virtual, each of them is lit at its origin",
        [
            add_mesh(is_virtual=True),
            add_mesh(FLAT, [(0, 1)], is_virtual=True),
            add_mesh(FLAT, (), [(0, 1, 2)], is_virtual=True),
            add_empty_instance(is_virtual=True),
        ],
        lit(5),
    ),
    case(
        "a virtual object without faces alone shows nothing",
        [remove("Ball"), add_mesh(is_virtual=True)],
        says("showed nothing of a virt"),
    ),
    case("a room without any face has no surface", remove("Room", "Table", "Lamp"), says("showed no surface at all")),
    case("a virtual object inside another is lit as that", add_shell, lit(2)),
    case(
        "an estimation position inside a wall is named",
        add_block((0, 0, 0.85)),
        says("'Ball' saw no light where the phone did"),
    ),
    case("three faces on one edge, and one of them twice", add_mesh(FAN, (), FAN_FACES), lit()),
    *(
        case(
            f"a vertex of NaN in {where} is named", move_vertex(name, math.nan), says(f"vertices of mesh {name!r}", n=1)
        )
        for where, name in (("the room", "Table"), ("a virtual object", "Ball"))
    ),
    case("a vertex at the largest float in the room", move_vertex("Table", math.inf), lit()),
    case("an infinite virtual vertex is refused", move_vertex("Ball", math.inf), refused("'Ball' is 3.4e+38 x")),
    case("a virtual vertex 1e30 m away is refused", move_vertex("Ball", 1e30), refused("positions: make it smaller")),
]

PLACES = [
    case("a virtual object of no size shows nothing", put("Ball", scale=(0, 0, 0)), says("showed nothing of a virt")),
    case("a flat virtual object is lit", put("Ball", scale=(1, 0, 1)), lit()),
    case("a mirrored virtual object has the same light", put("Ball", scale=(-1, 1, 1)), AS_IT_IS),
    case("a virtual object turned inside out has the same light", put("Ball", scale=(-1, -1, -1)), AS_IT_IS),
    case("a long thin virtual object is lit along its length", put("Ball", scale=(5, 0.01, 1)), lit(2)),
    case("a virtual object of 24 m is refused", put("Ball", scale=(100, 100, 100)), refused("24 x 24 x 24 m")),
    case("a virtual object at NaN is refused", put("Ball", location=NAN_PLACE), refused("no finite position")),
    case("a virtual object 1e20 m away is named", put("Ball", location=(1e20, 0, 0)), says("have steps of")),
    case(
        "an object of no size in the room is not there",
        put("Table", scale=(0, 0, 0)),
        same_light("of the room without it", remove("Table")),
    ),
    case(
        "a mirrored object in the room is the same",
        put("Table", scale=(-1, 1, 1)),
        same_light("but for a ray's rounding", within=1e-3),
    ),
    case("a holdout in the room is named", put("Table", is_holdout=True), says("'Table': the phone does not see", n=1)),
    case(
        "a shadow catcher and a lamp that is a holdout are named",
        [put("Table", is_shadow_catcher=True), put("Lamp", is_holdout=True)],
        says("and 1 more: the phone does not see", n=2),
    ),
    case("an object at NaN in the room is named", put("Table", location=NAN_PLACE), says("'Table' has no finite")),
    case("a lamp at NaN is named", [lamp_alone(100.0), put("Bulb", location=NAN_PLACE)], says("'Bulb' has no finite")),
]

CAMERAS = [
    case("a camera at NaN is refused", put("Phone", location=NAN_PLACE), refused("'Phone' has no finite position")),
    case(
        "a camera turned by NaN is refused", put("Phone", rotation_euler=NAN_PLACE), refused("has no finite position")
    ),
    case("a mirrored camera sees the room", put("Phone", scale=(-1, 1, 1)), lit()),
    case("a camera inside a wall is named", add_block((-1.2, -1.5, 1.5)), says("is the camera inside an object?")),
    case("clip planes behind the room show nothing", put("Phone", clip_end=60, clip_start=50), BEYOND_CLIPS),
    case("clip planes before the room show nothing", put("Phone", clip_start=1e-6, clip_end=1e-3), BEYOND_CLIPS),
    case("clip planes the wrong way round show nothing", put("Phone", clip_start=10, clip_end=1), BEYOND_CLIPS),
    case("a camera at a lamp sees the room", [lamp_alone(100.0), to_phone("Bulb")], lit()),
    case("a camera inside a virtual object is told so", to_phone("Ball"), says("does its path lead through", n=1)),
    case("a camera that never sees a virtual object is told so", put("Phone", rotation_euler=(0, 0, 0)), NEVER_SEEN),
    case("a lens of 1 mm", put("Phone", lens=1), lit()),
    case("a lens of 1 km", put("Phone", lens=1e6), lit()),
]

LAMPS = [
    case("no light at all is named", panel(0.0), DARK),
    case("a lamp of 0 W is nothing to meter by", lamp_alone(0.0), says("no light to meter the exposure by")),
    case(
        "a lamp of 1e29 W gives the light of 100 W at its own exposure",
        lamp_alone(1e29),
        same_light("of 100 W", lamp_alone(100.0), within=1e-3),
    ),
    case("a lamp of 1e-9 W is below Cycles' light threshold", lamp_alone(1e-9), says("light threshold of 0.01")),
    case(
        "without that threshold, a lamp of 1e-30 W gives the light of 100 W at its own exposure",
        [lamp_alone(1e-30), no_light_threshold],
        same_light("of 100 W", lamp_alone(100.0), within=1e-3),
    ),
    case("a sun of 1e9", [remove("Room"), lamp_alone(1e9, "SUN")], lit()),
    *(
        case(f"a lamp of {w:g} W is refused", lamp_alone(w), refused(f"lamp 'Bulb' has {w:g} as its strength"))
        for w in (1e30, math.inf, math.nan)
    ),
    case("a lamp among the virtual objects is named", virtual_lamp, says("Lamp 'Bulb' is among the virtual", n=1)),
    case("a lamp that breaks later is refused", lamp_that_breaks, refused("1e+31 as its strength at frame 2")),
    case("a lamp of -1e9 W is named", lamp_alone(-1e9), says("light of lamp 'Bulb' is negative", n=1)),
    case("a panel that shines negatively is named", panel(-6.0), says("light of material 'Light' is negative", n=1)),
    *(
        case(f"a panel of {strength:g} is refused", panel(strength), refused("material 'Light' has"))
        for strength in (math.nan, math.inf, 3e38)
    ),
    case("a panel of 1e20 is lit", panel(1e20), lit()),
    case("a panel fed with NaN is refused", feed_panel("ShaderNodeValue", [math.nan]), refused("has nan as its")),
    case("a panel whose arithmetic overflows is dark", feed_panel("ShaderNodeMath", [1e30, 1e30]), DARK),
]

SURROUNDINGS = [
    case("no world is a black world", no_world, AS_IT_IS),
    case("a world of NaN is refused", background(math.nan), refused("world 'Background' has nan as its strength")),
    case("a negative world is named", background(-1.0), says("light of world 'Background' is negative", n=1)),
    *(
        case(f"an HDRI with 32 pixels of {value:g} is named", sky(value, 32), says("32 pixels of image", n=32))
        for value in (math.nan, math.inf, -1.0)
    ),
    case("an HDRI of NaN throughout is named", sky(math.nan, 512), says("512 pixels of image 'HDRI' are", n=512)),
    case("an HDRI with a sun of 2e5", sky(2e5, 1), lit()),
    case("a wall whose colour is NaN is refused", paint_walls(math.nan, 1, 1), refused("'Walls' has nan as its color")),
    case("walls that send back ten times the light", paint_walls(10, 10, 10), lit()),
]

# In other units with other clip planes it is the same room: test_invariance.py.
UNITS = [
    case("a room in millimetres that says metres is refused", scale_all(1e3), refused("set the unit scale")),
    case("a room in kilometres that says metres is named", scale_all(1e-3), says("is the unit scale (")),
    *(
        case(
            f"{name} with the clip planes of metres are named",
            scale_all(factor, scale_length=1 / factor, is_clip_scaled=False),
            BEYOND_CLIPS,
        )
        for name, factor in (("millimetres", 1e3), ("kilometres", 1e-3))
    ),
    case("a room 1000 km away is named", move_all(1e6), says("have steps of 0.062 m", n=1)),
]


@pytest.mark.parametrize("changes, must", [*MESHES, *PLACES, *CAMERAS, *LAMPS, *SURROUNDINGS, *UNITS])
def test_a_broken_scene_is_lit_named_or_refused(changes, must, comes_out):
    assert comes_out(changes, previsualised, must, None if must.is_refusal else believed)
