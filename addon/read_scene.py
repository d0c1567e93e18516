"""Read a Blender scene into the core's `Scene`: meshes as they render, materials, lamps, world.

Owns what takes part in a bake and where its light may go. Nothing in the file is changed.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from math import inf
from time import perf_counter

import bpy
import numpy as np
from mathutils import Matrix

from ..core.bake import run
from ..core.health import Finding
from ..core.scene import join_meshes
from .cycles_read import CannotRead, Unread, read_with_cycles
from .lamps import read_lamp, read_visibility
from .marks import originals_shown, stand_ins
from .material_setup import passed_by
from .materials import node_tree, unread_images
from .shapes import Reader, mirrored
from .steps import aside, in_steps
from .world_read import read_world

NOT_WRITTEN = "its light was not written"
LEFT_OUT = {"CURVES": "hair", "VOLUME": "a volume", "POINTCLOUD": "a point cloud", "GREASEPENCIL": "a drawing"}
LEFT_OUT["GPENCIL"] = LEFT_OUT["GREASEPENCIL"]  # in older Blenders
SOLID = {"MESH", "CURVE", "SURFACE", "META", "FONT"}


@dataclass(frozen=True)
class Target:
    """Where the light of one object of the scene goes.

    object: name of the Blender object as it was read; uid: Blender's number for it, whatever it is called. first, last:
    its corners in the scene, first to last. corner: (last - first,) number of each of them in the evaluated mesh. vertex:
    (last - first,) of each corner of that mesh; vertices: how many it has. same: it has the corners of the object's own.
    """

    object: str
    uid: int
    first: int
    last: int
    corner: np.ndarray
    vertex: np.ndarray
    vertices: int
    same: bool


def read_scene(context, wanted=None, shared="copy", spacing=1 / 200):
    """The core's Scene of a context's scene in its current frame, and the Targets that can be written.

    wanted: function of an object's name, whether its light is asked for; None asks for all. What is asked for never
    limits what casts light. shared: "skip" writes nothing to meshes that several objects share. spacing: of samples on
    surfaces that only Cycles understands, in scene diagonals.
    """
    return run(reading_scene(context, wanted, shared, spacing))


def reading_scene(context, wanted=None, shared="copy", spacing=1 / 200, step=inf):
    """`read_scene` in steps of some `step` seconds: a generator that yields between objects. The scene must not change
    meanwhile."""
    # What earlier bakes have put before the scene steps aside while it is read.
    with originals_shown(context.scene), passed_by():
        context.view_layer.update()
        return (yield from _reading(context, wanted, shared, spacing, step))


def _reading(context, wanted, shared, spacing, step):
    depsgraph = context.evaluated_depsgraph_get()
    scene = depsgraph.scene
    rendered, copies = rendered_objects(scene), {o.session_uid for o in stand_ins(scene)}
    reader = Reader()
    lamps, placed = [], []
    # Blender's list of instances does not outlive a step: it is walked anew, past the shapes that are known by then.
    while not _place(depsgraph, rendered, copies, reader, wanted, lamps, placed, perf_counter() + step):
        yield
        depsgraph = context.evaluated_depsgraph_get()
    scene = depsgraph.scene
    names = [p.original.name for p in placed]
    meshes = yield from aside(step, lambda: [p.shape.placed(name, p.matrix) for p, name in zip(placed, names)])
    orders = yield from aside(step, lambda: [p.shape.corner_order(mirrored(p.matrix)) for p in placed])

    corner = np.concatenate([[0], np.cumsum([len(m.corner_vertex) for m in meshes])]).astype(int)
    users = Counter(o.data for o in bpy.data.objects if o.type == "MESH") if shared == "skip" else Counter()
    written = [p.own and _writable(p.original, users, reader.health) for p in placed]
    targets = []
    for k in np.flatnonzero(written):
        original, shape = placed[k].original, placed[k].shape
        same = yield from in_steps(shape.same_as(original.data), step)
        own = orders[k], shape.corner_vertex, len(shape.vertices)
        targets.append(Target(original.name, original.session_uid, corner[k], corner[k + 1], *own, same))
    findings = [*_hidden(scene, depsgraph, rendered), *_only_instances(placed, wanted)]
    sky = scene.world and scene.world.original
    world, suns = read_world(context, sky, reader.ignored)
    for image in unread_images(sky and node_tree(sky)):
        reader.name_unread(image, sky.name)
    yield
    joined = yield from aside(
        step, join_meshes, meshes, reader.materials, lamps + list(suns), world, written, scene.name,
        textures=tuple(reader.textures), shared=np.unique([id(p.shape) for p in placed], return_inverse=True)[1],
        health=tuple(reader.health + findings),
        shading=None if all(p.shading for p in placed) else np.array([p.shading for p in placed]),
    )  # fmt: skip
    readings = _read_others(context, context.evaluated_depsgraph_get(), reader, joined, placed, orders, corner, spacing)
    ignored = dict.fromkeys([*reader.ignored, *reader.left_out(placed)])
    return replace(joined, readings=readings, ignored=tuple(ignored)), tuple(targets)


def _place(depsgraph, rendered, copies, reader, wanted, lamps, placed, deadline):
    """Fill `lamps` and `placed` with all that takes part; False if after the deadline there are shapes left to read."""
    lamps.clear()
    placed.clear()
    news = 0
    for instance in depsgraph.object_instances:
        object = instance.object
        original = object.original
        source = instance.parent.original if instance.is_instance and instance.parent else original
        if (
            original.hide_render
            or source.session_uid not in rendered
            or original.session_uid in copies
            or not instance.show_self
            # The mesh of a text or curve is listed beside the object itself, of which it is read.
            or (object.type == "MESH" != original.type and original.type in SOLID)
        ):
            continue
        if object.type in LEFT_OUT:
            reader.ignored.append((original.name, f"it is {LEFT_OUT[object.type]}: it is left out"))
        if object.type in SOLID | {"LIGHT"}:
            there, shading = read_visibility(original, reader.ignored)
            if not there:
                continue
        matrix = np.array(instance.matrix_world, float)  # newer Blenders would give float32
        if object.type == "LIGHT":
            lamp = read_lamp(object.data, matrix, original.name, reader.ignored)
            lamps.append(lamp) if lamp else None
        elif object.type in SOLID:
            if not reader.knows(object):
                if news and perf_counter() > deadline:
                    return False
                news += 1
                if not reader.read(object, deadline):
                    return False
            shape = reader.shape(object)
            if shape is None:
                continue
            own = not instance.is_instance and original.type == "MESH" and (wanted is None or wanted(original.name))
            placed.append(_Placed(original, shape, matrix, own, shading))
    return True


def _read_others(context, depsgraph, reader, scene, placed, orders, corner, spacing):
    """The Readings of all surfaces whose material is not understood, or None. orders: of the corners of each placed."""
    if not reader.unread:
        return None
    unread = np.isin(scene.polygon_material, list(reader.unread))[scene.triangle_polygon] & scene.usable
    if not unread.any():
        return None
    owner = scene.polygon_object[scene.triangle_polygon]
    jobs = []
    for k in np.unique(owner[unread]):
        numbers = np.flatnonzero(unread & (owner == k))
        corners = scene.triangle_corner[numbers]
        jobs.append(
            Unread(
                placed[k].original.evaluated_get(depsgraph), Matrix(placed[k].matrix), orders[k][corners - corner[k]],
                numbers, scene.triangle_normal_area[1][numbers],
                scene.polygon_material[scene.triangle_polygon[numbers]], corners,
            )
        )  # fmt: skip
    try:
        return read_with_cycles(context, jobs, spacing * scene.diagonal)
    except CannotRead as problem:
        names = ", ".join(sorted(m.name for k, m in enumerate(scene.materials) if k in reader.unread))
        reader.ignored.append((names, f"its nodes could not be read ({problem}): its viewport color was taken"))
        return None


@dataclass(frozen=True)
class _Placed:
    """A shape where an object or instance stands. own: it is an object whose light is asked for; shading: it casts shadows."""

    original: object
    shape: object
    matrix: np.ndarray
    own: bool
    shading: bool


def rendered_objects(scene):
    """Blender's numbers for the objects in a collection that is rendered: names may be those of linked ones too."""
    found = set()

    def visit(collection):
        if not collection.hide_render:
            found.update(o.session_uid for o in collection.objects)
            for child in collection.children:
                visit(child)

    visit(scene.collection)
    return found


def _hidden(scene, depsgraph, rendered):
    """Findings about meshes and lamps that would be rendered, but that the view layer hides."""
    copies = {o.session_uid for o in stand_ins(scene)}
    seen = {i.object.original.session_uid for i in depsgraph.object_instances}
    return [
        Finding(o.name, "it is hidden in the viewport", "it was left out of the bake, as if it were not there")
        for o in scene.objects
        if o.type in SOLID | {"LIGHT"} and o.session_uid in rendered and o.session_uid not in seen and not o.hide_render
        and o.session_uid not in copies and not o.is_instancer
    ]  # fmt: skip


def _only_instances(placed, wanted):
    """Findings about what is asked for but has no mesh to write to: instances of meshes, and texts, curves and the like."""
    asked = [p.original for p in placed if not p.own and (wanted is None or wanted(p.original.name))]
    for name, count in Counter(o.name for o in asked if o.type == "MESH").items():
        action = f"{NOT_WRITTEN}: make instances real to bake them"
        yield Finding(name, f"{count} of it are instances, which cast light but hold none", action)
    for name in dict.fromkeys(o.name for o in asked if o.type != "MESH"):
        yield Finding(
            name, "it is no mesh: it casts light but holds none", f"{NOT_WRITTEN}: convert it to a mesh to bake it"
        )


def _writable(object, users, health):
    """Whether an object's light can be written; if not, `health` says why."""
    if (
        object.library or not object.data.is_editable or object.data.override_library
    ):  # of which files keep no attributes
        action = f"{NOT_WRITTEN}: make it local to bake it"
        health.append(Finding(object.name, "its mesh is linked from another file", action))
        return False
    if users[object.data] > 1:
        text = f"its mesh is shared by {users[object.data]} objects"
        health.append(Finding(object.name, text, f"{NOT_WRITTEN}, as asked for; --shared copy gives it its own"))
        return False
    return True
