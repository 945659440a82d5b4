"""Tiny scenes that call for one effect of light transport, each beside one that does not, and is otherwise alike."""

import functools
import math

import bpy
from planned_effects import plan_light_transport
from tiny_scenes import add, add_lamp, box, empty_scene, key, material, node_of, nodes_of, phone, set_world, sphere


def stage(make_look=None, lamp=True):
    """A floor under a black sky, a ball, both matt unless `make_look` makes another material, a lamp, and a phone."""
    scene = empty_scene()
    scene.frame_end = 1
    set_world(scene)
    look = make_look() if make_look is not None else material("Chalk", (0.6, 0.6, 0.6))
    box(scene, "Floor", (0, 0, -0.1), (4, 4, 0.2), look)
    ball(scene, "Matt ball", (-0.6, 0, 0.3), look)
    if lamp:
        add_lamp(scene, location=(0.5, -1.0, 2.0), energy=60)
    phone(scene, (0, -3, 1.2), (0, 0, 0.2))
    return scene


def ball(scene, name, centre, look, collection=None):
    return sphere(scene, name, centre, 0.3, look, collection)


def shader_look(name, node, **inputs):
    """A material of one shader node, such as "BsdfGlass", with its inputs set by name."""
    made = bpy.data.materials.new(name)
    tree, output = nodes_of(made)
    tree.links.new(shader_node(tree, node, **inputs).outputs[0], output.inputs["Surface"])
    return made


def shader_node(tree, node, **inputs):
    made = tree.nodes.new(f"ShaderNode{node}")
    for name, value in inputs.items():
        made.inputs[name.replace("_", " ")].default_value = value
    return made


def glass(name="Glass"):
    return shader_look(name, "BsdfGlass", Roughness=0.0, IOR=1.45)


def mirror(name="Mirror"):
    return shader_look(name, "BsdfGlossy", Color=(0.9, 0.9, 0.9, 1.0), Roughness=0.0)


def fog(name="Fog"):
    made = bpy.data.materials.new(name)
    tree, output = nodes_of(made)
    tree.links.new(shader_node(tree, "VolumeScatter", Density=2.0).outputs[0], output.inputs["Volume"])
    return made


def with_ball(make_look):
    """The stage with one more ball, of the material that `make_look` makes."""
    scene = stage()
    ball(scene, "Ball", (0.5, 0, 0.35), make_look())
    return scene


def with_subsurface():
    weight = {"Subsurface_Weight": 1.0, "Specular_IOR_Level": 0.0}
    return with_ball(lambda: shader_look("Wax", "BsdfPrincipled", **weight))


def with_hair():
    scene = stage()
    curves = bpy.data.hair_curves.new("Fur")
    curves.add_curves([2, 2])
    for index, point in enumerate(curves.points):
        point.position = (0.4 + 0.1 * (index // 2), 0.0, 0.5 * (index % 2))
        point.radius = 0.02
    add(scene, "Fur", curves)
    return scene


def with_displacement(method="DISPLACEMENT"):
    return with_ball(lambda: bumpy(method))


def bumpy(method):
    look = shader_look("Bumpy", "BsdfDiffuse")
    tree, output = look.node_tree, look.node_tree.get_output_node("CYCLES")
    noise, displacement = tree.nodes.new("ShaderNodeTexNoise"), tree.nodes.new("ShaderNodeDisplacement")
    tree.links.new(noise.outputs[0], displacement.inputs["Height"])
    tree.links.new(displacement.outputs[0], output.inputs["Displacement"])
    look.displacement_method = method
    return look


def with_motion_blur(moves=True):
    scene = stage()
    scene.render.use_motion_blur = True
    scene.frame_end = 3
    if moves:
        key(bpy.data.objects["Matt ball"], "location", {1: (-0.6, 0, 0.3), 3: (0.2, 0, 0.3)})
    return scene


def with_depth_of_field():
    scene = stage()
    scene.camera.data.dof.use_dof = True
    scene.camera.data.dof.focus_distance = 1.0
    scene.camera.data.dof.aperture_fstop = 0.5
    return scene


def with_two_lamps():
    scene = stage()
    add_lamp(scene, location=(-1.5, 0, 1.5), energy=60)
    return scene


def under_a_sky(is_varying=True):
    """Lit by the world: brighter towards one side, or equally bright all round."""
    scene = stage(lamp=False)
    world = bpy.data.worlds.new("Sky")
    tree, output = nodes_of(world)
    background = shader_node(tree, "Background", Strength=1.0, Color=(0.6, 0.7, 0.9, 1.0))
    tree.links.new(background.outputs[0], output.inputs["Surface"])
    if is_varying:
        gradient, place = tree.nodes.new("ShaderNodeTexGradient"), tree.nodes.new("ShaderNodeTexCoord")
        tree.links.new(place.outputs["Generated"], gradient.inputs[0])
        tree.links.new(gradient.outputs[0], background.inputs["Color"])
    # The automatic resolution takes seconds for each render.
    world.cycles.sampling_method, world.cycles.sample_map_resolution = "MANUAL", 64
    scene.world = world
    return scene


def all_mirror():
    return stage(mirror)


def bright_room(albedo=0.8):
    """A closed room without a way out, its walls bright, with a panel that glows below the ceiling."""
    scene = empty_scene()
    scene.frame_end = 1
    set_world(scene)
    walls = material("Walls", (albedo,) * 3)
    box(scene, "Room", (0, 0, 1.5), (4, 4, 3), walls, inward=True)
    box(scene, "Panel", (0, 0, 2.9), (1.0, 1.0, 0.02), material("Light", (1, 1, 1), emission=5.0))
    phone(scene, (-1.2, -1.5, 1.5), (1, 1.5, 1.2))
    return scene


def open_field():
    """Bare ground under an open sky."""
    scene = under_a_sky(is_varying=False)
    bpy.data.objects.remove(bpy.data.objects["Matt ball"])
    scene.camera.rotation_euler = (math.radians(75), 0, 0)
    return scene


with_mirror_ball, with_glass_ball, with_foggy_ball = (
    functools.partial(with_ball, look) for look in (mirror, glass, fog)
)

PAIRS = {
    "diffuse bounces": (stage, all_mirror),
    "glossy bounces": (with_mirror_ball, stage),
    "transmission": (with_glass_ball, stage),
    "transparency": (lambda: with_ball(lambda: shader_look("Veil", "BsdfTransparent")), stage),
    "volumes": (with_foggy_ball, stage),
    "reflective caustics": (with_mirror_ball, all_mirror),
    "refractive caustics": (with_glass_ball, with_mirror_ball),
    "subsurface": (with_subsurface, stage),
    "hair": (with_hair, stage),
    "displacement": (with_displacement, lambda: with_displacement("BUMP")),
    "motion blur": (with_motion_blur, lambda: with_motion_blur(moves=False)),
    "depth of field": (with_depth_of_field, stage),
    "light tree": (with_two_lamps, stage),
    "environment sampling": (under_a_sky, lambda: under_a_sky(is_varying=False)),
    "denoising": (stage, lambda: stage(lamp=False)),
}
"""By effect: a scene that calls for it, and one that does not. No scene calls for Fast GI, which is not among them."""


def state(scene, effect, **options):
    """What the plan says of an effect: on or off."""
    return plan_light_transport(scene, **options)[effect].state


def ball_node(scene, kind):
    """The node of a type in the material of the ball that `with_ball` put there."""
    return node_of(scene.objects["Ball"].data.materials[0], kind)


def mixed(factor, is_linked=False):
    """Chalk and glass, mixed."""
    look = bpy.data.materials.new("Mixed")
    tree, output = nodes_of(look)
    mix = mix_of_chalk_and_glass(tree)
    mix.inputs[0].default_value = factor
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    if is_linked:
        tree.links.new(tree.nodes.new("ShaderNodeTexNoise").outputs[0], mix.inputs[0])
    return look


def mix_of_chalk_and_glass(tree):
    mix = tree.nodes.new("ShaderNodeMixShader")
    tree.links.new(shader_node(tree, "BsdfDiffuse").outputs[0], mix.inputs[1])
    tree.links.new(shader_node(tree, "BsdfGlass").outputs[0], mix.inputs[2])
    return mix
