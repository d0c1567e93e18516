"""A bake in steps, as the window takes it: what happens to the file between them, and what is left untouched."""

from __future__ import annotations

import sys

import bpy
import numpy as np
import pytest

from cell_radiosity.addon import outputs, write_result
from cell_radiosity.addon.job import Job, Options
from cell_radiosity.addon.lookup import Lookup
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


OUTPUTS = {
    "vertex": {},
    "lightmap": {"target": "lightmap", "texels_per_meter": 4.0},
    "subdivide": {"mesh": "subdivide"},
    "in place": {"mesh": "subdivide", "in_place": True},
}


@pytest.mark.parametrize("options", OUTPUTS.values(), ids=OUTPUTS)
def test_objects_are_looked_up_once_however_many_there_are(room, cells, monkeypatch, options):
    """Blender looks through all of them for every name: 10 000 objects took 4 CPU seconds to write, and take a half."""
    made, searches, searched = [], [], (bpy.types.Object, bpy.types.Mesh)

    class Counted(Lookup):
        def __init__(self, scene):
            made.append(scene)
            super().__init__(scene)

    def count(frame, event, function):
        if event == "c_call" and function.__name__ == "get":
            owner = function.__self__
            if isinstance(owner, bpy.types.bpy_prop_collection) and isinstance(next(iter(owner), None), searched):
                searches.append(frame.f_code.co_name)

    for module in (outputs, write_result):
        monkeypatch.setattr(module, "Lookup", Counted)
    counts = []
    for more in (0, 6):
        for k in range(more):
            mesh = plane(f"plane {k}", size=0.5, n=1, location=(k, 2.5, 0.0))
            if k % 2:
                mesh.modifiers.new("Solidify", "SOLIDIFY")
        job = finished(cells, **options)
        made.clear()
        sys.setprofile(count)
        try:
            job.write(bpy.context)
        finally:
            sys.setprofile(None)
        counts.append(len(made))
    assert counts[0] == counts[1]
    assert not searches


@pytest.mark.parametrize("options", OUTPUTS.values(), ids=OUTPUTS)
@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 1.0])
def test_an_object_may_go_in_any_pause(room, cells, options, share):
    """What was looked up in one turn is not there in the next."""
    plane("floor", size=1.0, location=(3.0, 0.0, 0.0))
    bpy.context.view_layer.update()
    job = finished(cells, **options)
    pauses = sum(1 for _ in job.writing(bpy.context, step=0.0))
    job = finished(cells, **options)
    steps = job.writing(bpy.context, step=0.0)
    for _ in range(1 + round(share * (pauses - 1))):
        next(steps)
    for name in ("plane", "floor", "plane_radiosity", "cube_radiosity"):
        if name in bpy.data.objects and (name == "plane" or share > 0.5):
            bpy.data.objects.remove(bpy.data.objects[name])
    run(steps)
    assert {f.finding for f in job.changed} <= {"it was deleted during the bake", "it had modifiers"}
    assert not [
        m for m in bpy.data.meshes if not m.users and not m.name.startswith(("plane", "floor", "cube_radiosity"))
    ]
