"""Blender meshes made out of others: triangles of their polygons, or pieces of these.

All that a mesh carries comes along: materials, UV maps and other attributes, vertex groups, shape keys, custom normals, sharp
and marked edges, custom properties. Numbers are mixed by the weights of the new vertices and corners; what cannot be mixed
comes from the nearest.
"""

from __future__ import annotations

from dataclasses import dataclass

import bmesh
import bpy
import numpy as np

from .marks import KEY

STRUCTURE = {"position", ".corner_vert", ".corner_edge", ".edge_verts", "custom_normal"}
# What values are called, how many numbers they hold, and whether they can be mixed.
KINDS = {
    "FLOAT": ("value", 1, np.float32, True), "INT": ("value", 1, np.int32, False), "INT8": ("value", 1, np.int32, False),
    "BOOLEAN": ("value", 1, bool, False), "FLOAT_VECTOR": ("vector", 3, np.float32, True),
    "FLOAT2": ("vector", 2, np.float32, True), "FLOAT_COLOR": ("color", 4, np.float32, True),
    "BYTE_COLOR": ("color", 4, np.float32, True), "INT32_2D": ("value", 2, np.int32, False),
    "INT16_2D": ("value", 2, np.int32, False), "QUATERNION": ("value", 4, np.float32, False),
    "FLOAT4X4": ("value", 16, np.float32, False), "STRING": ("value", 1, object, False),
}  # fmt: skip
OF_KEY = (
    "value",
    "mute",
    "slider_min",
    "slider_max",
    "vertex_group",
    "interpolation",
)  # of a shape key, beside its shape


@dataclass(frozen=True)
class Piece:
    """One object's part of a core Remesh, in the numbers of the Blender mesh it is made of.

    part: the Remesh. corner: (C, 3) source corners; polygon: (P,) source polygons; index: (C,) which corner of the whole
    Remesh each one is.
    """

    part: object
    corner: np.ndarray
    polygon: np.ndarray
    index: np.ndarray

    @property
    def first_corner(self):
        """(V,) a corner of every vertex."""
        first = np.zeros(int(self.part.corner_vertex.max(initial=-1)) + 1, np.int64)
        first[self.part.corner_vertex[::-1]] = np.arange(len(self.part.corner_vertex))[::-1]
        return first


def piece_of(scene, remesh, target):
    """The Piece of a scene's Remesh that belongs to a read_scene.Target."""
    first, last = np.searchsorted(scene.polygon_start, [target.first, target.last])
    size = scene.polygon_start[first + 1] - scene.polygon_start[first]
    backward = target.corner[0] > target.corner[size - 1]  # a mirrored object's polygons were turned round
    part, index = remesh.part(first, last, backward)
    return Piece(part, target.corner[part.corner_source - target.first], part.polygon_source - first, index)


def make_mesh(source, name, piece):
    """A new Blender mesh of a Piece. source: the mesh it is made of."""
    part, weight = piece.part, piece.part.corner_weight
    first = piece.first_corner
    vertex = _values(source, ".corner_vert")[piece.corner]
    of_vertex, of_corner = (vertex[first], weight[first]), (piece.corner, weight)
    polygon, count = piece.polygon, len(first)

    mesh = bpy.data.meshes.new(name)
    for material in source.materials:
        mesh.materials.append(material)
    mesh.vertices.add(count)
    mesh.loops.add(len(part.corner_vertex))
    mesh.polygons.add(len(polygon))
    position = _mixed(_values(source, "position"), *of_vertex)
    mesh.vertices.foreach_set("co", position.astype(np.float32).reshape(-1))
    mesh.polygons.foreach_set("loop_start", part.polygon_start[:-1].astype(np.int32))
    mesh.loops.foreach_set("vertex_index", part.corner_vertex.astype(np.int32))
    mesh.update(calc_edges=True)

    origins = {
        "POINT": of_vertex,
        "CORNER": of_corner,
        "FACE": (polygon[:, None], np.ones((len(polygon), 1))),
        "EDGE": _edge_sources(mesh, source, *of_vertex),
    }
    for attribute in source.attributes:
        known = attribute.data_type in KINDS and attribute.domain in origins
        if known and attribute.name not in STRUCTURE and not attribute.name.startswith("."):
            _carry(mesh, source, attribute, *origins[attribute.domain])
    _copy_choices(mesh, source)
    if source.has_custom_normals:
        normal = np.empty(3 * len(source.loops), np.float32)
        source.corner_normals.foreach_get("vector", normal)
        mesh.normals_split_custom_set(_mixed(normal.reshape(-1, 3), *of_corner).tolist())
    mesh.update()
    return mesh


def carried_by(object):
    """What an object and its mesh carry beside what is in the mesh as it is rendered, as `carry` takes it."""
    groups = [(group.name, group.lock_weight) for group in object.vertex_groups]
    return groups, _keys_of(object), {k: v for k, v in object.data.items() if not k.startswith(KEY)}


def carry(object, carried, source, piece):
    """Give an object, whose mesh is `make_mesh`'s, what the object that it is made of carries. source: its mesh."""
    groups, keys, properties = carried
    if groups:
        _carry_groups(object, groups, source, piece)
    if keys:
        _carry_keys(object, keys, source, piece)
    for name, value in properties.items():
        object.data[name] = value


def _carry_groups(object, groups, source, piece):
    first = piece.first_corner
    vertex = _values(source, ".corner_vert")[piece.corner]
    object.vertex_groups.clear()
    for name, locked in groups:
        object.vertex_groups.new(name=name).lock_weight = locked
    given = [{g.group: g.weight for g in v.groups} for v in source.vertices]
    made = bmesh.new()
    made.from_mesh(object.data)
    deform = made.verts.layers.deform.verify()
    for v, sources, weights in zip(made.verts, vertex[first].tolist(), piece.part.corner_weight[first].tolist()):
        for s, w in zip(sources, weights):
            if w:
                for group, value in given[s].items():
                    v[deform][group] = v[deform].get(group, 0.0) + w * value
    made.to_mesh(object.data)
    made.free()


def _keys_of(object):
    """The shape keys of an object as `_carry_keys` takes them: shapes (V, 3), settings, and number of the key that each is
    relative to; and what animates them. None if it has none, or modifiers that go on from their shape."""
    keys = object.data.shape_keys
    if keys is None or len(object.modifiers):
        return None
    blocks, found = list(keys.key_blocks), []
    for block in blocks:
        shape = np.empty(3 * len(block.data), np.float32)
        block.data.foreach_get("co", shape)
        settings = {name: getattr(block, name) for name in OF_KEY}
        found.append((block.name, shape.reshape(-1, 3), settings, blocks.index(block.relative_key)))
    return found, keys.use_relative, keys.eval_time, keys.animation_data


def _carry_keys(object, keys, source, piece):
    found, relative, time, animation = keys
    first = piece.first_corner
    vertex = _values(source, ".corner_vert")[piece.corner][first]
    for name, shape, settings, _ in found:
        block = object.shape_key_add(name=name, from_mix=False)
        values = _mixed(shape, vertex, piece.part.corner_weight[first]).astype(np.float32).reshape(-1)
        block.data.foreach_set("co", values)
        if block == object.data.shape_keys.key_blocks[0]:
            object.data.vertices.foreach_set("co", values)
        for setting in ("slider_min", "slider_max", *settings):  # the sliders' ends first: values lie between them
            setattr(block, setting, settings[setting])
    made = object.data.shape_keys
    for block, (*_, other) in zip(made.key_blocks, found):
        block.relative_key = made.key_blocks[other]
    made.use_relative, made.eval_time = relative, time
    if animation is not None:
        own = made.animation_data_create()
        own.action = animation.action
        if animation.action is not None and hasattr(own, "action_slot"):  # from Blender 4.4 on
            own.action_slot = animation.action_slot
        for driver in animation.drivers:
            own.drivers.from_existing(src_driver=driver)


def _values(mesh, name):
    """(K, n) or (K,) values of an attribute."""
    attribute = mesh.attributes[name]
    prop, size, dtype, _ = KINDS[attribute.data_type]
    if dtype is object:  # Blender gives text one by one
        return np.array([element.value for element in attribute.data], object)
    values = np.empty(len(attribute.data) * size, dtype)
    attribute.data.foreach_get(prop, values)
    return values.reshape(-1, size) if size > 1 else values


def _mixed(values, source, weight):
    """Values (K, ...) mixed from those of sources (K, n) by weights (K, n)."""
    return np.einsum("kn,kn...->k...", weight, values[source].astype(float))


def _carry(mesh, source, attribute, origin, weight):
    """Copy an attribute; origin: (K, n) elements of the source, -1 for none."""
    prop, _, dtype, mixes = KINDS[attribute.data_type]
    values = _values(source, attribute.name)
    made = mesh.attributes.get(attribute.name)
    if made is None:
        made = mesh.attributes.new(attribute.name, attribute.data_type, attribute.domain)
    if made is None or len(made.data) != len(origin) or made.data_type != attribute.data_type or not len(values):
        return  # Blender allows no more UV maps than it does
    if mixes and origin.shape[1] > 1:
        result = _mixed(values, origin, weight)
    else:
        nearest = np.take_along_axis(origin, weight.argmax(axis=1)[:, None], axis=1)[:, 0]
        found = nearest >= 0
        if dtype is object:
            for k in np.flatnonzero(found).tolist():
                made.data[k].value = values[nearest[k]]
            return
        result = np.where(found.reshape(-1, *[1] * (values.ndim - 1)), values[nearest], 0)
    made.data.foreach_set(prop, np.ascontiguousarray(result, dtype).reshape(-1))


def _edge_sources(mesh, source, vertex, weight):
    """The source's edge along which each edge of a new mesh lies, -1 for none: (E, 1), with weights of 1."""
    # The one or two old vertices between which each new one lies; those inside a triangle have three, and no edge.
    used = weight > 0
    low = np.where(used, vertex, np.iinfo(vertex.dtype).max).min(axis=1)
    high = np.where(used, vertex, -1).max(axis=1)
    inside = (used & (vertex != low[:, None]) & (vertex != high[:, None])).any(axis=1)
    ends = np.empty(2 * len(mesh.edges), np.int32)
    mesh.edges.foreach_get("vertices", ends)
    ends = ends.reshape(-1, 2)
    a, b = low[ends].min(axis=1), high[ends].max(axis=1)
    on = ~inside[ends].any(axis=1) & (a != b)
    for k in range(2):
        on &= ((low[ends[:, k]] == a) | (low[ends[:, k]] == b)) & ((high[ends[:, k]] == a) | (high[ends[:, k]] == b))
    old = np.empty(2 * len(source.edges), np.int32)
    source.edges.foreach_get("vertices", old)
    old = np.sort(old.reshape(-1, 2), axis=1).astype(np.int64)
    size = len(source.vertices)
    key = old[:, 0] * size + old[:, 1]
    order = np.argsort(key, kind="stable")
    wanted = np.where(on, a * size + b, -1)
    place = np.minimum(np.searchsorted(key[order], wanted), max(len(key) - 1, 0))
    edge = np.where(key[order[place]] == wanted, order[place], -1) if len(key) else np.full(len(ends), -1)
    return edge[:, None], np.ones((len(edge), 1))


def _copy_choices(mesh, source):
    """Which UV map and which color attribute is the active one."""
    if source.uv_layers.active is not None and source.uv_layers.active.name in mesh.uv_layers:
        mesh.uv_layers.active = mesh.uv_layers[source.uv_layers.active.name]
    for layer in source.uv_layers:
        if layer.active_render and layer.name in mesh.uv_layers:
            mesh.uv_layers[layer.name].active_render = True
    if source.color_attributes.active_color_name in mesh.color_attributes:
        mesh.color_attributes.active_color_name = source.color_attributes.active_color_name
