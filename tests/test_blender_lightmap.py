"""Lightmaps in Blender: files with the exact values, copies that show them, and what comes along."""

from __future__ import annotations

import json

import jsonschema
import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
from cell_radiosity.addon.command import main  # noqa: E402
from cell_radiosity.addon.images import make_image  # noqa: E402
from cell_radiosity.core.report import SCHEMA  # noqa: E402

from blender_scenes import bake_ours, diffuse, empty, glowing, lamp, plane  # noqa: E402


def pixels_of(path):
    """(height, width, 3) values of an image file, as they are."""
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Non-Color"
    values = np.empty(image.size[0] * image.size[1] * 4, np.float32)
    image.pixels.foreach_get(values)
    size = image.size[1], image.size[0]
    bpy.data.images.remove(image)
    return values.reshape(*size, 4)[..., :3]


def lit_room(**floor):
    """A floor with all that a mesh can carry, a mirrored wall, and a lamp."""
    empty()
    plane("wall", n=3, location=(1, 0, 1), rotation_euler=(0, -np.pi / 2, 0), scale=(1, -1, 1))
    lamp("POINT", 300.0, location=(-0.3, 0.2, 1.2), shadow_soft_size=0.05)
    made = plane("floor", n=4, material=diffuse("red", (0.8, 0.1, 0.1)), **floor)
    made.data.materials.append(diffuse("green", (0.1, 0.8, 0.1)))
    made.data.polygons[5].material_index = 1
    mesh = made.data
    uv = mesh.uv_layers.new(name="own")
    for loop in mesh.loops:
        x, y, _ = mesh.vertices[loop.vertex_index].co
        uv.uv[loop.index].vector = ((x + 1) / 2, (y + 1) / 2)
    mesh.attributes.new("height", "FLOAT", "POINT").data.foreach_set("value", [3 * v.co.x for v in mesh.vertices])
    mesh.attributes.new("group", "INT", "FACE").data.foreach_set("value", list(range(len(mesh.polygons))))
    mesh.edges[7].use_edge_sharp = True
    made.vertex_groups.new(name="first")
    weights = made.vertex_groups.new(name="pinned")
    for v in mesh.vertices:
        weights.add([v.index], abs(v.co.y), "REPLACE")
    return made


def test_the_file_holds_the_very_values(tmp_path):
    """Far above 1 and tiny; whatever the scene's view transform does to pictures."""
    empty()
    values = np.array([[[63.7, 1e-5, 0.5], [0.0, 1.0, 1234.5]], [[2.0, 3.0, 4.0], [0.25, 0.018, 7.7]]])
    image = make_image("x", values, str(tmp_path / "x.exr"))
    np.testing.assert_array_equal(pixels_of(tmp_path / "x.exr"), values.astype(np.float32))
    read = np.empty(16, np.float32)
    image.pixels.foreach_get(read)  # what materials see
    np.testing.assert_array_equal(read.reshape(2, 2, 4)[..., :3], values.astype(np.float32))
    image = make_image("y", values, str(tmp_path / "y.png"), "png")
    assert image["scale"] == pytest.approx(1234.5)
    np.testing.assert_allclose(pixels_of(tmp_path / "y.png") * image["scale"], values, atol=1234.5 / 65535 * 0.51)
    assert not list(tmp_path.glob("*tmp*"))


def shown_values(name):
    """Light (triangles, 3) that the material of an object shows in the middle of its triangles."""
    object = bpy.data.objects[name]
    tree = object.material_slots[0].material.node_tree
    node = next(n for n in tree.nodes if n.type == "TEX_IMAGE")
    uv_node = next(n for n in tree.nodes if n.type == "UVMAP")
    output = tree.get_output_node("ALL")
    assert output.inputs["Surface"].links[0].from_node.type == "EMISSION"
    image = node.image
    width, height = image.size
    values = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(values)
    values = values.reshape(height, width, 4)[..., :3]
    mesh = object.data
    layer = mesh.uv_layers[uv_node.uv_map].uv
    mesh.calc_loop_triangles()
    uv = np.array([np.mean([layer[k].vector[:] for k in t.loops], axis=0) for t in mesh.loop_triangles])
    at = np.array([object.matrix_world @ t.center for t in mesh.loop_triangles])
    column, row = (uv * [width, height]).astype(int).T
    return values[row, column], at


def test_command_writes_images_and_copies_that_show_them(tmp_path):
    lit_room()
    scene = tmp_path / "room.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(scene))
    out = tmp_path / "out" / "lit.blend"
    code = main(["bake", str(scene), "-o", str(out), "--target", "lightmap", "--layers", "Direct,Lighting", "--cells", "1",
                 "--report", str(tmp_path / "r.json"), "--texels-per-meter", "24", "--quiet",
                 "--picture", str(out.with_suffix(".png"))])  # fmt: skip
    assert code == 0
    assert {p.name for p in out.parent.iterdir()} == {
        "lit.blend", "lit.png", "lit_floor_Lighting.exr", "lit_floor_Direct.exr", "lit_wall_Lighting.exr", "lit_wall_Direct.exr",
    }  # fmt: skip
    report = json.loads((tmp_path / "r.json").read_text())
    jsonschema.validate(report, SCHEMA)
    maps = {m["of"]: m for m in report["lightmaps"]}
    assert set(maps) == {"floor", "wall"}
    assert sum(m["texels"] for m in maps.values()) == report["output_points"]
    assert maps["floor"]["width"] * maps["floor"]["height"] >= 48 * 48
    bpy.ops.wm.open_mainfile(filepath=str(out))
    for name in ("floor", "wall"):
        copy = bpy.data.objects[f"{name}_radiosity"]
        assert bpy.data.objects[name].hide_render
        assert "Lightmap" in copy.data.uv_layers
        assert "Lightmap" not in bpy.data.objects[name].data.uv_layers
        image = bpy.data.images[f"{name}_Direct"]
        assert image.filepath.startswith("//lit_")
        values, at = shown_values(copy.name)
        way = np.array((-0.3, 0.2, 1.2)) - at
        far = np.sqrt((way**2).sum(axis=1))
        cosine = np.abs(way[:, 2 if name == "floor" else 0]) / far
        direct = 300 / (4 * np.pi**2) * cosine / far**2
        np.testing.assert_allclose(values[:, 0], direct, rtol=0.1)  # a texel's center is not a triangle's


@pytest.mark.parametrize("uv", [None, "own"])
def test_what_a_mesh_carries_comes_along(cells, uv):
    floor = lit_room()
    bpy.data.objects.remove(bpy.data.objects["wall"])
    floor.data.normals_split_custom_set([(0.6, 0.0, 0.8)] * len(floor.data.loops))
    bake_ours(cells, target="lightmap", uv=uv)
    copy = bpy.data.objects["floor_radiosity"]
    mesh = copy.data
    assert len(mesh.polygons) == (16 if uv else 32)
    at = np.array([v.co[:] for v in mesh.vertices])
    assert {tuple(v) for v in at.round(5)} == {tuple(np.round(v.co[:], 5)) for v in floor.data.vertices}
    height = np.array([a.value for a in mesh.attributes["height"].data])
    np.testing.assert_allclose(height, 3 * at[:, 0], atol=1e-6)
    map = mesh.uv_layers["own"]
    for loop in mesh.loops:
        x, y, _ = mesh.vertices[loop.vertex_index].co
        np.testing.assert_allclose(map.uv[loop.index].vector, ((x + 1) / 2, (y + 1) / 2), atol=1e-6)
    for polygon in mesh.polygons:
        source = mesh.attributes["group"].data[polygon.index].value
        gap = np.array(polygon.center) - floor.data.polygons[source].center
        assert np.abs(gap).max() < 0.2
        assert polygon.material_index == (1 if source == 5 else 0)
    assert [g.name for g in copy.vertex_groups] == ["first", "pinned"]
    for v in mesh.vertices:
        assert copy.vertex_groups["pinned"].weight(v.index) == pytest.approx(abs(v.co.y), abs=1e-6)
    sharp = [e for e in mesh.edges if e.use_edge_sharp]
    assert len(sharp) == 1
    old = floor.data.edges[7]
    assert {tuple(mesh.vertices[k].co) for k in sharp[0].vertices} == {
        tuple(floor.data.vertices[k].co) for k in old.vertices
    }
    assert mesh.has_custom_normals
    np.testing.assert_allclose([n.vector[:] for n in mesh.corner_normals], [(0.6, 0, 0.8)] * len(mesh.loops), atol=1e-3)
    assert [m.name for m in floor.data.materials] == ["red", "green"]  # the user's own are untouched


def test_modifiers_are_in_the_copy(cells):
    floor = lit_room()
    floor.modifiers.new("wave", "SIMPLE_DEFORM").angle = 0.5
    floor.modifiers.new("array", "ARRAY").count = 2
    bake_ours(cells, target="lightmap")
    copy = bpy.data.objects["floor_radiosity"]
    assert len(copy.data.polygons) == 2 * 32
    depsgraph = bpy.context.evaluated_depsgraph_get()
    floor.hide_viewport = False
    bpy.context.view_layer.update()
    bent = floor.evaluated_get(depsgraph).to_mesh()
    assert {tuple(np.round(v.co[:], 5)) for v in copy.data.vertices} == {
        tuple(np.round(v.co[:], 5)) for v in bent.vertices
    }


def test_the_same_bits_again(cells):
    """The copies' glowing materials are no light, and the copies no objects, to the next bake."""
    lit_room()
    read = []
    for _ in range(2):
        bake_ours(cells, target="lightmap", atlas="scene")
        image = bpy.data.images["atlas_Radiosity"]
        values = np.empty(image.size[0] * image.size[1] * 4, np.float32)
        image.pixels.foreach_get(values)
        read.append(values)
        counts = len(bpy.data.objects), len(bpy.data.images), len(bpy.data.meshes), len(bpy.data.materials)
        read.append(np.array(counts))
    assert np.array_equal(read[0], read[2])
    assert np.array_equal(read[1], read[3])


def test_a_glowing_face_does_not_bleed_into_what_it_is_let_into(cells):
    """What arrives is matched where they touch, what they look like is not: a lamp in a ceiling looked twice its size."""
    empty()
    plane("ceiling", n=1, material=diffuse("gray", (0.5, 0.5, 0.5)))
    plane("panel", n=1, material=glowing("glow", (1.0, 1.0, 1.0), 50.0), location=(2, 0, 0))
    lamp("POINT", 100.0, location=(1.0, 0.0, 2.0))
    job = bake_ours(cells, target="lightmap", texels_per_meter=8.0)
    ceiling, panel = job.output.images["Radiosity"]
    assert ceiling.max() < 5.0
    assert panel.min() > 49.0
    seams, images = job.output.seams, job.output.images["Lighting"]
    assert {tuple(sorted(pair)) for pair in seams.object.tolist()} == {(0, 1)}
    values = np.zeros((3, 2, *job.output.atlas.size.max(axis=0)[::-1]))
    for k, image in enumerate(images):
        values[:, k, : image.shape[0], : image.shape[1]] = np.moveaxis(image, -1, 0)
    assert np.abs(seams.differences(values.reshape(3, -1))).max() < 0.01 * images[0].max()


def test_names_that_file_systems_take_for_one(cells, tmp_path):
    """Every object keeps an image of its own: here one is lit, and one is not."""
    empty()
    names = ("a/b", "a_b", "A_b", "wände", "wönde")
    for k, name in enumerate(names):
        plane(name, n=1, size=0.5, location=(k, 0, 0 if k % 2 else 2))
    lamp("POINT", 300.0, location=(2, 0, 1), shadow_soft_size=0.05)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "s.blend"))
    bake_ours(cells, target="lightmap", size=16, layers=("Lighting",), output=str(tmp_path / "s.blend"))
    files = {bpy.path.abspath(bpy.data.images[f"{name}_Lighting"].filepath) for name in names}
    assert len({file.casefold() for file in files}) == len(names)
    for name in names:
        image = bpy.data.images[f"{name}_Lighting"]
        lit = pixels_of(bpy.path.abspath(image.filepath)).max() > 0
        assert lit == (bpy.data.objects[name].location.z == 0), name


def test_a_uv_map_that_is_not_there(tmp_path, capfd):
    lit_room()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
    assert main(["bake", str(tmp_path / "room.blend"), "--target", "lightmap", "--uv", "own", "--quiet"]) == 1
    assert "wall: it has no UV map 'own' (it has: none)" in capfd.readouterr().err
    arguments = ["--target", "lightmap", "--uv", "own", "--objects", "floor", "--quiet"]
    assert main(["bake", str(tmp_path / "room.blend"), *arguments]) == 0
    assert (tmp_path / "room_radiosity_floor_Radiosity.exr").exists()
