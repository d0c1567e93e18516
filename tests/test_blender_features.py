"""Each light and material feature: where it is held against Cycles, and those that no other test holds against it."""

from __future__ import annotations

from importlib import import_module

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
from blender_scenes import bake_cycles, bake_ours, colors, cube, diffuse, empty, lamp, plane, use_nodes  # noqa: E402

# {feature: (module, its test, its case or None)}, all against a Cycles bake of the same scene.
LAMPS, WORLDS = ("lights", "test_lamp_like_cycles"), ("world", "test_world_like_cycles")
GLOWS, VEILS = ("emission", "test_emitter_like_cycles"), ("transparency", "test_light_under_a_veil")
SHADES, HERE = ("materials", "test_principled_reflects_as_much_as_in_cycles"), ("features", "test_feature_like_cycles")
FEATURES = {
    "point lamp": (*LAMPS, "point"),
    "point lamp with a radius": (*LAMPS, "soft point"),
    "point lamp without soft falloff": (*LAMPS, "ball"),
    "spot": (*LAMPS, "spot"),
    "spot with a blend": (*LAMPS, "spot rim"),
    "spot without a blend, hard": (*LAMPS, "hard spot"),
    "spot with a radius": (*LAMPS, "big spot"),
    "sun": (*LAMPS, "sun"),
    "sun of an angle": (*LAMPS, "wide sun"),
    "square lamp": (*LAMPS, "square"),
    "rectangle": (*LAMPS, "rectangle"),
    "disk": (*LAMPS, "disk"),
    "ellipse": (*LAMPS, "ellipse"),
    "scaled lamp": (*LAMPS, "scaled area"),
    "spread": (*LAMPS, "spread"),
    "spread of a disk": (*LAMPS, "narrow disk"),
    "exposure of a lamp": (*LAMPS, "exposure"),
    "temperature of a lamp": (*LAMPS, "temperature"),
    "power per area": (*LAMPS, "own units"),
    "strength of a lamp's nodes": (*HERE, "light nodes"),
    "glowing faces": (*GLOWS, "ball"),
    "many glowing faces": (*GLOWS, "pearls"),
    "textured emission": (*GLOWS, "picture"),
    "see-through emission": (*GLOWS, "see-through"),
    "textured emission with holes": (*GLOWS, "picture with holes"),
    "world of one color": (*HERE, "world of one color"),
    "gradient": (*WORLDS, "gradient"),
    "sky texture": (*WORLDS, "sky"),
    "image of the world": (*WORLDS, "image"),
    "image with a sun": (*WORLDS, "image with a sun"),
    "image with bright windows": (*WORLDS, "image with windows"),
    "light path": (*WORLDS, "light path"),
    "diffuse": ("materials", "test_diffuse_reflects_its_color", None),
    "no material": ("materials", "test_no_material_is_blenders_default", None),
    "principled": (*SHADES, "default"),
    "roughness": (*SHADES, "smooth"),
    "metal": (*SHADES, "metal"),
    "emission of a principled": ("materials", "test_emission_and_its_strength", None),
    "image on a surface": (*HERE, "image on a wall"),
    "node graph": (*HERE, "nodes on a wall"),
    "alpha": (*VEILS, "alpha"),
    "cut-out image": (*VEILS, "alpha image"),
    "transparent shader": (*VEILS, "mix"),
    "translucency": (*VEILS, "translucent"),
    "backs of faces": (*HERE, "back of a sheet"),
    "instances of an object": (*HERE, "instances"),
    "instances of a collection": (*HERE, "collection"),
    "object hidden from diffuse and shadow rays": (*HERE, "hidden from rays"),
    "lamp hidden from diffuse rays": (*HERE, "lamp without light"),
}


@pytest.mark.parametrize("feature", FEATURES)
def test_every_feature_has_its_test(feature):
    module, test, case = FEATURES[feature]
    found = getattr(import_module(f"test_blender_{module}"), test)
    cases = [each for mark in getattr(found, "pytestmark", ()) if mark.args for each in mark.args[1]]
    cases = [each.values[0] if isinstance(each, type(pytest.param())) else each for each in cases]
    assert case in cases or (case is None and not cases)


def light_nodes():
    data = lamp("POINT", 30.0, location=(0.3, -0.4, 1.5), shadow_soft_size=0.1).data
    data.use_nodes = True
    inputs = data.node_tree.nodes["Emission"].inputs
    inputs["Strength"].default_value, inputs["Color"].default_value = 2.5, (1.0, 0.6, 0.3, 1.0)


def even_world():
    bpy.context.scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.4, 0.6, 1.0, 1.0)
    screen(diffuse("screen", (0.6, 0.3, 0.2)))


def lit():
    return lamp("AREA", 40.0, location=(0.6, -0.5, 2.0), size=0.4)


def screen(material, name="screen", **placing):
    """An upright square beside the wall, turned away from it."""
    placed = {"location": (0.2, 0.3, 0.5), "rotation_euler": (0.3, np.pi / 2, 0.2), **placing}
    return plane(name, size=0.9, n=2, material=material, **placed)


def painted(kind):
    """The wall's neighbor with a picture, or a checker that only Cycles understands."""
    lit()
    made = bpy.data.materials.new("painted")
    use_nodes(made)
    tree = made.node_tree
    shader = tree.nodes["Principled BSDF"]
    shader.inputs["Specular IOR Level"].default_value = 0.0
    paint = tree.nodes.new("ShaderNodeTexChecker" if kind == "nodes" else "ShaderNodeTexImage")
    if kind == "nodes":
        paint.inputs["Scale"].default_value = 3.0
        paint.inputs["Color1"].default_value, paint.inputs["Color2"].default_value = (
            (0.9, 0.2, 0.1, 1),
            (0.1, 0.3, 0.9, 1),
        )
    else:
        paint.image, paint.interpolation = bpy.data.images.new("paint", 8, 8, float_buffer=True), "Closest"
        pixels = np.random.default_rng(3).random((8, 8, 4))
        paint.image.pixels.foreach_set(pixels.astype(np.float32).reshape(-1))
    tree.links.new(paint.outputs["Color"], shader.inputs["Base Color"])
    made = screen(made, rotation_euler=(0, -np.pi / 2, 0), location=(0.3, 0.2, 0.6))
    layer = made.data.uv_layers.new(name="UVMap")
    place = np.array([made.data.vertices[loop.vertex_index].co[:2] for loop in made.data.loops])
    layer.uv.foreach_set("vector", (place / 0.9 + 0.5).astype(np.float32).reshape(-1))


def seen_from_behind():
    """A bright sheet whose back is turned to lamp and wall."""
    lamp("AREA", 40.0, location=(-0.3, -0.4, 1.6), size=0.4)
    screen(diffuse("sheet", (0.8, 0.5, 0.2)), rotation_euler=(0, np.pi / 2, 0), location=(0.5, 0.1, 0.7))


def instances():
    lit()
    parent = plane("parent", size=1.0, n=1, material=diffuse("p", (0.5, 0.5, 0.5)), location=(0.2, 0, 0.5))
    parent.instance_type = "VERTS"
    cube("block", size=0.3, material=diffuse("b", (0.7, 0.4, 0.2))).parent = parent


def collection():
    lit()
    inner = bpy.data.collections.new("inner")
    block = cube("block", size=0.4, material=diffuse("b", (0.7, 0.4, 0.2)))
    bpy.context.scene.collection.objects.unlink(block)
    inner.objects.link(block)
    for place, turn, size in (((-0.6, 0.3, 0.4), 0.3, 1.0), ((0.5, -0.2, 0.5), 1.0, 0.7)):
        holder = bpy.data.objects.new("holder", None)
        holder.instance_type, holder.instance_collection, holder.location = "COLLECTION", inner, place
        holder.rotation_euler, holder.scale = (0, turn, turn), (size, size, -size)
        bpy.context.scene.collection.objects.link(holder)


def hidden_from_rays():
    lit()
    gone = cube("gone", size=0.6, location=(0.3, 0, 0.7), material=diffuse("g", (0.9, 0.1, 0.1)))
    gone.visible_diffuse = gone.visible_shadow = False


def lamp_without_light():
    lit()
    lamp("SPOT", 200.0, location=(0, 0, 2)).visible_diffuse = False


CASES = {
    "light nodes": light_nodes,
    "world of one color": even_world,
    "image on a wall": lambda: painted("image"),
    "nodes on a wall": lambda: painted("nodes"),
    "back of a sheet": seen_from_behind,
    "instances": instances,
    "collection": collection,
    "hidden from rays": hidden_from_rays,
    "lamp without light": lamp_without_light,
}


@pytest.mark.parametrize("name", CASES)
def test_feature_like_cycles(cells, name):
    """All light on a floor and a wall, in the mean over their quarters, in every channel."""
    empty()
    CASES[name]()
    plane("floor", size=2.4, n=6, material=diffuse("floor", (0.7, 0.6, 0.5)))
    turned = dict(location=(-1.2, 0, 1.2), rotation_euler=(0, np.pi / 2, 0))
    plane("wall", size=2.4, n=6, material=diffuse("wall", (0.6, 0.7, 0.8)), **turned)
    bake_ours(cells, layers=("Lighting",), error=0.01)
    expected = bake_cycles(["floor", "wall"], 256)
    for object in ("floor", "wall"):
        mesh = bpy.data.objects[object].data
        place = np.array([mesh.vertices[loop.vertex_index].co[:2] for loop in mesh.loops])
        quarter, found = (place > 0) @ (1, 2), colors(mesh, "Lighting")
        for k in range(4):
            a, b = found[quarter == k].mean(axis=0), expected[object][quarter == k].mean(axis=0)
            np.testing.assert_allclose(a, b, rtol=0.03, atol=0.01 * expected[object].mean(), err_msg=f"{object}, {k}")
