"""Surfaces that light passes, cut-outs and translucent sheets: the light on a floor, as Cycles has it."""

from __future__ import annotations

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
from cell_radiosity.addon.read_scene import read_scene  # noqa: E402

from blender_scenes import bake_cycles, bake_ours, colors, cube, diffuse, empty, lamp, plane, use_nodes  # noqa: E402


def principled(alpha=1.0, color=(0.6, 0.6, 0.6)):
    made = bpy.data.materials.new("veil")
    use_nodes(made)
    inputs = made.node_tree.nodes["Principled BSDF"].inputs
    inputs["Alpha"].default_value = alpha
    inputs["Base Color"].default_value = (*color, 1.0)
    inputs["Specular IOR Level"].default_value = 0.0
    return made


def board(part="Color"):
    """An image of 4 x 4 squares, 0 or 1 in its color or its alpha."""
    image = bpy.data.images.new("board", 64, 64, alpha=True)
    pixels = np.ones((64, 64, 4), np.float32)
    squares = (np.indices((64, 64)) // 16).sum(axis=0) % 2
    pixels[..., : 3 if part == "Color" else 4] = squares[..., None]
    if part == "Alpha":
        pixels[..., :3] = 1.0
        pixels[..., 3] = squares
    image.colorspace_settings.name = "Non-Color"
    image.alpha_mode = "CHANNEL_PACKED"
    image.pixels.foreach_set(pixels.reshape(-1))
    return image


def image_node(tree, part="Color"):
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image, node.interpolation = board(part), "Closest"
    return node.outputs[part]


def with_alpha_image():
    made = principled()
    tree = made.node_tree
    tree.links.new(image_node(tree, "Alpha"), tree.nodes["Principled BSDF"].inputs["Alpha"])
    return made


def mixed(share=None, clear_second=False):
    """A diffuse and a clear transparent shader; share: constant, or None for an image."""
    made = diffuse("mixed", (0.5, 0.4, 0.3))
    tree = made.node_tree
    mix, clear = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeBsdfTransparent")
    shaders = [clear.outputs[0], tree.nodes["Diffuse BSDF"].outputs[0]]
    for k, shader in enumerate(reversed(shaders) if clear_second else shaders):
        tree.links.new(shader, mix.inputs[1 + k])
    if share is None:
        tree.links.new(image_node(tree), mix.inputs[0])
    else:
        mix.inputs[0].default_value = share
    tree.links.new(mix.outputs[0], tree.nodes["Material Output"].inputs["Surface"])
    return made


def checker_and_alpha():
    """A color that only Cycles understands, and an alpha that is known."""
    made = principled(0.4)
    tree = made.node_tree
    node = tree.nodes.new("ShaderNodeTexChecker")
    node.inputs["Scale"].default_value = 2.0
    tree.links.new(node.outputs["Color"], tree.nodes["Principled BSDF"].inputs["Base Color"])
    return made


def translucent():
    made = diffuse("leaf", (0, 0, 0))
    tree = made.node_tree
    mix, through = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeBsdfTranslucent")
    through.inputs["Color"].default_value = (0.7, 0.8, 0.3, 1)
    tree.nodes["Diffuse BSDF"].inputs["Color"].default_value = (0.3, 0.5, 0.2, 1)
    tree.links.new(tree.nodes["Diffuse BSDF"].outputs[0], mix.inputs[1])
    tree.links.new(through.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], tree.nodes["Material Output"].inputs["Surface"])
    return made


VEILS = {
    "alpha": lambda: principled(0.3),
    "alpha image": with_alpha_image,
    "mix": lambda: mixed(0.6),
    "mix, turned": lambda: mixed(0.6, clear_second=True),
    "mix by image": mixed,
    "mix by image, turned": lambda: mixed(clear_second=True),
    "nodes": checker_and_alpha,
    "translucent": translucent,
}


def add_uv(object):
    layer = object.data.uv_layers.new(name="UVMap")
    place = np.array([object.data.vertices[loop.vertex_index].co[:2] for loop in object.data.loops])
    layer.uv.foreach_set("vector", (place / 1.4 + 0.5).astype(np.float32).reshape(-1))


@pytest.mark.parametrize("name", VEILS)
def test_light_under_a_veil(cells, name):
    """A floor under a veil and a lamp, between two walls: direct and indirect light like in Cycles."""
    empty(world=(0.05, 0.05, 0.05))
    ground = plane(size=3.0, n=12, material=diffuse("floor", (0.7, 0.7, 0.7)))
    veil = plane("veil", size=1.4, n=3, location=(0.1, 0.0, 0.7), material=VEILS[name]())
    add_uv(veil)
    plane(
        "wall",
        size=3.0,
        n=2,
        location=(1.5, 0, 1.5),
        rotation_euler=(0, -np.pi / 2, 0),
        material=diffuse("w", (0.8,) * 3),
    )
    lamp("AREA", 80.0, shape="SQUARE", size=0.6, location=(0.3, -0.4, 2.2))
    bake_ours(cells, layers=("Lighting",), error=0.005)
    expected = bake_cycles(["plane"], 256)["plane"]
    found = colors(ground.data, "Lighting")
    # Cycles' own noise at 256 samples is 1 to 2 %.
    assert np.sqrt(((found - expected) ** 2).mean()) < 0.035 * np.sqrt((expected**2).mean())
    assert np.abs(found.mean(axis=0) / expected.mean(axis=0) - 1).max() < 0.012


def test_color_of_what_is_there():
    """The reflectance of a surface that rays pass is that of the part which is there, however it was read."""
    for make, expected in (
        (lambda: principled(0.3), 0.6),
        (lambda: mixed(0.6), (0.5, 0.4, 0.3)),
        (mixed, (0.5, 0.4, 0.3)),
    ):
        empty()
        add_uv(plane(material=make()))
        bpy.context.view_layer.update()
        scene, _ = read_scene(bpy.context)
        np.testing.assert_allclose(scene.materials[0].reflectance, np.broadcast_to(expected, 3), rtol=1e-3)
        assert scene.materials[0].transparent
        assert not scene.ignored


def test_alpha_of_nodes_is_named():
    """An alpha that comes from nodes which are not understood is taken as opaque, and the object is named."""
    empty()
    made = principled()
    tree = made.node_tree
    noise = tree.nodes.new("ShaderNodeTexNoise")
    tree.links.new(noise.outputs[0], tree.nodes["Principled BSDF"].inputs["Alpha"])
    cube(material=made)
    bpy.context.view_layer.update()
    scene, _ = read_scene(bpy.context)
    assert not scene.materials[0].transparent
    assert any(o == "cube" and "alpha" in r for o, r in scene.ignored)
