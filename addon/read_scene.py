"""Read a Blender scene into the core's `Scene`: meshes as they render, materials, lamps, world.

Owns what takes part in a bake and in which form. Arrays are copied out of Blender whole, through attributes; nothing
in the file is changed.
"""

from __future__ import annotations

from collections import Counter
from ctypes import c_int32
from dataclasses import dataclass, replace
from math import inf
from time import perf_counter

import bpy
import numpy as np
from mathutils import Matrix

from ..core.bake import run
from ..core.health import Finding
from ..core.scene import Mesh, join_meshes
from ..core.surfaces import Texture
from .cycles_read import CannotRead, Unread, read_with_cycles
from .lamps import read_lamp, read_visibility
from .marks import is_made, originals_shown, shown_for, stand_ins
from .material_setup import passed_by
from .materials import NotConstant, read_alpha, read_material, read_pixels, viewport_material
from .steps import aside, in_steps
from .world_read import read_world

NOT_WRITTEN = "its light was not written"
LEFT_OUT = {"CURVES": "hair", "VOLUME": "a volume", "POINTCLOUD": "a point cloud", "GREASEPENCIL": "a drawing"}
LEFT_OUT["GPENCIL"] = LEFT_OUT["GREASEPENCIL"]  # in older Blenders
NAMED = 3  # objects by name where more have the same material
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
    reader = _Reader()
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
    world, suns = read_world(context, scene.world and scene.world.original, reader.ignored)
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


@dataclass(frozen=True)
class _Shape:
    """A mesh in its own space, as Blender's arrays, float32. corner arrays are in Blender's order. normal: of every
    corner, vertex or polygon, as normals_domain says; uv_maps: {number of a material with an image: (C, 2)}."""

    polygon_start: np.ndarray
    vertices: np.ndarray
    corner_vertex: np.ndarray
    normals_domain: str
    normal: np.ndarray
    triangle_corner: np.ndarray
    triangle_polygon: np.ndarray
    polygon_material: np.ndarray
    uv_maps: dict

    def corner_order(self, backward):
        """(C,) Blender's number of each corner in the order of the scene: a mirrored object's polygons run backward."""
        order = np.arange(len(self.corner_vertex))
        if backward:
            size = np.diff(self.polygon_start)
            order = np.repeat(self.polygon_start[:-1] + self.polygon_start[1:] - 1, size) - order
        return order

    def placed(self, name, matrix):
        """The core's Mesh of this shape under a world matrix (4, 4)."""
        linear, offset = matrix[:3, :3], matrix[:3, 3]
        flip = mirrored(matrix)
        order = self.corner_order(flip)
        with np.errstate(invalid="ignore", over="ignore"):
            vertices = np.einsum("ij,kj->ki", linear, self.vertices.astype(float)) + offset
            normal = np.einsum("ij,kj->ki", _cofactor(linear), self.normal.astype(float)) * (-1.0 if flip else 1.0)
            length = np.sqrt((normal * normal).sum(axis=1, keepdims=True))
            normal = np.where(length > 0, normal / np.where(length > 0, length, 1.0), 0.0)
        if self.normals_domain == "POINT":
            normal = np.take(normal, self.corner_vertex, axis=0)
        elif self.normals_domain == "FACE":
            normal = np.repeat(normal, np.diff(self.polygon_start), axis=0)
        uv = self._corner_uv()
        place = np.empty(len(order), np.int64)
        place[order] = np.arange(len(order))
        return Mesh(
            name=name,
            vertices=vertices,
            polygon_start=self.polygon_start,
            corner_vertex=self.corner_vertex[order],
            corner_normal=normal[order],
            triangle_corner=place[self.triangle_corner[:, ::-1] if flip else self.triangle_corner],
            triangle_polygon=self.triangle_polygon,
            polygon_material=self.polygon_material,
            corner_uv=None if uv is None else uv[order],
        )

    def _corner_uv(self):
        """(C, 2) place of every corner in its material's texture, or None if no material has one."""
        if not self.uv_maps:
            return None
        uv = np.zeros((len(self.corner_vertex), 2))
        material = np.repeat(self.polygon_material, np.diff(self.polygon_start))
        for number, values in self.uv_maps.items():
            chosen = material == number
            uv[chosen] = values[chosen]
        return uv

    def same_as(self, mesh):
        """Whether a Blender mesh has the same polygons of the same vertices: a generator that yields between looks."""
        if len(mesh.loops) != len(self.corner_vertex) or len(mesh.polygons) != len(self.polygon_start) - 1:
            return False
        for own, look in ((self.corner_vertex, _corner_vertex), (self.polygon_start, _polygon_start)):
            yield
            if not np.array_equal(look(mesh), own):
                return False
        return True


def mirrored(matrix):
    """Whether a world matrix (4, 4) turns left into right."""
    return bool(np.isfinite(matrix).all() and np.linalg.det(matrix[:3, :3]) < 0)


def _cofactor(m):
    """The matrix (3, 3) that turns normals: the inverse transpose times the determinant, so it exists when flat too."""
    return np.stack([np.cross(m[1], m[2]), np.cross(m[2], m[0]), np.cross(m[0], m[1])])


class _Reader:
    """Shapes, materials and images, each read once, and what was found on the way. unread: numbers of the materials
    whose nodes are not understood."""

    def __init__(self):
        self.materials, self.textures, self.ignored, self.health = [], [], [], []
        self.unread = set()
        self._numbers, self._images, self._uv_maps, self._shapes, self._begun = {}, {}, {}, {}, {}
        self._left_out = {}  # {number of a material: what of it cannot be simulated}

    def shape(self, object):
        """The _Shape of an evaluated object that was read; None if it has no polygons. Instances of one mesh share it."""
        return self._shapes[_shape_key(object)]

    def knows(self, object):
        """Whether an evaluated object's shape has been read."""
        return _shape_key(object) in self._shapes

    def read(self, object, deadline):
        """Read the shape of an evaluated object, or go on with it; False if after the deadline there is more to read.
        What must be made of its object first (a curve, a text) is read at once."""
        key = _shape_key(object)
        mesh, found = object.to_mesh(), self._begun.setdefault(key, {})
        try:
            if mesh is None or not len(mesh.polygons):
                self._shapes[key] = None
                return True
            for name, read in self._parts(object, mesh, found):
                if name not in found:
                    found[name] = read()
                    if perf_counter() > deadline and object.type == "MESH":
                        return False
        finally:
            object.to_mesh_clear()
        self._shapes[key] = _Shape(**self._begun.pop(key))
        return True

    def _parts(self, object, mesh, found):
        """What a _Shape is made of, as pairs of a field and a function that reads it; found: {field: what was read}."""
        # Where normals go with vertices or polygons, Blender need not copy them to corners first.
        domain = mesh.normals_domain
        normals = {"POINT": mesh.vertex_normals, "FACE": mesh.polygon_normals, "CORNER": mesh.corner_normals}[domain]
        vertices = mesh.attributes["position"].data
        return (
            ("polygon_start", lambda: _polygon_start(mesh)),
            ("vertices", lambda: _values(vertices, "vector", 3 * len(mesh.vertices)).reshape(-1, 3)),
            ("corner_vertex", lambda: _corner_vertex(mesh)),
            ("normals_domain", lambda: domain),
            ("normal", lambda: _values(normals, "vector", 3 * len(normals)).reshape(-1, 3)),
            ("triangle_corner", lambda: _triangle_corners(mesh)),
            ("triangle_polygon", lambda: _values(mesh.loop_triangle_polygons, "value", len(mesh.loop_triangles), np.int32)),
            ("polygon_material", lambda: self._polygon_materials(object, mesh)),
            ("uv_maps", lambda: self._read_uv_maps(object, mesh, found["polygon_material"])),
        )  # fmt: skip

    def _read_uv_maps(self, object, mesh, polygon_material):
        """{number of a material with an image: (C, 2) place of every corner in it}, of the mesh's materials."""
        found = {}
        for number in np.unique(polygon_material):
            if number not in self._uv_maps:
                continue
            layer = mesh.uv_layers.get(self._uv_maps[number]) or next(
                (m for m in mesh.uv_layers if m.active_render), None
            )
            if layer is None:
                text = f"its material {self.materials[number].name} has an image, but the mesh has no UV map"
                self.health.append(
                    Finding(object.original.name, text, "the image's first pixel was taken, as Cycles does")
                )
                found[number] = np.zeros((len(mesh.loops), 2), np.float32)
            else:
                found[number] = _values(layer.uv, "vector", 2 * len(mesh.loops)).reshape(-1, 2)
        return found

    def _polygon_materials(self, object, mesh):
        """(P,) number of each polygon's material among all that were read."""
        slots = _slots(object) or [None]
        numbers = np.array([self._material(m, object.original.name) for m in slots], np.int32)
        attribute = mesh.attributes.get("material_index")
        index = np.zeros(len(mesh.polygons), np.int32)
        if attribute is not None:
            index = _values(attribute.data, "value", len(mesh.polygons), np.int32)
        outside = (index < 0) | (index >= len(numbers))
        if outside.any():
            text = f"{int(outside.sum())} faces have a material index outside the {len(numbers)} slots"
            self.health.append(
                Finding(object.original.name, text, "the last slot's material was taken, as Blender does")
            )
        vacant = [k for k, slot in enumerate(object.material_slots) if slot.material is None]
        if vacant:
            used = np.isin(index, vacant).sum()
            if used:
                text = f"{int(used)} faces have an empty material slot"
                self.health.append(
                    Finding(object.original.name, text, "they were taken as diffuse with reflectance 0.8")
                )
        return numbers[np.clip(index, 0, len(numbers) - 1)]

    def _material(self, material, object):
        """Number of a Blender material (or None) among those read."""
        key = material.original.name_full if material else None
        if key not in self._numbers:
            number, left_out = len(self.materials), []
            self._numbers[key], self._left_out[number] = number, left_out
            try:
                read, texture, cut = read_material(material, left_out)
            except NotConstant:
                read, texture = viewport_material(material), None
                alpha, cut = read_alpha(material, left_out)
                read = replace(read, alpha=alpha)
                self.unread.add(number)
            if texture is not None:
                read = replace(read, texture=self._texture(texture, object))
            if cut is not None:
                read = replace(read, alpha_texture=self._texture(cut, object))
            if texture or cut:
                self._uv_maps[number] = (texture or cut).uv_map
            self.materials.append(read)
        return self._numbers[key]

    def left_out(self, placed):
        """(objects, reason) of what cannot be simulated of the materials, in words. placed: all _Placed."""
        users = {number: {} for number, reasons in self._left_out.items() if reasons}
        numbers = {
            id(shape): users.keys() & set(shape.polygon_material.tolist()) for shape in self._shapes.values() if shape
        }
        for p in placed if users else ():
            for number in numbers[id(p.shape)]:
                users[number][p.original.name] = None
        for number, names in users.items():
            more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
            yield from ((", ".join([*names][:NAMED]) + more, reason) for reason in self._left_out[number])

    def _texture(self, picture, object):
        """Number of a Picture among the textures read. object: name of one that shows it."""
        key = (picture.image.name_full, picture.part, picture.inverted)
        if key not in self._images:
            self._images[key] = len(self.textures)
            if not all(picture.image.size):
                text = f"its image {picture.image.name} cannot be read: {picture.image.filepath or 'no file'}"
                finding = Finding(object, text, "magenta was taken in its place, as Cycles does")
                self.health += [] if finding in self.health else [finding]
            self.textures.append(Texture(picture.image.name, read_pixels(picture)))
        return self._images[key]


def _shape_key(object):
    """What tells the shapes of evaluated objects apart."""
    return object.type, object.data.as_pointer(), tuple(_slots(object))


def _slots(object):
    """The materials of an evaluated object by slot, which may be None; those for which ones that a bake made show light."""
    materials = [slot.material for slot in object.material_slots]
    return [shown_for(m) if m is not None and is_made(m) else m for m in materials]


def _values(data, name, count, dtype=np.float32):
    values = np.empty(count, dtype)
    data.foreach_get(name, values)
    return values


def _triangle_corners(mesh):
    """(T, 3) corners of a mesh's triangles."""
    return _in_memory(mesh.loop_triangles, "loops", 3).reshape(-1, 3)


def _corner_vertex(mesh):
    return _values(mesh.attributes[".corner_vert"].data, "value", len(mesh.loops), np.int32)


def _polygon_start(mesh):
    return np.append(_in_memory(mesh.polygons, "loop_start", 1), np.int32(len(mesh.loops)))


def _in_memory(items, name, size):
    """(K * size,) int32 values of Blender's items, of which each is nothing else. Blender would tell them one by one; they
    are copied where they lie if they lie as they should, one after the other."""
    count = len(items)
    if count > 1:
        first, last = items[0].as_pointer(), items[count - 1].as_pointer()
        if last - first == 4 * size * (count - 1):
            values = np.frombuffer((c_int32 * (count * size)).from_address(first), np.int32).copy()
            ends = [np.ravel(getattr(items[k], name)) for k in (0, count - 1)]
            if np.array_equal(values[:size], ends[0]) and np.array_equal(values[-size:], ends[1]):
                return values
    return _values(items, name, count * size, np.int32)


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
    """Findings about meshes whose light is asked for, but of which there are instances: these have no mesh to write to."""
    asked = (p.original for p in placed if not p.own and p.original.type == "MESH")
    for name, count in Counter(o.name for o in asked if wanted is None or wanted(o.name)).items():
        action = f"{NOT_WRITTEN}: make instances real to bake them"
        yield Finding(name, f"{count} of it are instances, which cast light but hold none", action)


def _writable(object, users, health):
    """Whether an object's light can be written; if not, `health` says why."""
    if object.library or not object.data.is_editable:
        action = f"{NOT_WRITTEN}: make it local, or override it, to bake it"
        health.append(Finding(object.name, "its mesh is linked from another file", action))
        return False
    if users[object.data] > 1:
        text = f"its mesh is shared by {users[object.data]} objects"
        health.append(Finding(object.name, text, f"{NOT_WRITTEN}, as asked for; --shared copy gives it its own"))
        return False
    return True
