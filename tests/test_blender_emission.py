"""Faces that give light, in every form that Blender has them: what they give a floor and a wall, as Cycles has it."""

from __future__ import annotations

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blender_scenes import bake_cycles, bake_ours, colors, diffuse, empty, glowing, mesh_object, plane  # noqa: E402


def picture(name="picture", alpha=False):
    """An image of 8 x 8 fields of very unlike colors, some black; alpha: there are holes in it."""
    rng = np.random.default_rng(5)
    fields = rng.random((8, 8, 3)) ** 4
    fields[2:4, 5:7] = 3.0
    pixels = np.ones((64, 64, 4), np.float32)
    pixels[..., :3] = fields.repeat(8, axis=0).repeat(8, axis=1)
    if alpha:
        pixels[..., 3] = (np.indices((64, 64)) // 16).sum(axis=0) % 2
    image = bpy.data.images.new(name, 64, 64, alpha=alpha, float_buffer=True)
    image.alpha_mode = "CHANNEL_PACKED"
    image.pixels.foreach_set(pixels.reshape(-1))
    return image


def with_picture(material, node, inputs, image):
    """A material with an image in inputs {output: input} of its node."""
    tree = material.node_tree
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image, texture.interpolation = image, "Closest"
    for output, input in inputs.items():
        tree.links.new(texture.outputs[output], tree.nodes[node].inputs[input])
    return material


def see_through(material, share):
    """A material that is mixed with a transparent shader: a constant share of it is there, or that of an image's alpha."""
    tree = material.node_tree
    mix, clear = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeBsdfTransparent")
    if isinstance(share, float):
        mix.inputs[0].default_value = share
    else:
        tree.links.new(next(n for n in tree.nodes if n.type == "TEX_IMAGE").outputs["Alpha"], mix.inputs[0])
    tree.links.new(clear.outputs[0], mix.inputs[1])
    tree.links.new(tree.nodes["Emission"].outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], tree.nodes["Material Output"].inputs["Surface"])
    return material


def add_uv(object):
    layer = object.data.uv_layers.new(name="UVMap")
    place = np.array([object.data.vertices[loop.vertex_index].co[:2] for loop in object.data.loops])
    layer.uv.foreach_set("vector", ((place - place.min(axis=0)) / np.ptp(place, axis=0)).astype(np.float32).reshape(-1))


def showing(strength, alpha=False):
    """A material that glows with a picture."""
    return with_picture(glowing("glow", (1, 1, 1), strength), "Emission", {"Color": "Color"}, picture(alpha=alpha))


def screen(material, n=1, size=0.6):
    """A glowing square in the middle of the scene, tilted."""
    made = plane("screen", size=size, n=n, material=material, location=(0.2, -0.3, 0.9), rotation_euler=(0.6, 0.4, 0.0))
    add_uv(made)
    return made


def ball(n=8):
    """A glowing ball of quads, most of which are not quite flat."""
    line = np.linspace(-1, 1, n + 1)
    u, v = (x.reshape(-1) for x in np.meshgrid(line, line, indexing="ij"))
    first = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).reshape(-1)
    quads = np.stack([first, first + n + 1, first + n + 2, first + 1], axis=1)
    sides = [np.roll(np.stack([np.full(len(u), s), s * u, v], axis=1), k, axis=1) for k in range(3) for s in (-1, 1)]
    vertices = np.concatenate(sides)
    vertices *= 0.25 / np.sqrt((vertices**2).sum(axis=1, keepdims=True))
    faces = np.concatenate([quads + k * len(u) for k in range(6)])
    return mesh_object("ball", vertices, faces, glowing("glow", (1.0, 0.6, 0.3), 8.0), location=(0.2, -0.3, 0.9))


def pearls(count=600):
    """Many small glowing faces of several objects."""
    rng = np.random.default_rng(2)
    for k in range(5):
        place = rng.uniform((-1, -1, 0.5), (1, 1, 1.2), (count // 5, 3))
        a, b = (0.025 * rng.normal(size=(count // 5, 3)) for _ in range(2))
        vertices = np.stack([place, place + a, place + b], axis=1).reshape(-1, 3)
        glow = glowing(f"glow {k}", (1.0, 0.2 * k, 0.5), 40.0)
        mesh_object(f"pearls {k}", vertices, np.arange(len(vertices)).reshape(-1, 3), glow)


EMITTERS = {
    "picture": lambda: screen(showing(6.0)),
    "picture on a fine mesh": lambda: screen(showing(6.0), n=12),
    "small picture": lambda: screen(showing(90.0), size=0.15),
    "see-through": lambda: screen(see_through(glowing("glow", (1.0, 0.5, 0.2), 8.0), 0.4)),
    "picture with holes": lambda: screen(see_through(showing(6.0, alpha=True), "Alpha")),
    "ball": ball,
    "pearls": pearls,
}


@pytest.mark.parametrize("name", EMITTERS)
def test_emitter_like_cycles(cells, name):
    """A floor, and a wall with a board before it: direct light in the mean over their quarters, all light in that over
    each of them, in every channel."""
    empty()
    EMITTERS[name]()
    plane("floor", size=3.0, n=8, material=diffuse("floor", (0.7, 0.6, 0.5)))
    turned = dict(location=(-1.5, 0, 1.5), rotation_euler=(0, np.pi / 2, 0))
    plane("wall", size=3.0, n=6, material=diffuse("wall", (0.6, 0.7, 0.8)), **turned)
    plane("board", size=0.8, n=2, location=(0.4, 0.6, 0.4), material=diffuse("board", (0.3, 0.3, 0.3)))
    job = bake_ours(cells, layers=("Direct", "Lighting"), error=0.01)
    assert job.result.converged
    assert not job.scene.ignored
    direct, whole = (bake_cycles(["floor", "wall"], 256, parts) for parts in (["DIRECT"], ["DIRECT", "INDIRECT"]))
    for object in ("floor", "wall"):
        mesh = bpy.data.objects[object].data
        place = np.array([mesh.vertices[loop.vertex_index].co[:2] for loop in mesh.loops])
        quarter, found = (place > 0) @ (1, 2), colors(mesh, "Direct")
        for k in range(4):
            # Cycles' noise, which differs by version: of a picture up to 2 %, on many faces up to 4 %.
            noise = {"see-through": 0.012, "ball": 0.012, "picture on a fine mesh": 0.05}.get(name, 0.03)
            a, b = found[quarter == k].mean(axis=0), direct[object][quarter == k].mean(axis=0)
            np.testing.assert_allclose(a, b, rtol=noise, atol=0.01 * direct[object].mean())
        np.testing.assert_allclose(colors(mesh, "Lighting").mean(axis=0), whole[object].mean(axis=0), rtol=0.025)
