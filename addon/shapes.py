"""Meshes of evaluated objects as arrays, and the materials and images that they have.

Owns how they are read: each once, however many objects share it, and as arrays that are copied out of Blender whole.
"""

from __future__ import annotations

from ctypes import c_int32
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from ..core.health import Finding
from ..core.scene import Mesh
from ..core.surfaces import Texture
from .marks import is_made, shown_for
from .materials import NotConstant, node_tree, read_alpha, read_material, read_pixels, unread_images, viewport_material

NAMED = 3  # objects by name where more have the same material


@dataclass(frozen=True)
class Shape:
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


class Reader:
    """Shapes, materials and images, each read once, and what was found on the way. unread: numbers of the materials
    whose nodes are not understood."""

    def __init__(self):
        self.materials, self.textures, self.ignored, self.health = [], [], [], []
        self.unread = set()
        self._numbers, self._images, self._uv_maps, self._shapes, self._begun = {}, {}, {}, {}, {}
        self._left_out = {}  # {number of a material: what of it cannot be simulated}

    def shape(self, object):
        """The Shape of an evaluated object that was read; None if it has no polygons. Instances of one mesh share it."""
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
        self._shapes[key] = Shape(**self._begun.pop(key))
        return True

    def _parts(self, object, mesh, found):
        """What a Shape is made of, as pairs of a field and a function that reads it; found: {field: what was read}."""
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
                for image in unread_images(node_tree(material)):
                    self.name_unread(image, object)
            if texture is not None:
                read = replace(read, texture=self._texture(texture, object))
            if cut is not None:
                read = replace(read, alpha_texture=self._texture(cut, object))
            if texture or cut:
                self._uv_maps[number] = (texture or cut).uv_map
            self.materials.append(read)
        return self._numbers[key]

    def left_out(self, placed):
        """(objects, reason) of what cannot be simulated of the materials, in words. placed: all that has a `shape`, with
        the object, `original`, that has it."""
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
                self.name_unread(picture.image, object)
            self.textures.append(Texture(picture.image.name, read_pixels(picture)))
        return self._images[key]

    def name_unread(self, image, name):
        """Name an image that cannot be read, and what shows it, once."""
        text = f"its image {image.name} cannot be read: {image.filepath or 'no file'}"
        finding = Finding(name, text, "magenta was taken in its place, as Cycles does")
        self.health += [] if finding in self.health else [finding]


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
