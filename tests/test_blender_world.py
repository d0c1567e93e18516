"""The world in all its forms: what it gives a floor, walls and what lies in shade, as Cycles has it."""

from __future__ import annotations

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
from cell_radiosity.addon.read_scene import read_scene  # noqa: E402

from blender_scenes import bake_cycles, bake_ours, colors, cube, diffuse, empty, lamp, plane  # noqa: E402


def background():
    tree = bpy.context.scene.world.node_tree
    return tree, tree.nodes["Background"]


def gradient():
    tree, shade = background()
    place, ramp = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeMapping")
    ramp.inputs["Location"].default_value = (1.0, 1.0, 1.2)
    tree.links.new(place.outputs["Generated"], ramp.inputs["Vector"])
    tree.links.new(ramp.outputs[0], shade.inputs["Color"])
    shade.inputs["Strength"].default_value = 0.3


def sky(disc=True, elevation=0.6):
    tree, shade = background()
    node = tree.nodes.new("ShaderNodeTexSky")
    kinds = node.bl_rna.properties["sky_type"].enum_items.keys()
    node.sky_type = "NISHITA" if "NISHITA" in kinds else "MULTIPLE_SCATTERING"
    node.sun_disc, node.sun_elevation, node.sun_rotation = disc, elevation, 0.8
    tree.links.new(node.outputs[0], shade.inputs["Color"])
    shade.inputs["Strength"].default_value = 0.1


def image(sun=0.0, windows=False):
    """A panorama of 256 x 128: a blue sky over a brown ground, with a sun of a few pixels, or with bright windows."""
    made = bpy.data.images.new("panorama", 256, 128, float_buffer=True)
    pixels = np.ones((128, 256, 4), np.float32)
    pixels[:64, :, :3] = (0.08, 0.06, 0.04)
    pixels[64:, :, :3] = (0.3, 0.5, 0.9)
    if sun:
        pixels[100:102, 60:63, :3] = (sun, sun, 0.8 * sun)
    if windows:
        pixels[..., :3] *= 0.1
        pixels[80:100, 30:45, :3] = (30.0, 30.0, 40.0)
        pixels[70:90, 160:170, :3] = (60.0, 40.0, 10.0)
    made.pixels.foreach_set(pixels.reshape(-1))
    tree, shade = background()
    node = tree.nodes.new("ShaderNodeTexEnvironment")
    node.image = made
    tree.links.new(node.outputs[0], shade.inputs["Color"])


def lit_apart_from_seen():
    """What the camera sees is not what lights the scene."""
    tree, shade = background()
    gradient()
    mix, seen = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeBackground")
    seen.inputs["Strength"].default_value = 50.0
    path = tree.nodes.new("ShaderNodeLightPath")
    tree.links.new(path.outputs["Is Camera Ray"], mix.inputs[0])
    tree.links.new(shade.outputs[0], mix.inputs[1])
    tree.links.new(seen.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], tree.nodes["World Output"].inputs["Surface"])


WORLDS = {
    "gradient": gradient,
    "sky": sky,
    "sky without a sun": lambda: sky(disc=False),
    "image": image,
    "image with a sun": lambda: image(sun=4e3),
    "image with windows": lambda: image(windows=True),
    "light path": lit_apart_from_seen,
}
SUNNY = ("sky", "image with a sun")  # whose direct light is looked at by itself
PLAIN = ("sky without a sun", "image")  # parts of what the others are


@pytest.mark.parametrize("name", [pytest.param(w, marks=pytest.mark.heavy if w in PLAIN else []) for w in WORLDS])
def test_world_like_cycles(cells, name):
    """A floor, a block above it and a wall: direct light and all light, in every channel."""
    empty()
    WORLDS[name]()
    ground = plane("floor", size=4.0, n=8, material=diffuse("f", (0.6, 0.6, 0.6)))
    cube("block", size=1.0, location=(0.3, 0.2, 1.1), material=diffuse("b", (0.7, 0.3, 0.2)))
    wall = plane(
        "wall",
        size=4.0,
        n=6,
        location=(-2, 0, 2.3),
        rotation_euler=(0, np.pi / 2, 0),
        material=diffuse("w", (0.7,) * 3),
    )
    before = {kind: set(getattr(bpy.data, kind).keys()) for kind in ("worlds", "scenes", "meshes", "objects", "images")}
    bake_ours(cells, layers=("Direct", "Lighting"), error=0.01)
    assert before == {kind: set(getattr(bpy.data, kind).keys()) for kind in before}
    both = (("Direct", ["DIRECT"]), ("Lighting", ["DIRECT", "INDIRECT"]))
    for layer, parts in both if name in SUNNY else both[1:]:
        expected = bake_cycles(["floor", "wall"], 256, parts)
        for object in (ground, wall):
            exact, found = expected[object.name], colors(object.data, layer)
            # Cycles' noise at 256 samples: 2 to 3 % at a corner, 5 % of what comes by way of a sunlit floor.
            assert np.sqrt(((found - exact) ** 2).mean()) < (0.03 if layer == "Direct" else 0.09) * np.sqrt(
                (exact**2).mean()
            )
            np.testing.assert_allclose(found.mean(axis=0), exact.mean(axis=0), rtol=0.02, atol=0.01 * exact.mean())


def read():
    bpy.context.view_layer.update()
    return read_scene(bpy.context)[0]


def test_sun_of_a_sky_is_a_lamp():
    """The disc is taken out: a sun where the texture has it, and a map without anything so bright."""
    empty()
    sky()
    plane()
    scene = read()
    (sun,) = scene.lamps
    toward = np.array([np.sin(0.8) * np.cos(0.6), np.cos(0.8) * np.cos(0.6), np.sin(0.6)])
    np.testing.assert_allclose(sun.axes[2], toward, atol=1e-3)
    assert sun.angle == pytest.approx(np.radians(0.545), rel=1e-3)
    assert scene.world.map.max() < 0.01 * min(sun.strength) / (np.pi * (sun.angle / 2) ** 2)
    assert not scene.ignored


def test_world_of_one_color_is_not_rendered():
    empty(world=(0.1, 0.2, 0.3))
    plane()
    scene = read()
    assert scene.world.map is None
    np.testing.assert_allclose(scene.world.radiance, (0.1, 0.2, 0.3), rtol=1e-6)


def test_world_that_does_not_shine_on_surfaces():
    empty(world=(0.5, 0.5, 0.5))
    bpy.context.scene.world.cycles_visibility.diffuse = False
    plane()
    lamp("POINT", location=(0, 0, 1))
    assert read().world.brightest == 0.0
