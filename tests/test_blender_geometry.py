"""Meshes as they render: modifiers, instances, mirrored and stretched objects, what is hidden; and where results go."""

from __future__ import annotations

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
from cell_radiosity.addon.errors import Refused  # noqa: E402
from cell_radiosity.addon.job import Job, Options  # noqa: E402
from cell_radiosity.addon.lookup import Lookup  # noqa: E402
from cell_radiosity.addon.marks import stand_ins  # noqa: E402
from cell_radiosity.addon.material_setup import set_up  # noqa: E402
from cell_radiosity.addon.read_scene import read_scene  # noqa: E402
from cell_radiosity.addon.write_result import remove_copies  # noqa: E402
from cell_radiosity.core.bake import run  # noqa: E402

from blender_scenes import bake_ours, colors, cube, diffuse, empty, lamp, mesh_object, plane  # noqa: E402


def read():
    bpy.context.view_layer.update()
    return read_scene(bpy.context)[0]


def lit_room(**floor):
    """A floor, a wall and a lamp."""
    empty()
    plane("wall", n=4, location=(1, 0, 1), rotation_euler=(0, -np.pi / 2, 0), material=diffuse("red", (0.8, 0.1, 0.1)))
    lamp("POINT", 300.0, location=(-0.3, 0.2, 1.2), shadow_soft_size=0.05)
    return plane("floor", n=4, **floor)


@pytest.mark.parametrize("scale", [(1, 1, 1), (-1, 1, 1), (-1, -2, 0.5), (2, 0.5, -3)])
def test_mirrored_and_stretched_objects(scale):
    """World positions are the matrix's; fronts stay where Blender shows them, outside."""
    empty()
    cube(scale=scale, rotation_euler=(0.3, 0.5, 0.7), location=(1, 2, 3))
    scene = read()
    center = np.array((1, 2, 3.0))
    a, b, c = np.moveaxis(scene.vertices[scene.triangles], 1, 0)
    outward = (scene.triangle_normal_area[0] * ((a + b + c) / 3 - center)).sum(axis=1)
    assert (outward > 0).all()
    normal = scene.corner_normal[scene.triangle_corner[:, 0]]
    np.testing.assert_allclose((normal * scene.triangle_normal_area[0]).sum(axis=1), 1.0, atol=1e-6)
    assert np.prod(np.abs(scale)) * 8 == pytest.approx((np.cross(b - a, c - a) * a).sum() / 6 - 0, rel=1e-5)


def test_a_mirrored_object_is_baked_like_its_applied_twin(cells):
    """The same light at the same places, whether the scale is in the matrix or in the mesh."""
    found = {}
    for way in ("matrix", "mesh"):
        floor = lit_room()
        if way == "matrix":
            floor.scale = (-1.0, 1.5, 1.0)
        else:
            for v in floor.data.vertices:
                v.co = (-v.co.x, 1.5 * v.co.y, v.co.z)
            floor.data.flip_normals()
        bake_ours(cells, layers=("Lighting",), domain="POINT", error=0.01)
        place = np.array([(floor.matrix_world @ v.co)[:] for v in floor.data.vertices]).round(5)
        order = np.lexsort(place.T)
        found[way] = colors(floor.data, "Lighting")[order]
    assert found["mesh"].min() > 0
    np.testing.assert_allclose(found["matrix"], found["mesh"], rtol=0.08)
    assert found["matrix"].mean() == pytest.approx(found["mesh"].mean(), rel=0.01)


def test_instances_cast_light_and_are_real_geometry():
    empty()
    cube("block", size=0.2)
    parent = plane("parent", n=2)
    parent.instance_type = "VERTS"
    bpy.data.objects["block"].parent = parent
    scene = read()
    assert scene.objects.count("block") == 10  # itself, as Cycles renders it, and one at each vertex
    assert scene.written.sum() == 2  # the plane and the block; instances cannot hold a result of their own
    assert [(f.object, f.finding[:2]) for f in scene.health] == [("block", "9 ")]
    assert not read_scene(bpy.context, lambda name: name == "parent")[0].health


def test_collection_instances():
    empty()
    inner = bpy.data.collections.new("inner")
    block = cube("block", size=0.5)
    bpy.context.scene.collection.objects.unlink(block)
    inner.objects.link(block)
    for k in range(3):
        holder = bpy.data.objects.new(f"holder {k}", None)
        holder.instance_type, holder.instance_collection, holder.location = "COLLECTION", inner, (2 * k, 0, 0)
        bpy.context.scene.collection.objects.link(holder)
    plane()
    scene = read()
    assert scene.objects.count("block") == 3
    assert [(f.object, f.finding[:2]) for f in scene.health] == [("block", "3 ")]
    assert scene.bounds[1][0] == pytest.approx(4.25)


def test_what_is_hidden_takes_no_part():
    empty()
    plane("seen")
    for name, hide in (("not rendered", "hide_render"), ("no viewport", "hide_viewport")):
        setattr(plane(name), hide, True)
    plane("eye closed").hide_set(True)
    dark = bpy.data.collections.new("dark")
    bpy.context.scene.collection.children.link(dark)
    dark.hide_render = True
    inside = plane("in dark collection")
    bpy.context.scene.collection.objects.unlink(inside)
    dark.objects.link(inside)
    scene = read()
    assert scene.objects == ("seen",)
    named = {f.object for f in scene.health}
    assert named == {"no viewport", "eye closed"}  # these would be rendered; the others are meant to be left out


def test_objects_of_which_there_is_no_surface_are_named():
    empty()
    plane("seen")
    kinds = {"hair": bpy.data.hair_curves, "cloud": bpy.data.pointclouds, "smoke": bpy.data.volumes}
    for name, all_of_a_kind in kinds.items():
        bpy.context.scene.collection.objects.link(bpy.data.objects.new(name, all_of_a_kind.new(name)))
    bpy.data.objects["cloud"].hide_render = True
    scene = read()
    assert scene.objects == ("seen",)
    assert scene.ignored == (("hair", "it is hair: it is left out"), ("smoke", "it is a volume: it is left out"))


def test_a_text_is_there_once():
    """Blender lists the mesh of a text, curve or metaball beside the object itself: they were there twice, in one place."""
    empty()
    plane("floor")
    scene = bpy.context.scene
    group = bpy.data.collections.new("group")
    for name, made in (("text", bpy.data.curves.new("text", "FONT")), ("curve", bpy.data.curves.new("curve", "CURVE"))):
        made.extrude = 0.1
        if name == "text":
            made.body = "l"
        else:
            made.splines.new("POLY").points.add(1)
            made.splines[0].points[1].co = (1.0, 0.0, 0.5, 1.0)
        group.objects.link(bpy.data.objects.new(name, made))
    scene.collection.children.link(group)
    ball = bpy.data.objects.new("ball", bpy.data.metaballs.new("ball"))
    ball.data.elements.new()
    scene.collection.objects.link(ball)
    again = bpy.data.objects.new("again", None)
    again.instance_type, again.instance_collection, again.location = "COLLECTION", group, (0.0, 0.0, 3.0)
    scene.collection.objects.link(again)
    bpy.context.view_layer.update()
    read = read_scene(bpy.context)[0]
    assert sorted(read.objects) == ["ball", "curve", "curve", "floor", "text", "text"]
    assert sorted(f.object for f in read.health if f.finding.startswith("it is no mesh")) == ["ball", "curve", "text"]
    assert not read_scene(bpy.context, lambda name: name == "floor")[0].health


def test_modifiers_that_keep_the_polygons_are_written_to_the_mesh(cells):
    floor = lit_room()
    modifier = floor.modifiers.new("wave", "SIMPLE_DEFORM")
    modifier.deform_method, modifier.angle = "BEND", 0.5
    before = set(bpy.data.objects.keys())
    bake_ours(cells)
    assert "Radiosity" in floor.data.color_attributes
    assert set(bpy.data.objects.keys()) == before


def test_modifiers_that_change_the_polygons_write_to_a_copy(cells):
    """The result is an object of its own; the next bake replaces it, and never reads it as scene."""
    floor = lit_room()
    floor.modifiers.new("array", "ARRAY").count = 2
    job = bake_ours(cells)
    copy = bpy.data.objects["floor_radiosity"]
    assert len(copy.data.polygons) == 32
    assert not copy.modifiers
    assert "Radiosity" in copy.data.color_attributes
    assert "Radiosity" not in floor.data.color_attributes
    assert floor.hide_render
    first = colors(copy.data, "Radiosity")
    objects = set(bpy.data.objects.keys())
    again = bake_ours(cells)
    assert set(bpy.data.objects.keys()) == objects
    assert again.scene.objects == job.scene.objects
    assert np.array_equal(colors(bpy.data.objects["floor_radiosity"].data, "Radiosity"), first)


def many_modified(count):
    """Cubes whose modifiers change their polygons, above a floor."""
    lit_room()
    for k in range(count):
        cube(f"cube {k}", 0.1, location=(0.2 * k - 1, 0, 0.5)).modifiers.new("finer", "SUBSURF")


@pytest.mark.parametrize("options", [{}, {"mesh": "subdivide", "max_edge": 0.5}, {"target": "lightmap"}])
def test_copies_are_made_without_evaluating_the_scene_for_each(cells, options):
    """Blender evaluates it as often for ten objects as for two, the first time and when they have copies."""
    evaluated = {}
    for count in (2, 10):
        many_modified(count)
        updates = []

        def note(scene, depsgraph, updates=updates):
            updates.append(1)

        bpy.app.handlers.depsgraph_update_post.append(note)
        try:
            for _ in range(2):
                bake_ours(cells, error=0.5, texels_per_meter=4, **options)
                evaluated.setdefault(count, []).append(len(updates))
        finally:
            bpy.app.handlers.depsgraph_update_post.pop()
        copies = [o for o in bpy.data.objects if o.get("cell_radiosity_of", "").startswith("cube")]
        assert len(copies) == count
        assert not [m for m in bpy.data.meshes if not m.users]
    assert evaluated[2] == evaluated[10] > [0, 0]


def test_a_copy_follows_modifiers_that_make_another_shape_of_as_many_faces(cells):
    """It is made anew by each bake, but not while the light of one comes; a material that was set up for it stays."""
    floor = lit_room()
    floor.modifiers.new("finer", "SUBSURF").subdivision_type = "SIMPLE"
    floor.modifiers.new("up", "DISPLACE").strength = 0.0
    bake_ours(cells)
    copy = bpy.data.objects["floor_radiosity"]
    set_up([copy], "Radiosity", "EMISSION")
    (material,) = copy.data.materials
    floor.modifiers["up"].strength = 0.25
    bpy.context.view_layer.update()
    job = Job(bpy.context, Options(), cells=cells)
    for progress in job.bake():
        light = job.so_far(progress)
        if light is not None:
            run(job.output.painting(bpy.context, job.targets, job.output.preview(light)))
            shown = bpy.data.objects["floor_radiosity"].session_uid
    job.write(bpy.context)
    copy = bpy.data.objects["floor_radiosity"]
    assert copy.session_uid == shown
    assert {round(v.co.z, 5) for v in copy.data.vertices} == {0.125}  # displacement is from a middle level of a half
    assert list(copy.data.materials) == [material]


@pytest.mark.parametrize("options", [{}, {"mesh": "subdivide", "max_edge": 0.5}, {"target": "lightmap"}])
@pytest.mark.parametrize("fate", ["deleted", "renamed", "linked"])
def test_a_copy_without_its_original_is_an_object_like_any_other(cells, tmp_path, options, fate):
    """It casts light and shadow and takes its own light, in its own colors: nothing vanishes from the next bake."""
    floor = lit_room()
    floor.modifiers.new("finer", "SUBSURF").subdivision_type = "SIMPLE"
    floor.data.materials.append(diffuse("green", (0.1, 0.7, 0.1)))
    bake_ours(cells, error=0.5, texels_per_meter=4, **options)
    copy, others = "floor_radiosity", ["wall"]
    if fate == "deleted":
        bpy.data.objects.remove(floor)
    elif fate == "renamed":
        floor.name = "ground"
    else:
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
        empty()
        with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, wanted):
            wanted.objects = ["floor", copy]
        for object in wanted.objects:
            bpy.context.scene.collection.objects.link(object)
        lamp("POINT", 300.0, location=(-0.3, 0.2, 1.2))
        others = [plane("ceiling", n=2, location=(0, 0, 2)).name]
    job = bake_ours(cells, error=0.5)
    assert sorted(job.scene.objects) == sorted([copy, *others])
    assert stand_ins(bpy.context.scene) == []  # so that Clear Result leaves it where it is
    number = job.scene.polygon_material[job.scene.polygon_object == job.scene.objects.index(copy)]
    assert {job.scene.materials[k].name for k in number} == {"green"}
    assert ("Radiosity" in bpy.data.objects[copy].data.color_attributes) == (
        fate != "linked" or not options.get("target")
    )


def test_shared_meshes_get_a_copy_each(cells):
    """Linked duplicates: each has its own light afterwards, none is overwritten by another's."""
    floor = lit_room()
    twin = bpy.data.objects.new("twin", floor.data)
    twin.location = (0, 0, -3)
    bpy.context.scene.collection.objects.link(twin)
    job = bake_ours(cells)
    assert floor.data != twin.data
    report = job.report("")["copies"]
    assert report["meshes"] == 1
    vertices, edges, faces, corners = (len(getattr(twin.data, n)) for n in ("vertices", "edges", "polygons", "loops"))
    assert report["memory_mb"] == pytest.approx((12 * vertices + 8 * edges + 4 * faces + 8 * corners) / 1e6, rel=0.3)
    assert bake_ours(cells).report("")["copies"] == {"meshes": 0, "memory_mb": 0}  # each has its own now
    assert colors(floor.data, "Lighting").mean() > 2 * colors(twin.data, "Lighting").mean()


@pytest.mark.parametrize(
    "how", [{}, {"mesh": "subdivide"}, {"target": "lightmap"}], ids=["vertices", "finer", "lightmap"]
)
def test_objects_renamed_during_a_bake_get_their_own_light(cells, how):
    """Two that take each other's names, too; one that takes a deleted one's name gets nothing of it."""
    lit_room()
    bpy.data.objects["floor"].data.materials.append(diffuse("black", (0.01, 0.01, 0.01)))
    cube("gone", location=(0.5, 0.5, 0.5), size=0.3)
    job = Job(bpy.context, Options(error=0.1, **how), cells=cells)
    run(job.bake())
    floor, wall = bpy.data.objects["floor"], bpy.data.objects["wall"]
    bpy.data.objects.remove(bpy.data.objects["gone"])
    floor.name, wall.name = "other", "floor"
    floor.name = "wall"
    cube("gone", location=(0.5, 0.5, 0.5), size=0.3)
    job.write(bpy.context)
    assert [f.object for f in job.changed] == ["gone"]
    if how.get("target") == "lightmap":
        assert {"wall_radiosity", "floor_radiosity"} <= set(bpy.data.objects.keys())
        assert len(bpy.data.objects["wall_radiosity"].data.vertices) >= len(floor.data.vertices)
        return
    ends = {o.name: bpy.data.objects.get(f"{o.name}_radiosity", o).data for o in (floor, wall)}
    assert colors(ends["wall"], "Radiosity").max() < 0.05 * colors(ends["wall"], "Lighting").max()  # the black one
    assert colors(ends["floor"], "Radiosity").max() > 0.5 * colors(ends["floor"], "Lighting").max()


def test_copies_that_memory_cannot_hold_are_refused_by_name(cells):
    floor = lit_room()
    dense = plane("dense", n=100)
    for k in range(6):
        bpy.context.scene.collection.objects.link(bpy.data.objects.new(f"twin {k}", floor.data))
        bpy.context.scene.collection.objects.link(bpy.data.objects.new(f"dense twin {k}", dense.data))
    with pytest.raises(
        Refused, match=r"^dense: 12 copies of shared meshes take 0.00\d+ GB; fewer objects, or --shared skip"
    ):
        bake_ours(cells, memory=1e5)
    with pytest.raises(Refused, match=r"^floor: 1 copies"):  # one of them may keep the mesh where all others stay
        bake_ours(cells, memory=10, objects=("floor",))
    assert dense.data.users == 7


def test_shared_meshes_can_be_skipped(cells):
    floor = lit_room()
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("twin", floor.data))
    job = bake_ours(cells, shared="skip")
    assert "Radiosity" not in floor.data.color_attributes
    assert "Radiosity" in bpy.data.objects["wall"].data.color_attributes
    assert {"floor", "twin"} == {f.object for f in job.result.survey.health}


def test_linked_meshes_are_refused_by_name(cells, tmp_path):
    """Writing to a linked mesh succeeds, and is lost when the file is saved."""
    lit_room()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    lit_room()
    bpy.data.objects.remove(bpy.data.objects["floor"])
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, wanted):
        wanted.objects = ["floor"]
    bpy.context.scene.collection.objects.link(wanted.objects[0])
    job = bake_ours(cells)
    assert "Radiosity" in bpy.data.objects["wall"].data.color_attributes
    assert [f.object for f in job.result.survey.health] == ["floor"]
    assert job.scene.objects.count("floor") == 1  # it casts light all the same


def test_a_linked_object_of_the_same_name_is_left_alone(cells, tmp_path):
    """What steps aside for a copy, and what is out of renders, is told by the object and not by its name."""
    lit_room()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    scene = empty()
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, wanted):
        wanted.objects = ["floor", "wall"]
    linked, unseen = wanted.objects
    for name, object in ("linked", linked), ("unseen", unseen):
        collection = bpy.data.collections.new(name)
        scene.collection.children.link(collection)
        collection.objects.link(object)
    bpy.data.collections["unseen"].hide_render = True
    lamp("POINT", 300.0, location=(0.2, 0.1, 1.5))
    own = plane("floor", n=4, location=(0, 0, 3))
    own.modifiers.new("finer", "SUBSURF").subdivision_type = "SIMPLE"
    wall = plane("wall", n=2, location=(0, 2, 0))
    for _ in range(2):
        job = bake_ours(cells, error=0.1)
        assert sorted(job.scene.objects) == ["floor", "floor", "wall"]  # of the linked, one
        assert (own.hide_render, own.hide_viewport, wall.hide_render) == (True, True, False)
        assert (linked.hide_render, linked.hide_viewport) == (False, False)
        assert "Radiosity" in bpy.data.objects["floor_radiosity"].data.color_attributes
        assert "Radiosity" in wall.data.color_attributes
        assert not linked.data.color_attributes
    remove_copies(Lookup(scene), [bpy.data.objects["floor_radiosity"]])
    assert (own.hide_render, own.hide_viewport) == (False, False)


def test_an_attribute_of_the_layers_name_that_is_not_ours_stops_the_bake(cells):
    floor = lit_room()
    floor.data.attributes.new("Lighting", "FLOAT", "POINT")
    with pytest.raises(Refused, match=r"floor.*'Lighting'"):
        bake_ours(cells)
    assert "Radiosity" not in bpy.data.objects["wall"].data.color_attributes


def test_domains_and_layers(cells):
    """Direct + Indirect = Lighting; a POINT layer is the mean of the corners; colors above 1 are kept."""
    floor = lit_room()
    bake_ours(cells, layers=("Radiosity", "Lighting", "Direct", "Indirect"))
    corner = {n: colors(floor.data, n) for n in ("Radiosity", "Lighting", "Direct", "Indirect")}
    np.testing.assert_allclose(corner["Direct"] + corner["Indirect"], corner["Lighting"], rtol=1e-6)
    np.testing.assert_allclose(corner["Radiosity"], 0.8 * corner["Lighting"], rtol=1e-6)
    assert corner["Lighting"].max() > 1
    bake_ours(cells, layers=("Lighting",), domain="POINT")
    assert floor.data.color_attributes["Lighting"].domain == "POINT"
    vertex = [loop.vertex_index for loop in floor.data.loops]
    mean = np.stack([np.bincount(vertex, corner["Lighting"][:, c]) for c in range(3)], 1) / np.bincount(vertex)[:, None]
    np.testing.assert_allclose(colors(floor.data, "Lighting"), mean, rtol=1e-5)
    assert floor.data.color_attributes.active_color.name == "Lighting"


def ball(smooth):
    """A sphere on a floor in even light."""
    empty(world=(1, 1, 1))
    import bmesh

    mesh = bpy.data.meshes.new("ball")
    b = bmesh.new()
    bmesh.ops.create_uvsphere(b, u_segments=24, v_segments=12, radius=1.0)
    b.to_mesh(mesh)
    mesh.polygons.foreach_set("use_smooth", [smooth] * len(mesh.polygons))
    made = bpy.data.objects.new("ball", mesh)
    bpy.context.scene.collection.objects.link(made)
    plane("floor", size=6.0, n=4, location=(0, 0, -1.2), material=diffuse("black", (0, 0, 0)))
    return made


def corner_spread(mesh, values):
    """Largest difference (V,) between the corners of each vertex."""
    vertex = np.array([loop.vertex_index for loop in mesh.loops])
    high, low = np.full(len(mesh.vertices), -np.inf), np.full(len(mesh.vertices), np.inf)
    np.maximum.at(high, vertex, values)
    np.minimum.at(low, vertex, values)
    return high - low


@pytest.mark.parametrize("domain", ["CORNER", "POINT"])
def test_a_smooth_ball_shows_no_facets(cells, domain):
    """Corners of a vertex agree, and light falls evenly from top to bottom: neighbors along a ring are alike."""
    made = ball(smooth=True)
    bake_ours(cells, layers=("Lighting",), domain=domain, error=0.005)
    values = colors(made.data, "Lighting")[:, 0]
    if domain == "CORNER":
        assert corner_spread(made.data, values).max() == 0.0
        vertex = np.array([loop.vertex_index for loop in made.data.loops])
        values = np.bincount(vertex, values) / np.bincount(vertex)
    height = np.array([v.co.z for v in made.data.vertices]).round(4)
    for z in np.unique(height):
        ring = values[height == z]
        assert np.ptp(ring) < 0.045


@pytest.mark.parametrize("domain", ["CORNER", "POINT"])
def test_a_flat_cube_has_clean_edges(cells, domain):
    """In even light from above: the corners of one face are alike, and differ from those of the next face."""
    empty()
    block = cube()
    lamp("SUN", 3.0, angle=0.0, rotation_euler=(0.5, 0.3, 0))
    bake_ours(cells, layers=("Lighting",), domain=domain)
    values = colors(block.data, "Lighting")[:, 0]
    if domain == "POINT":
        assert np.isfinite(values).all()
        return
    for p in block.data.polygons:
        assert np.ptp(values[p.loop_start : p.loop_start + 4]) < 1e-6
    assert len(np.unique(values.round(5))) >= 3


def test_bad_data_in_one_object_is_named_and_the_rest_is_baked(cells):
    floor = lit_room()
    bad = mesh_object("bad", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 2)], [(0, 1, 2, 3), (0, 1, 4)])
    bad.data.vertices[4].co = (float("nan"), 0, 0)
    flat = mesh_object("flat", [(0, 0, 1), (1, 0, 1), (2, 0, 1)], [(0, 1, 2)])
    empty_slot = plane("empty slot", n=1, location=(0, 0, -0.5))
    empty_slot.data.materials.append(None)
    job = bake_ours(cells)
    named = {f.object for f in job.result.survey.health}
    assert {"bad", "flat", "empty slot"} <= named
    assert np.isfinite(colors(floor.data, "Lighting")).all()
    assert colors(floor.data, "Lighting").max() > 0
    assert np.isfinite(colors(bad.data, "Lighting")).all()
    assert not colors(flat.data, "Lighting").any()
    with pytest.raises(Refused, match=r"bad|flat|empty slot"):
        bake_ours(cells, strict=True)


@pytest.mark.parametrize("split", [False, True])
def test_triangles_are_blenders_own(split):
    """Those of quads and of a polygon with a bay; and of triangles alone, for which it is not asked."""
    empty()
    floor = plane("floor", n=3)
    around = ((0, 0, 1), (4, 0, 1), (4, 4, 1), (2, 1, 1), (0, 4, 1))
    bay = mesh_object("bay", around, [(0, 1, 2, 3, 4)])
    if split:
        for object in (floor, bay):
            object.modifiers.new("Triangulate", "TRIANGULATE")
    scene = read()
    expected = {}
    for object in (floor, bay):
        mesh = object.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
        expected[object.name] = [list(t.loops) for t in mesh.loop_triangles]
        assert all(len(p.vertices) == 3 for p in mesh.polygons) == split
    for k, name in enumerate(scene.objects):
        own = scene.polygon_object[scene.triangle_polygon] == k
        first = scene.polygon_start[np.flatnonzero(scene.polygon_object == k)[0]]
        assert (scene.triangle_corner[own] - first).tolist() == expected[name]
        assert len(expected[name]) > 1


@pytest.mark.parametrize("shading", ["FACE", "POINT", "CORNER"])
def test_normals_are_blenders_own(shading):
    """Of flat and smooth meshes, and of one with a sharp edge, also of a mirrored object, whose polygons run backward."""
    empty()
    box = cube(scale=(-1, 1, 1))
    mesh = box.data
    if shading != "FACE":
        mesh.shade_smooth()
    if shading == "CORNER":
        mesh.edges[0].use_edge_sharp = True
    assert mesh.normals_domain == shading
    expected = np.array([n.vector[:] for n in mesh.corner_normals]) * (-1, 1, 1)
    order = np.concatenate([list(p.loop_indices)[::-1] for p in mesh.polygons])
    np.testing.assert_allclose(read().corner_normal, expected[order], atol=1e-6)
