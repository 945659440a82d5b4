"""What a material can do to light, however it hides it: judged by what reaches its output."""

import bpy
import pytest
from effect_scenes import (
    fog,
    glass,
    mixed,
    node_of,
    nodes_of,
    shader_look,
    shader_node,
    stage,
    state,
    with_ball,
)
from tiny_scenes import material


def grouped(is_connected=True, is_nested=False):
    """A group with glass inside, which its output shows or does not."""
    group = bpy.data.node_groups.new("Group", "ShaderNodeTree")
    group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    inside, out = shader_node(group, "BsdfGlass"), group.nodes.new("NodeGroupOutput")
    if is_connected:
        group.links.new(inside.outputs[0], out.inputs[0])
    look = bpy.data.materials.new("Grouped")
    tree, output = nodes_of(look)
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = wrapped(group) if is_nested else group
    tree.links.new(node.outputs[0], output.inputs["Surface"])
    return look


def wrapped(inner):
    group = bpy.data.node_groups.new("Outer", "ShaderNodeTree")
    group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    node, out = group.nodes.new("ShaderNodeGroup"), group.nodes.new("NodeGroupOutput")
    node.node_tree = inner
    group.links.new(node.outputs[0], out.inputs[0])
    return group


def grouped_by_factor(factor):
    """A group that mixes chalk and glass by a factor that is set outside it."""
    group = bpy.data.node_groups.new("By factor", "ShaderNodeTree")
    group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    group.interface.new_socket("Glass", in_out="INPUT", socket_type="NodeSocketFloat")
    inside, out = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    mix = group.nodes.new("ShaderNodeMixShader")
    group.links.new(inside.outputs["Glass"], mix.inputs[0])
    group.links.new(shader_node(group, "BsdfDiffuse").outputs[0], mix.inputs[1])
    group.links.new(shader_node(group, "BsdfGlass").outputs[0], mix.inputs[2])
    group.links.new(mix.outputs[0], out.inputs[0])
    look = bpy.data.materials.new("Grouped by factor")
    tree, output = nodes_of(look)
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = group
    node.inputs["Glass"].default_value = factor
    tree.links.new(node.outputs[0], output.inputs["Surface"])
    return look


def muted_glass():
    look = glass()
    next(node for node in look.node_tree.nodes if node.type == "BSDF_GLASS").mute = True
    return look


def muted_link():
    look = glass()
    look.node_tree.links[0].is_muted = True
    return look


def muted_mix():
    """A muted mix lets its first shader through, whatever its factor."""
    look = mixed(1.0)
    next(node for node in look.node_tree.nodes if node.type == "MIX_SHADER").mute = True
    return look


def rerouted():
    look = glass()
    tree, output = look.node_tree, look.node_tree.get_output_node("CYCLES")
    first, second = tree.nodes.new("NodeReroute"), tree.nodes.new("NodeReroute")
    shader = next(node for node in tree.nodes if node.type == "BSDF_GLASS")
    tree.links.new(shader.outputs[0], first.inputs[0])
    tree.links.new(first.outputs[0], second.inputs[0])
    tree.links.new(second.outputs[0], output.inputs["Surface"])
    return look


def in_an_unused_output():
    """Glass at an output that is not the active one."""
    look = material("Chalk")
    tree = look.node_tree
    tree.links.new(shader_node(tree, "BsdfGlass").outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs[0])
    tree.get_output_node("CYCLES").is_active_output = True
    return look


def beside_the_output():
    look = material("Chalk")
    shader_node(look.node_tree, "BsdfGlass")
    return look


MATERIALS = {
    "transmission behind a mix at factor 0": (lambda: mixed(0.0), "off"),
    "transmission behind a mix at factor 1": (lambda: mixed(1.0), "on"),
    "transmission behind a mix by a texture": (lambda: mixed(0.0, is_linked=True), "on"),
    "glass in a group": (grouped, "on"),
    "glass in a group in a group": (lambda: grouped(is_nested=True), "on"),
    "glass in a group that shows nothing of it": (lambda: grouped(is_connected=False), "off"),
    "glass in a group by a factor of 0": (lambda: grouped_by_factor(0.0), "off"),
    "glass in a group by a factor of a half": (lambda: grouped_by_factor(0.5), "on"),
    "a muted glass node": (muted_glass, "off"),
    "a muted link": (muted_link, "off"),
    "glass as the second shader of a muted mix": (muted_mix, "off"),
    "glass behind two reroutes": (rerouted, "on"),
    "glass at an output that is not active": (in_an_unused_output, "off"),
    "glass that nothing is linked to": (beside_the_output, "off"),
    "black glass": (lambda: shader_look("Black", "BsdfGlass", Color=(0, 0, 0, 1)), "off"),
    "Principled without transmission": (lambda: shader_look("P", "BsdfPrincipled", Transmission_Weight=0.0), "off"),
    "Principled, half transmissive": (lambda: shader_look("P", "BsdfPrincipled", Transmission_Weight=0.5), "on"),
    "Principled transmission under metal": (
        lambda: shader_look("P", "BsdfPrincipled", Transmission_Weight=1.0, Metallic=1.0),
        "off",
    ),
    "Principled transmission of a surface with alpha 0": (
        lambda: shader_look("P", "BsdfPrincipled", Transmission_Weight=1.0, Alpha=0.0),
        "off",
    ),
}


@pytest.mark.parametrize("case", MATERIALS)
def test_a_material_is_judged_by_what_reaches_its_output(case):
    make, expected = MATERIALS[case]
    assert state(with_ball(make), "transmission") == expected


@pytest.mark.parametrize(("density", "expected"), [(0.0, "off"), (0.1, "on")])
def test_a_volume_counts_by_its_density(density, expected):
    scene = with_ball(fog)
    node_of(scene, "VOLUME_SCATTER").inputs["Density"].default_value = density
    assert state(scene, "volumes") == expected


def test_a_volume_in_an_unused_output_is_left_out():
    scene = with_ball(lambda: material("Chalk"))
    tree = bpy.data.objects["Ball"].data.materials[0].node_tree
    unused = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(shader_node(tree, "VolumeScatter").outputs[0], unused.inputs["Volume"])
    tree.get_output_node("CYCLES").is_active_output = True
    unused.is_active_output = False
    assert state(scene, "volumes") == "off"
    unused.is_active_output = True
    assert state(scene, "volumes") == "on"


def test_a_world_full_of_haze_is_a_volume():
    scene = stage()
    tree, output = nodes_of(scene.world)
    tree.links.new(shader_node(tree, "VolumeScatter", Density=0.01).outputs[0], output.inputs["Volume"])
    assert state(scene, "volumes") == "on"
