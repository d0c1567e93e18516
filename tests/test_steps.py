"""A bake in steps, as the window takes it: what happens to the file between them, and what is left untouched."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from cell_radiosity.addon import write_result
from cell_radiosity.addon.job import Job, Options
from cell_radiosity.core.bake import run

from blender_scenes import colors, cube, diffuse, empty, lamp, plane


@pytest.fixture
def room():
    """Two objects, one with a modifier that changes its polygons, under a lamp."""
    empty()
    plane(size=4.0)
    box = cube(size=1.0, location=(0.0, 0.0, 0.6))
    box.modifiers.new("Subdivision", "SUBSURF").levels = 1
    lamp("POINT", location=(1.0, 1.0, 3.0))
    bpy.context.view_layer.update()


def job_of(cells, **options):
    return Job(bpy.context, Options(error=0.1, **options), cells=cells)


def finished(cells, **options):
    job = job_of(cells, **options)
    run(job.bake())
    return job


def test_reading_in_steps_gives_the_same_scene(room, cells):
    whole = job_of(cells)
    stepwise = Job(bpy.context, Options(error=0.1), cells=cells, read=False)
    steps = sum(1 for _ in stepwise.reading(bpy.context, step=0.0))
    assert steps > 2
    assert stepwise.scene.objects == whole.scene.objects
    for name in ("vertices", "triangles", "corner_normal", "polygon_material", "written"):
        assert np.array_equal(getattr(stepwise.scene, name), getattr(whole.scene, name))


def test_one_mesh_is_read_and_written_in_several_steps(cells, monkeypatch):
    """However large it is: no turn takes all of it."""
    monkeypatch.setattr(write_result, "MANY", 0)
    empty()
    painted = diffuse("painted", (0.5, 0.5, 0.5))
    tree = painted.node_tree
    image = tree.nodes.new("ShaderNodeTexImage")
    image.image = bpy.data.images.new("gray", 4, 4)
    tree.links.new(image.outputs["Color"], tree.nodes["Diffuse BSDF"].inputs["Color"])
    floor = plane(material=painted)
    uv = [v.co.xy[:] for v in floor.data.vertices]
    floor.data.uv_layers.new().data.foreach_set("uv", np.ravel([uv[c.vertex_index] for c in floor.data.loops]))
    lamp("POINT", location=(1.0, 1.0, 3.0))
    bpy.context.view_layer.update()
    whole = job_of(cells, layers=("Radiosity", "Lighting"))
    stepwise = Job(bpy.context, Options(error=0.1), cells=cells, read=False)
    assert sum(1 for _ in stepwise.reading(bpy.context, step=0.0)) > 10
    assert np.array_equal(stepwise.scene.corner_uv, whole.scene.corner_uv)
    assert len(np.unique(whole.scene.corner_uv, axis=0)) == 25
    run(whole.bake())
    seen = []
    for _ in whole.writing(bpy.context, step=0.0):
        seen.append([a.name for a in bpy.data.meshes["plane"].color_attributes])
    assert ["Radiosity"] in seen


def test_a_bake_that_ends_early_leaves_the_last_result(room, cells):
    finished(cells).write(bpy.context)
    copy = bpy.data.objects["cube_radiosity"]
    before = colors(copy.data, "Radiosity")
    assert bpy.data.objects["cube"].hide_viewport

    finished(cells)  # never written
    assert bpy.data.objects["cube_radiosity"] == copy
    assert np.array_equal(colors(copy.data, "Radiosity"), before)
    assert bpy.data.objects["cube"].hide_viewport
    assert bpy.data.objects["cube"].hide_render

    finished(cells).write(bpy.context)
    assert sorted(o.name for o in bpy.data.objects if o.type == "MESH") == ["cube", "cube_radiosity", "plane"]
    assert np.array_equal(colors(bpy.data.objects["cube_radiosity"].data, "Radiosity"), before)


def test_without_its_modifier_an_object_takes_its_light_itself_again(room, cells):
    finished(cells).write(bpy.context)
    bpy.data.objects["cube"].modifiers.clear()
    finished(cells).write(bpy.context)
    assert "cube_radiosity" not in bpy.data.objects
    assert not bpy.data.objects["cube"].hide_viewport
    assert "Radiosity" in bpy.data.objects["cube"].data.color_attributes


def test_objects_that_changed_during_the_bake_are_named_and_the_rest_is_written(room, cells):
    plane("floor", size=1.0, location=(3.0, 0.0, 0.0))
    plane("wall", size=1.0, location=(5.0, 0.0, 0.0))
    bpy.context.view_layer.update()
    job = finished(cells)
    bpy.data.objects.remove(bpy.data.objects["plane"])
    floor = bpy.data.objects["floor"].data
    floor.clear_geometry()
    floor.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
    job.write(bpy.context)
    assert {f.object: f.finding for f in job.changed} == {
        "plane": "it was deleted during the bake",
        "floor": "its mesh was changed during the bake",
    }
    assert "Radiosity" not in floor.color_attributes
    assert colors(bpy.data.objects["wall"].data, "Radiosity").max() > 0


@pytest.mark.parametrize("domain", ["CORNER", "POINT"])
def test_writing_in_steps_gives_the_same_colors(room, cells, domain):
    """And an object that goes in a step's pause is named and left out."""
    job = finished(cells, domain=domain)
    job.write(bpy.context)
    before = {name: colors(bpy.data.objects[name].data, "Radiosity") for name in ("plane", "cube_radiosity")}
    bpy.data.objects["plane"].data.color_attributes.remove(bpy.data.objects["plane"].data.color_attributes["Radiosity"])
    assert sum(1 for _ in job.writing(bpy.context, step=0.0)) >= 2
    assert not job.changed
    for name, values in before.items():
        assert np.array_equal(colors(bpy.data.objects[name].data, "Radiosity"), values)
    steps = job.writing(bpy.context, step=0.0)
    next(steps)
    bpy.data.objects.remove(bpy.data.objects["plane"])
    run(steps)
    assert [finding.object for finding in job.changed] == ["plane"]
