"""Finer meshes in Blender: copies or the objects themselves, with all that they carry."""

from __future__ import annotations

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
from cell_radiosity.addon.command import main  # noqa: E402

from blender_scenes import bake_ours, colors, diffuse, empty, lamp, plane  # noqa: E402

FINER = dict(mesh="subdivide", max_edge=0.6, min_edge=0.05)


def shaded_floor(**placing):
    """A floor of four quads that carries everything, half under a plate, in a sun."""
    empty()
    lamp("SUN", 3.0, angle=0.0)
    plane("plate", size=1.0, n=1, location=(0.3, 0.2, 1))
    made = plane("floor", size=2.0, n=2, material=diffuse("red", (0.8, 0.1, 0.1)), **placing)
    made.data.materials.append(diffuse("green", (0.1, 0.8, 0.1)))
    mesh = made.data
    mesh.polygons[2].material_index = 1
    uv = mesh.uv_layers.new(name="own")
    for loop in mesh.loops:
        x, y, _ = mesh.vertices[loop.vertex_index].co
        uv.uv[loop.index].vector = ((x + 1) / 2, (y + 1) / 2)
    mesh.attributes.new("height", "FLOAT", "POINT").data.foreach_set("value", [3 * v.co.x for v in mesh.vertices])
    for polygon, name in zip(mesh.polygons, mesh.attributes.new("name", "STRING", "FACE").data):
        name.value = b"left" if polygon.center.x < 0 else b"right"
    for e in mesh.edges:
        e.use_edge_sharp = all(abs(mesh.vertices[k].co.x) < 1e-6 for k in e.vertices)
    group = made.vertex_groups.new(name="pinned")
    for v in mesh.vertices:
        group.add([v.index], abs(v.co.y), "REPLACE")
    mesh.normals_split_custom_set([(0.6, 0.0, 0.8)] * len(mesh.loops))
    return made


@pytest.mark.parametrize("in_place", [False, True])
@pytest.mark.parametrize("scale", [(1, 1, 1), (-1, 1, 1)])
def test_everything_comes_along(cells, in_place, scale):
    floor = shaded_floor(scale=scale)
    bake_ours(cells, **FINER, in_place=in_place, objects=("floor",))
    made = floor if in_place else bpy.data.objects["floor_radiosity"]
    mesh = made.data
    assert len(mesh.vertices) > 100
    assert not mesh.validate()
    assert len(floor.data.vertices) == (len(mesh.vertices) if in_place else 9)
    assert floor.hide_render is (not in_place)
    assert sum(p.area for p in mesh.polygons) == pytest.approx(4.0, rel=1e-5)
    assert min(p.normal.z for p in mesh.polygons) > 0.99
    at = np.array([v.co[:] for v in mesh.vertices])
    np.testing.assert_allclose([a.value for a in mesh.attributes["height"].data], 3 * at[:, 0], atol=1e-6)
    uv = np.array([mesh.uv_layers["own"].uv[loop.index].vector[:] for loop in mesh.loops])
    vertex = np.array([loop.vertex_index for loop in mesh.loops])
    np.testing.assert_allclose(uv, (at[vertex, :2] + 1) / 2, atol=1e-6)
    for polygon in mesh.polygons:
        x, y, _ = polygon.center
        assert polygon.material_index == (1 if x < 0 and y > 0 else 0)
        assert mesh.attributes["name"].data[polygon.index].value == (b"left" if x < 0 else b"right")
    for v in mesh.vertices:
        y = abs(v.co.y)
        assert made.vertex_groups["pinned"].weight(v.index) == pytest.approx(y, abs=1e-6)
    sharp = {e.index for e in mesh.edges if e.use_edge_sharp}
    middle = {e.index for e in mesh.edges if all(abs(mesh.vertices[k].co.x) < 1e-6 for k in e.vertices)}
    assert sharp == middle
    assert len(sharp) > 2
    np.testing.assert_allclose([n.vector[:] for n in mesh.corner_normals], [(0.6, 0, 0.8)] * len(mesh.loops), atol=1e-3)
    # The light is at the places where it belongs: dark under the plate, bright elsewhere.
    light = colors(mesh, "Direct" if "Direct" in mesh.color_attributes else "Lighting")[:, 0]
    x, y = (at[vertex, :2] * scale[:2] - (0.3, 0.2)).T
    under = (np.abs(x) < 0.45) & (np.abs(y) < 0.45)
    beside = (np.abs(x) > 0.55) | (np.abs(y) > 0.55)
    assert light[under].max() < 0.5 * light[beside].min()


@pytest.mark.parametrize("in_place", [False, True])
def test_shape_keys_and_custom_properties_come_along(cells, in_place):
    """Keys move the finer mesh as they moved the coarse one, wherever it was baked, with their sliders and what drives them."""
    floor = shaded_floor()
    floor.data["origin"] = "quarry"
    floor.shape_key_add(name="Basis")
    up, bent = floor.shape_key_add(name="up"), floor.shape_key_add(name="bent")
    for v, w in zip(up.data, bent.data):
        v.co.z += 0.5
        w.co.z += 0.5 + abs(w.co.x)
    bent.relative_key, up.slider_max, up.value, bent.value = up, 2.0, 1.5, 0.0
    bent.driver_add("value").driver.expression = "0.25"
    bpy.context.view_layer.update()
    bake_ours(cells, **FINER, in_place=in_place, objects=("floor",))
    made = floor if in_place else bpy.data.objects["floor_radiosity"]
    assert made.data["origin"] == "quarry"
    assert made.data.name == ("floor" if in_place else "floor_radiosity")
    keys = made.data.shape_keys.key_blocks
    assert keys.keys() == ["Basis", "up", "bent"]
    assert (keys["up"].value, keys["up"].slider_max, keys["bent"].relative_key) == (1.5, 2.0, keys["up"])
    assert len(made.data.shape_keys.animation_data.drivers) == 1
    bpy.context.view_layer.update()
    moved = made.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
    x, _, z = np.array([v.co[:] for v in moved.vertices]).T
    np.testing.assert_allclose(z, 0.75 + 0.25 * np.abs(x), atol=1e-5)
    assert max(abs(v.co.z) for v in made.data.vertices) == 0.0


def test_again_from_the_original(cells):
    """The next bake starts from the user's mesh, not from the copy."""
    shaded_floor()
    sizes = []
    for _ in range(2):
        bake_ours(cells, **FINER)
        sizes.append(
            (len(bpy.data.objects["floor_radiosity"].data.vertices), len(bpy.data.objects), len(bpy.data.meshes))
        )
    assert sizes[0] == sizes[1]
    bake_ours(cells)  # to the mesh as it is: the copies go
    assert "floor_radiosity" not in bpy.data.objects
    assert not bpy.data.objects["floor"].hide_render


def test_copies_do_not_take_the_layers_of_other_bakes_along(cells):
    """Their light would be that of another time, and nobody would know that it is ours."""
    floor = shaded_floor()
    floor.data.color_attributes.new("paint", "BYTE_COLOR", "CORNER")
    bake_ours(cells, layers=("Direct", "Indirect"))
    bake_ours(cells, **FINER, layers=("Lighting",))
    assert bpy.data.objects["floor_radiosity"].data.color_attributes.keys() == ["paint", "Lighting"]
    bake_ours(cells, target="lightmap")
    assert bpy.data.objects["floor_radiosity"].data.color_attributes.keys() == ["paint"]
    floor.modifiers.new("array", "ARRAY").count = 2
    bake_ours(cells, layers=("Lighting",))
    assert bpy.data.objects["floor_radiosity"].data.color_attributes.keys() == ["paint", "Lighting"]
    assert floor.data.color_attributes.keys() == ["paint", "Direct", "Indirect"]


def test_modifiers_are_applied_in_place_and_it_is_said(cells):
    floor = shaded_floor()
    floor.modifiers.new("array", "ARRAY").count = 2
    floor.shape_key_add(name="Basis")
    job = bake_ours(cells, **FINER, in_place=True)
    assert not floor.modifiers
    assert floor.data.shape_keys is None
    assert sum(p.area for p in floor.data.polygons) == pytest.approx(8.0, rel=1e-5)
    assert [(f.object, f.finding) for f in job.changed] == [("floor", "it had modifiers and shape keys")]


def test_command(tmp_path):
    shaded_floor()
    scene = tmp_path / "room.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(scene))
    options = [
        "--mesh",
        "subdivide",
        "--max-edge",
        "0.5",
        "--min-edge",
        "0.1",
        "--vertices",
        "150",
        "--contrast",
        "0.05",
    ]
    assert main(["bake", str(scene), *options, "--quiet", "--picture", str(tmp_path / "p.png")]) == 0
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room_radiosity.blend"))
    count = sum(len(o.data.vertices) for o in bpy.data.objects if o.name.endswith("_radiosity"))
    assert 50 < count <= 150
    assert main(["bake", str(scene), "--mesh", "subdivide", "--target", "lightmap", "--quiet"]) == 1
