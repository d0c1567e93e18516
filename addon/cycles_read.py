"""Surface colors that only Cycles knows: any shader graph, read by one-sample bakes of little sample triangles.

The samples are a mesh of their own, in a scene of their own that is removed again; the user's meshes, selection and
scene are not touched. Each sample is a tiny triangle at a known place of a source triangle, with its attributes.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import bpy
import numpy as np

from ..core.sampling import GOLDEN
from ..core.surfaces import Readings
from .marks import made_layers

PASSES = (("DIFFUSE", {"COLOR"}), ("GLOSSY", {"COLOR"}), ("EMIT", set()))
SIZE = 1e-3  # of a sample triangle, as a share of its source's edges
INSET = 0.01  # how far a sample at a corner is moved into its triangle
MOST = 400_000  # samples of one bake; more surface than that is read more coarsely
GLOWING = (
    1 << 14
)  # samples, at least, of the faces of an object and material that emit light: all of it comes from them
WIDTHS = {"FLOAT": ("value", 1), "INT": ("value", 1), "BOOLEAN": ("value", 1), "FLOAT_VECTOR": ("vector", 3),
          "FLOAT2": ("vector", 2), "FLOAT_COLOR": ("color", 4), "BYTE_COLOR": ("color", 4)}  # fmt: skip


class CannotRead(Exception):
    """Cycles could not bake the colors."""


@dataclass(frozen=True)
class Unread:
    """An object with polygons whose material is not understood.

    object: evaluated object. matrix: (4, 4). triangles: (T', 3) int corners of its triangles in the evaluated mesh.
    numbers: (T',) the triangles' numbers in the core's scene; turn: (T', 3) which of the scene's corners each is.
    areas: (T',) [m^2]. materials: (T',) int the material of each. scene_corners: (T', 3) of the core's scene.
    """

    object: object
    matrix: object
    triangles: np.ndarray
    numbers: np.ndarray
    areas: np.ndarray
    materials: np.ndarray
    scene_corners: np.ndarray


def read_with_cycles(context, unread, spacing):
    """The core's Readings of all Unread objects, a sample every `spacing` meters or so, and more of them where there is
    emission. Raises CannotRead."""
    total = sum(u.areas.sum() for u in unread) / spacing**2
    spacing *= max(np.sqrt(total / MOST), 1.0)
    places = [_places(u, np.full(len(u.areas), spacing)) for u in unread]
    colors = _bake(context, [_sample_mesh(u, *p[:2]) for u, p in zip(unread, places)], unread)
    glows = [np.unique(u.materials[p[0][c[2].max(axis=1) > 0]]) for u, p, c in zip(unread, places, colors)]
    count = min(GLOWING, MOST // max(sum(map(len, glows)), 1))
    finer = [_finer(u, spacing, g, count) for u, g in zip(unread, glows)]
    again = [k for k, own in enumerate(finer) if (own < spacing).any()]
    if again:
        for k in again:
            places[k] = _places(unread[k], finer[k])
        chosen = [unread[k] for k in again]
        found = _bake(context, [_sample_mesh(u, *places[k][:2]) for k, u in zip(again, chosen)], chosen)
        colors = [found[again.index(k)] if k in again else own for k, own in enumerate(colors)]
    parts = []
    for u, (row, uv, spread), (diffuse, gloss, emission) in zip(unread, places, colors):
        reflectance, exitance = diffuse + gloss, np.pi * emission
        at_corner = slice(spread, None)
        parts.append(
            Readings(
                u.numbers[row[:spread]], uv[:spread], reflectance[:spread], exitance[:spread],
                u.scene_corners.reshape(-1), reflectance[at_corner], exitance[at_corner],
            )
        )  # fmt: skip
    return Readings(*(np.concatenate([getattr(p, name) for p in parts]) for name in Readings.__dataclass_fields__))


def _finer(unread, spacing, glows, count):
    """(T',) the spacing of samples on triangles, so that those of each material that glows get `count` of them."""
    finer = np.full(len(unread.areas), spacing)
    for material in glows:
        mine = unread.materials == material
        finer[mine] = min(spacing, np.sqrt(unread.areas[mine].sum() / count))
    return finer


def _places(unread, spacing):
    """Places of samples, by the spacing (T',) on each triangle: triangle row (S,), uv (S, 2), and how many of them are spread out; the rest lie at corners."""
    count = np.clip(np.ceil(unread.areas / spacing**2), 1, MOST).astype(np.int64)
    row = np.repeat(np.arange(len(count)), count)
    number = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
    u, v = (number + 0.5) / count[row], ((number + 0.5) * GOLDEN) % 1.0
    fold = u + v > 1.0
    spread = np.stack([np.where(fold, 1 - u, u), np.where(fold, 1 - v, v)], axis=1)
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]) * (1 - 3 * INSET) + INSET
    row = np.concatenate([row, np.repeat(np.arange(len(count)), 3)])
    return row, np.concatenate([spread, np.tile(corners, (len(count), 1))]), len(spread)


def _sample_mesh(unread, row, uv):
    """A Blender mesh of a tiny triangle at each place, with the source's attributes, materials and texture space."""
    source = unread.object.to_mesh()
    try:
        corner = unread.triangles[row]
        vertex = _array(source.attributes[".corner_vert"], "value", 1, np.int32)[:, 0]
        position = _array(source.attributes["position"], "vector", 3)
        weight = np.stack([1 - uv.sum(axis=1), uv[:, 0], uv[:, 1]], axis=1)
        a, b, c = (position[vertex[corner[:, k]]] for k in range(3))
        middle = weight[:, :1] * a + weight[:, 1:2] * b + weight[:, 2:] * c
        places = np.stack([middle, middle + SIZE * (b - a), middle + SIZE * (c - a)], axis=1).reshape(-1, 3)
        mesh = bpy.data.meshes.new("radiosity samples")
        mesh.from_pydata(places, [], np.arange(len(places)).reshape(-1, 3).tolist())
        polygon = _polygon_of_corners(source)[corner[:, 0]]
        skipped = made_layers(source) | {"position", "material_index", "sharp_face"}
        for attribute in source.attributes:
            if attribute.name.startswith(".") or attribute.name in skipped or attribute.data_type not in WIDTHS:
                continue
            field, width = WIDTHS[attribute.data_type]
            values = _array(attribute, field, width)
            if attribute.domain == "FACE":
                values = np.repeat(values[polygon], 3, axis=0)
            elif attribute.domain in {"CORNER", "POINT"}:
                index = corner if attribute.domain == "CORNER" else vertex[corner]
                values = np.repeat(np.einsum("sk,skw->sw", weight, values[index]), 3, axis=0)
            else:
                continue
            _add_attribute(mesh, attribute, field, values)
        for layer in source.uv_layers:
            if layer.active_render and layer.name in mesh.uv_layers:
                mesh.uv_layers[layer.name].active_render = True
        for slot in unread.object.material_slots:
            mesh.materials.append(slot.material.original if slot.material else None)
        index = source.attributes.get("material_index")
        if index is not None:
            slots = _array(index, "value", 1, np.int32)[polygon, 0]
            mesh.polygons.foreach_set("material_index", np.ascontiguousarray(slots))
        mesh.use_auto_texspace = False
        mesh.texspace_location, mesh.texspace_size = source.texspace_location, source.texspace_size
        return mesh
    finally:
        unread.object.to_mesh_clear()


def _add_attribute(mesh, attribute, field, values):
    """Add a copy of an attribute to a sample mesh, with values (3 S, W) at its corners."""
    if attribute.data_type == "FLOAT2" and attribute.domain == "CORNER":
        layer = mesh.uv_layers.new(name=attribute.name, do_init=False)
        made = mesh.attributes.get(layer.name) if layer else None
    elif attribute.data_type.endswith("COLOR"):
        made = mesh.attributes.new(attribute.name, "FLOAT_COLOR", "CORNER")
    else:
        made = mesh.attributes.new(attribute.name, attribute.data_type, "CORNER")
    if made is not None:
        kind = {"INT": np.int32, "BOOLEAN": bool}.get(attribute.data_type, np.float32)
        made.data.foreach_set(field, np.ascontiguousarray(values.astype(kind).reshape(-1)))


def _bake(context, meshes, unread):
    """For each mesh three arrays (S, 3): diffuse and glossy color, and emitted radiance, of its triangles."""
    objects = []
    try:
        for mesh, u in zip(meshes, unread):
            mesh.color_attributes.active_color = mesh.color_attributes.new("radiosity read", "FLOAT_COLOR", "CORNER")
            object = bpy.data.objects.new(u.object.original.name, mesh)
            object.matrix_world = u.matrix
            objects.append(object)
        result = [[] for _ in objects]
        with one_sample_scene(context, objects):
            for kind, parts in PASSES:
                bpy.ops.object.bake(type=kind, pass_filter=parts, target="VERTEX_COLORS")
                for object, found in zip(objects, result):
                    values = _array(object.data.attributes["radiosity read"], "color", 4)[:, :3]
                    found.append(np.nan_to_num(values.reshape(-1, 3, 3).mean(axis=1)))
        return result
    finally:
        for mesh in meshes:
            bpy.data.meshes.remove(mesh)


@contextlib.contextmanager
def one_sample_scene(context, objects):
    """A scene of its own for objects, all selected, in which Cycles bakes with one sample; it and they are removed at the
    end. Raises CannotRead if Cycles fails."""
    scene = bpy.data.scenes.new("radiosity samples")
    try:
        scene.render.engine = "CYCLES"
        scene.cycles.samples, scene.cycles.use_adaptive_sampling, scene.cycles.use_denoising = 1, False, False
        for object in objects:
            scene.collection.objects.link(object)
        layer = scene.view_layers[0]
        layer.update()
        for object in objects:
            object.select_set(True, view_layer=layer)
        layer.objects.active = objects[0]
        with context.temp_override(scene=scene, view_layer=layer, object=objects[0], active_object=objects[0],
                                   selected_objects=objects, selected_editable_objects=objects):  # fmt: skip
            yield scene
    except (RuntimeError, TypeError, AttributeError) as error:
        raise CannotRead(str(error)) from None
    finally:
        for object in objects:
            bpy.data.objects.remove(object)
        with contextlib.suppress(RuntimeError):
            bpy.data.scenes.remove(scene)


def _array(attribute, field, width, dtype=np.float32):
    """(K, width) float64, or of an integer type, all values of an attribute."""
    kind = {"INT": np.int32, "BOOLEAN": bool}.get(attribute.data_type, dtype)
    values = np.empty(len(attribute.data) * width, kind)
    attribute.data.foreach_get(field, values)
    return values.reshape(-1, width).astype(np.int64 if dtype == np.int32 else float)


def _polygon_of_corners(mesh):
    """(C,) the polygon of every corner."""
    start = np.empty(len(mesh.polygons), np.int32)
    mesh.polygons.foreach_get("loop_start", start)
    return np.repeat(np.arange(len(start)), np.diff(np.append(start, len(mesh.loops))))
