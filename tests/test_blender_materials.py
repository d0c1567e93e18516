"""Materials as the core sees them, against what Cycles says they reflect and emit."""

from __future__ import annotations

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
from cell_radiosity.addon import materials  # noqa: E402
from cell_radiosity.addon.read_scene import read_scene  # noqa: E402
from cell_radiosity.core.patches import make_patches  # noqa: E402
from cell_radiosity.core.scene import World  # noqa: E402
from cell_radiosity.core.surfaces import make_surfaces  # noqa: E402

from blender_scenes import bake_ours, colors, diffuse, empty, glowing, lamp, plane, use_nodes  # noqa: E402


def principled(**inputs):
    made = bpy.data.materials.new("principled")
    use_nodes(made)
    for name, value in inputs.items():
        made.node_tree.nodes["Principled BSDF"].inputs[name.replace("_", " ")].default_value = value
    return made


def cycles_says(kind, parts=("COLOR",)):
    """Mean (3,) of a one-sample Cycles bake of the plane."""
    mesh = bpy.data.objects["plane"].data
    attributes = mesh.color_attributes
    attributes.active_color = attributes.get("Cycles") or attributes.new("Cycles", "FLOAT_COLOR", "CORNER")
    bpy.context.scene.cycles.samples = 64
    bpy.context.view_layer.objects.active = bpy.data.objects["plane"]
    bpy.data.objects["plane"].select_set(True)
    bpy.ops.object.bake(type=kind, pass_filter=set(parts), target="VERTEX_COLORS")
    return colors(mesh, "Cycles").mean(axis=0)


def we_say():
    """Mean reflectance and exitance / pi (3,) of the plane's patches, and what was ignored."""
    bpy.context.view_layer.update()
    scene, _ = read_scene(bpy.context)
    patches = make_patches(scene, scene.diagonal / 20)
    surfaces = make_surfaces(scene, patches, np.zeros(len(scene.polygon_material), bool))
    weight = np.repeat(patches.area, 2) / patches.area.sum() / 2
    return (surfaces.reflectance * weight).sum(1), (surfaces.exitance * weight).sum(1) / np.pi, scene.ignored


SURFACES = {
    "default": dict(),
    "smooth": dict(Roughness=0.1, Base_Color=(0.3, 0.5, 0.7, 1)),
    "rough": dict(Roughness=1.0, Base_Color=(0.3, 0.5, 0.7, 1)),
    "black": dict(Base_Color=(0, 0, 0, 1)),
    "no specular": dict(Specular_IOR_Level=0.0, Base_Color=(0.3, 0.5, 0.7, 1)),
    "high IOR": dict(IOR=2.5, Base_Color=(0.3, 0.5, 0.7, 1)),
    "half metal": dict(Metallic=0.5, Base_Color=(0.3, 0.5, 0.7, 1)),
    "metal": dict(Metallic=1.0, Base_Color=(0.3, 0.5, 0.7, 1)),
}


@pytest.mark.parametrize("name", SURFACES)
def test_principled_reflects_as_much_as_in_cycles(name):
    """The total reflectance, diffuse and glossy, to 5 %."""
    empty()
    plane(material=principled(**SURFACES[name]))
    found, emitted, _ = we_say()
    expected = cycles_says("DIFFUSE") + cycles_says("GLOSSY")
    np.testing.assert_allclose(found, expected, rtol=0.05, atol=0.002)
    assert not emitted.any()


def test_diffuse_reflects_its_color():
    empty()
    plane(material=diffuse("d", (0.3, 0.5, 0.7)))
    found, _, ignored = we_say()
    np.testing.assert_allclose(found, cycles_says("DIFFUSE"), rtol=0.01)
    np.testing.assert_allclose(found, (0.3, 0.5, 0.7), rtol=1e-6)
    assert not ignored


def test_no_material_is_blenders_default():
    empty()
    plane()
    np.testing.assert_allclose(we_say()[0], cycles_says("DIFFUSE") + cycles_says("GLOSSY"), rtol=0.01)


def test_emission_and_its_strength():
    empty()
    plane(material=principled(Emission_Color=(1.0, 0.5, 0.2, 1), Emission_Strength=3.0))
    np.testing.assert_allclose(we_say()[1], cycles_says("EMIT", ()), rtol=0.01)


def test_metal_and_glass_are_named():
    empty()
    plane(material=principled(Metallic=1.0))
    plane("pane", material=principled(Transmission_Weight=1.0))
    _, _, ignored = we_say()
    assert any(o == "plane" and "gloss, 100 %" in r for o, r in ignored)
    assert any(o == "pane" and "refraction" in r for o, r in ignored)


def test_what_is_left_out_is_named_with_all_objects_that_have_it():
    """Those that share a mesh too; of many, some."""
    empty()
    steel = principled(Metallic=1.0)
    first = plane("leg 0", material=steel)
    for k in range(1, 5):
        bpy.context.scene.collection.objects.link(bpy.data.objects.new(f"leg {k}", first.data))
    plane("wall", material=diffuse("white", (0.8, 0.8, 0.8)))
    for more, expected in (([], "leg 0, leg 1, leg 2 and 2 more"), (["leg 1", "leg 2", "leg 3"], "leg 0, leg 4")):
        for name in more:
            bpy.data.objects.remove(bpy.data.objects[name])
        ((named, reason),) = we_say()[2]
        assert named == expected
        assert "gloss, 100 %" in reason


def mixed(factor):
    """A mix of a red diffuse and an emission shader."""
    made = diffuse("mix", (0.8, 0.1, 0.1))
    tree = made.node_tree
    mix, emission = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeEmission")
    mix.inputs[0].default_value = factor
    emission.inputs["Strength"].default_value = 2.0
    tree.links.new(tree.nodes["Diffuse BSDF"].outputs[0], mix.inputs[1])
    tree.links.new(emission.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], tree.nodes["Material Output"].inputs["Surface"])
    return made


def test_mix_of_shaders():
    empty()
    plane(material=mixed(0.25))
    reflectance, emitted, _ = we_say()
    np.testing.assert_allclose(reflectance, cycles_says("DIFFUSE"), rtol=0.01)
    np.testing.assert_allclose(emitted, cycles_says("EMIT", ()), rtol=0.01)


@pytest.mark.parametrize("how", ["node", "link", "shader", "circle", "reroutes in a circle"])
def test_what_is_muted_or_in_a_circle_is_what_cycles_makes_of_it(how):
    empty()
    made = diffuse("odd", (0.2, 0.4, 0.6))
    tree = made.node_tree
    shader = next(n for n in tree.nodes if n.type == "BSDF_DIFFUSE")
    if how == "shader":
        shader.mute = True
    elif how in ("node", "link"):
        mix = tree.nodes.new("ShaderNodeInvert" if how == "node" else "ShaderNodeRGB")
        if how == "node":
            mix.inputs["Color"].default_value = (0.7, 0.3, 0.1, 1.0)
            mix.mute = True
        link = tree.links.new(mix.outputs[0], shader.inputs["Color"])
        link.is_muted = how == "link"
    else:
        kind, entry = ("NodeReroute", 0) if how.startswith("reroutes") else ("ShaderNodeInvert", "Color")
        one, other = (tree.nodes.new(kind) for _ in range(2))
        tree.links.new(one.outputs[0], other.inputs[entry])
        tree.links.new(other.outputs[0], one.inputs[entry])
        tree.links.new(one.outputs[0], shader.inputs["Color"])
    plane("plane", material=made)
    bpy.context.view_layer.update()
    np.testing.assert_allclose(we_say()[0], cycles_says("DIFFUSE"), atol=0.01)
    assert we_say()[2] == ()


def test_an_image_that_cannot_be_read_is_named():
    empty()
    made = diffuse("odd", (0.2, 0.4, 0.6))
    node = made.node_tree.nodes.new("ShaderNodeTexImage")
    node.image = bpy.data.images.new("gone", 4, 4)
    node.image.source, node.image.filepath = "FILE", "//gone.png"
    shader = next(n for n in made.node_tree.nodes if n.type == "BSDF_DIFFUSE")
    made.node_tree.links.new(node.outputs["Color"], shader.inputs["Color"])
    add_uv(plane("plane", material=made))
    bpy.context.view_layer.update()
    (finding,) = read_scene(bpy.context)[0].health
    assert finding.object == "plane"
    assert finding.finding == "its image gone cannot be read: //gone.png"
    np.testing.assert_allclose(we_say()[0], cycles_says("DIFFUSE"), atol=0.01)


def test_an_image_that_only_cycles_would_read_is_named_too(monkeypatch):
    """That of a lit screen, and that of the sky."""
    monkeypatch.setattr("cell_radiosity.addon.read_scene.read_world", lambda *_: (World(), ()))  # which takes seconds
    empty()
    image = bpy.data.images.new("gone", 4, 4)
    image.source, image.filepath = "FILE", "//gone.png"
    made = glowing("screen", (1, 1, 1), 1.0)
    world = bpy.context.scene.world = bpy.data.worlds.new("studio")
    world.use_nodes = True
    for tree, kind in ((made.node_tree, "EMISSION"), (world.node_tree, "BACKGROUND")):
        node = tree.nodes.new("ShaderNodeTexImage" if kind == "EMISSION" else "ShaderNodeTexEnvironment")
        node.image = image
        tree.links.new(node.outputs["Color"], next(n for n in tree.nodes if n.type == kind).inputs["Color"])
    add_uv(plane("plane", material=made))
    bpy.context.view_layer.update()
    found = {(f.object, f.finding) for f in read_scene(bpy.context)[0].health}
    assert found == {(name, "its image gone cannot be read: //gone.png") for name in ("plane", "studio")}


def chained(made, count, inputs=(1, 2)):
    """A material whose shader is mixed with itself so many times, or by one of the inputs with nothing."""
    tree = made.node_tree
    output = next(n for n in tree.nodes if n.type == "OUTPUT_MATERIAL")
    shader = output.inputs["Surface"].links[0].from_socket
    for _ in range(count):
        mix = tree.nodes.new("ShaderNodeMixShader")
        for k in inputs:
            tree.links.new(shader, mix.inputs[k])
        shader = mix.outputs[0]
    tree.links.new(shader, output.inputs["Surface"])
    return made


def test_a_shader_that_many_lead_to_is_read_once(monkeypatch):
    """Read for each way to it, one behind 50 mixes took for ever."""
    read, (kind, own) = [], ("BSDF_DIFFUSE", materials.SHADERS["BSDF_DIFFUSE"])
    monkeypatch.setitem(materials.SHADERS, kind, lambda *given: read.append(1) or own(*given))
    empty()
    made = chained(diffuse("mixed", (0.2, 0.4, 0.6)), 10)
    np.testing.assert_allclose(materials.read_material(made, [])[0].reflectance, (0.2, 0.4, 0.6))
    assert len(read) == 1


def test_a_long_chain_of_shaders_is_left_to_cycles():
    """Python follows no more than a few hundred of them: a whole scene could not be read."""
    empty()
    made = chained(diffuse("long", (0.2, 0.4, 0.6)), 400, [1])
    with pytest.raises(materials.NotConstant):  # and Cycles is asked
        materials.read_material(made, [])
    assert materials.read_alpha(made, []) == (1.0, None)


def gradient_image():
    image = bpy.data.images.new("gradient", 64, 64)
    pixels = np.ones((64, 64, 4), np.float32)
    pixels[..., 0] = np.linspace(0, 1, 64)[None]
    pixels[..., 1] = np.linspace(0, 1, 64)[:, None]
    image.pixels.foreach_set(pixels.reshape(-1))
    return image


def textured(node_type, **settings):
    """A diffuse material with a node's color as its own."""
    made = diffuse("textured", (0, 0, 0))
    tree = made.node_tree
    node = tree.nodes.new(node_type)
    for key, value in settings.items():
        setattr(node, key, value)
    tree.links.new(node.outputs["Color"], tree.nodes["Diffuse BSDF"].inputs["Color"])
    return made


def add_uv(object):
    layer = object.data.uv_layers.new(name="UVMap")
    place = np.array([object.data.vertices[loop.vertex_index].co[:2] for loop in object.data.loops])
    layer.uv.foreach_set("vector", (place / 2 + 0.5).astype(np.float32).reshape(-1) * 0.98 + 0.01)


@pytest.mark.parametrize("way", ["image", "nodes"])
def test_texture_is_averaged_over_patches(way):
    """An image as the color, read directly; and the same behind a node that only Cycles understands."""
    empty()
    ground = plane()
    add_uv(ground)
    material = textured("ShaderNodeTexImage", image=gradient_image())
    ground.data.materials.append(material)
    if way == "nodes":
        tree = material.node_tree
        gamma = tree.nodes.new("ShaderNodeGamma")
        tree.links.new(tree.nodes["Image Texture"].outputs["Color"], gamma.inputs[0])
        tree.links.new(gamma.outputs[0], tree.nodes["Diffuse BSDF"].inputs["Color"])
    bpy.context.view_layer.update()
    scene, _ = read_scene(bpy.context)
    assert (scene.readings is not None) == (way == "nodes")
    patches = make_patches(scene, scene.diagonal / 20)
    surfaces = make_surfaces(scene, patches, np.zeros(len(scene.polygon_material), bool))
    stored = patches.centroid[:, :2] / 2 * 0.98 + 0.5  # the images are stored as sRGB
    linear = np.where(stored < 0.04045, stored / 12.92, ((stored + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(surfaces.reflectance[:2, 0::2].T, linear, atol=0.03)


def test_node_graph_reads_color_and_emission_and_leaves_no_trace():
    empty()
    material = textured("ShaderNodeTexChecker")
    plane(material=material)
    bpy.data.objects["plane"].select_set(True)
    before = {
        name: set(getattr(bpy.data, name).keys()) for name in ("objects", "meshes", "scenes", "materials", "images")
    }
    reflectance, _, _ = we_say()
    np.testing.assert_allclose(reflectance, cycles_says("DIFFUSE"), rtol=0.05)
    assert before == {name: set(getattr(bpy.data, name).keys()) for name in before}
    assert bpy.data.objects["plane"].select_get()


def test_layer_hooked_into_the_material_does_not_shine_again(cells):
    """Baked, hooked into base color and emission, baked again: the same bits."""
    empty()
    ground = plane(n=4, material=principled(Base_Color=(0.6, 0.4, 0.2, 1)))
    plane("wall", n=4, location=(1, 0, 1), rotation_euler=(0, -np.pi / 2, 0), material=diffuse("d", (0.7, 0.2, 0.2)))
    plane("glow", size=0.2, n=1, location=(0, 0, 2), material=glowing("g", (1, 1, 1), 20.0))
    lamp("POINT", 20.0, location=(0.5, 0.5, 1.5))
    bake_ours(cells)
    first = {n: colors(bpy.data.objects[n].data, "Radiosity") for n in ("plane", "wall")}
    for name, material in (("plane", ground.data.materials[0]), ("wall", bpy.data.objects["wall"].data.materials[0])):
        tree = material.node_tree
        node = tree.nodes.new("ShaderNodeVertexColor")
        node.layer_name = "Radiosity"
        if name == "plane":
            tree.links.new(node.outputs["Color"], tree.nodes["Principled BSDF"].inputs["Base Color"])
            tree.links.new(node.outputs["Color"], tree.nodes["Principled BSDF"].inputs["Emission Color"])
            tree.nodes["Principled BSDF"].inputs["Emission Strength"].default_value = 1.0
        else:
            tree.links.new(node.outputs["Color"], tree.nodes["Diffuse BSDF"].inputs["Color"])
    bake_ours(cells)
    for name, values in first.items():
        assert np.array_equal(colors(bpy.data.objects[name].data, "Radiosity"), values)
        assert values.max() > 0


def test_layer_shown_by_emission_alone(cells):
    """The surface is an Emission of our layer; the material's own shader is still there, unlinked."""
    empty()
    plane(n=2, material=diffuse("d", (0.6, 0.3, 0.1)))
    lamp("POINT", 20.0, location=(0.5, 0.5, 1.5))
    bake_ours(cells)
    first = colors(bpy.data.objects["plane"].data, "Radiosity")
    tree = bpy.data.materials["d"].node_tree
    node, emission = tree.nodes.new("ShaderNodeVertexColor"), tree.nodes.new("ShaderNodeEmission")
    node.layer_name = "Radiosity"
    tree.links.new(node.outputs["Color"], emission.inputs["Color"])
    tree.links.new(emission.outputs[0], tree.nodes["Material Output"].inputs["Surface"])
    bake_ours(cells)
    assert np.array_equal(colors(bpy.data.objects["plane"].data, "Radiosity"), first)
