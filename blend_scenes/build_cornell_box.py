"""Build `cornell_box`: a room whose geometry is known to the millimetre.

Tests cast rays against these numbers. All surfaces are single faces or boxes, without bevels or bumps, in metres:

- room: x in [-1, 1], y in [-1, 1], z in [0, 2], open at the front (y = -1); floor z = 0, ceiling z = 2, back y = 1
- walls: left x = -1 red, right x = 1 green, all else white (albedo 0.73)
- light: a square face of 0.6 m at z = 1.995 around (0, 0), facing down, radiance `LIGHT_RADIANCE` in all channels
- tall box: 0.6 x 0.6 x 1.2 around (-0.35, 0.35), turned +17 degrees about Z, on the floor
- short box: 0.6 x 0.6 x 0.6 around (0.35, -0.3), turned -17 degrees about Z, on the floor
- outside: uniform radiance `OUTSIDE_RADIANCE`

Virtual: the three-sphere rig, radius 0.09, on the short box. The phone walks a small arc in front of the opening.
"""

from __future__ import annotations

import bpy
import numpy as np
from staging import arc, main, open_stage, walk_phone

from xihe_blender.lab.props.lighting import set_sky
from xihe_blender.lab.props.shapes import Solid, add_solid, box_between
from xihe_blender.lab.props.surfaces import plain
from xihe_blender.scene.sphere_rig import add_three_sphere_rig

LIGHT_RADIANCE, OUTSIDE_RADIANCE = 14.0, 0.05
SHORT_BOX_MIDDLE, TALL_BOX_MIDDLE = (0.35, -0.3), (-0.35, 0.35)
CORNERS = tuple((x, y, z) for z in (0.0, 2.0) for y in (-1.0, 1.0) for x in (-1.0, 1.0))
WALLS = {
    "Floor": (0, 1, 3, 2),
    "Ceiling": (4, 6, 7, 5),
    "Back wall": (2, 3, 7, 6),
    "Left wall": (0, 2, 6, 4),
    "Right wall": (1, 5, 7, 3),
}


def build() -> bpy.types.Scene:
    """The whole scene in an empty file."""
    scene, room = open_stage("Cornell box")
    white = plain("White", (0.73, 0.73, 0.73), roughness=1.0, specular_ior_level=0.0)
    colours = {
        "Left wall": plain("Red", (0.63, 0.06, 0.05), roughness=1.0, specular_ior_level=0.0),
        "Right wall": plain("Green", (0.14, 0.45, 0.09), roughness=1.0, specular_ior_level=0.0),
    }
    for name, face in WALLS.items():
        wall = Solid(np.array([CORNERS[i] for i in face]), ((0, 1, 2, 3),))
        add_solid(room, name, wall, colours.get(name, white))
    block = box_between((-0.3, -0.3, 0.0), (0.3, 0.3, 0.6))
    add_solid(room, "Short box", block, white, location=(*SHORT_BOX_MIDDLE, 0.0), turn_deg=-17)
    block = box_between((-0.3, -0.3, 0.0), (0.3, 0.3, 1.2))
    add_solid(room, "Tall box", block, white, location=(*TALL_BOX_MIDDLE, 0.0), turn_deg=17)
    corners = [(-0.3, -0.3, 1.995), (-0.3, 0.3, 1.995), (0.3, 0.3, 1.995), (0.3, -0.3, 1.995)]
    panel = Solid(np.array(corners), ((0, 1, 2, 3),))
    glowing = {"specular_ior_level": 0.0, "emission_color": (1, 1, 1), "emission_strength": LIGHT_RADIANCE}
    add_solid(room, "Light", panel, plain("Light", (0.0, 0.0, 0.0), **glowing))
    set_sky(scene, [(0.0, (1.0, 1.0, 1.0)), (1.0, (1.0, 1.0, 1.0))], strength=OUTSIDE_RADIANCE)
    add_three_sphere_rig(scene, (*SHORT_BOX_MIDDLE, 0.6), 0.09)
    positions = arc((0.2, 0.0), 2.05, (-118, -64), (1.4, 1.25))
    walk_phone(scene, positions, np.tile((0.15, -0.1, 0.8), (len(positions), 1)), seed=3)
    return scene


if __name__ == "__main__":
    main(build, __file__)
