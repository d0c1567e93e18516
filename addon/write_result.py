"""Write the light of a bake into Blender's meshes, as linear color attributes.

Everything is computed and checked before anything in the file is touched. What a bake makes is marked, and replaced by
the next bake.
"""

from __future__ import annotations

from collections import Counter

import bpy
import numpy as np

from ..core.layers import layer_colors, vertex_means
from .errors import Refused
from .marks import KEY, is_made, made_layers, mark, mark_layers


def check_names(targets, layers):
    """Raise Refused if an attribute or UV map of a layer's name exists that is not ours."""
    for target in targets:
        mesh = bpy.data.objects[target.object].data
        for layer in layers:
            if layer in mesh.attributes and layer not in made_layers(mesh):
                raise Refused(
                    f"{target.object}: it has an attribute {layer!r} that no bake made; rename it, or leave out that layer"
                )


def write_result(context, bake, targets, layers, domain):
    """Write layers of a Bake to the objects of targets. domain: "CORNER" or "POINT".

    An object whose mesh is shared gets a copy of its own. One whose modifiers change its polygons gets a copy of itself
    with the result; the original is hidden.
    """
    colors = {layer: layer_colors(bake, layer) for layer in layers}
    users = Counter(o.data.name_full for o in bpy.data.objects if o.type == "MESH")
    depsgraph = context.evaluated_depsgraph_get()
    copies = {t.object: _evaluated_mesh(t.object, depsgraph) for t in targets if not t.same}
    for target in targets:
        object = bpy.data.objects[target.object]
        if target.object in copies:
            mesh = _result_copy(object, copies[target.object]).data
        else:
            if users[object.data.name_full] > 1:
                users[object.data.name_full] -= 1
                object.data = object.data.copy()
            mesh = object.data
        for layer in layers:
            values = np.empty((target.last - target.first, 3))
            values[target.corner] = colors[layer][target.first : target.last]
            if domain == "POINT":
                values = vertex_means(values, _corner_vertices(mesh), len(mesh.vertices))
            _write_layer(mesh, layer, domain, values)
        mark_layers(mesh, layers)
        mesh.color_attributes.active_color = mesh.color_attributes[layers[0]]
        mesh.update()


def remove_copies(scene):
    """Remove the copies that earlier bakes made in a scene, and show their originals again."""
    for object in [o for o in scene.objects if is_made(o)]:
        mesh = object.data
        original = scene.objects.get(object.get(f"{KEY}_of", ""))
        bpy.data.objects.remove(object)
        if mesh.users == 0:
            bpy.data.meshes.remove(mesh)
        if original:
            original.hide_render = False
            original.hide_viewport = False


def _write_layer(mesh, layer, domain, values):
    """Put values (K, 3) into the mesh's float color attribute `layer`, made anew if it is of another kind."""
    attribute = mesh.color_attributes.get(layer)
    if attribute is not None and (attribute.domain != domain or attribute.data_type != "FLOAT_COLOR"):
        mesh.color_attributes.remove(attribute)
        attribute = None
    if attribute is None:
        attribute = mesh.color_attributes.new(layer, "FLOAT_COLOR", domain)
    rgba = np.ones((len(values), 4), np.float32)
    rgba[:, :3] = values
    attribute.data.foreach_set("color", rgba.reshape(-1))


def _corner_vertices(mesh):
    vertex = np.empty(len(mesh.loops), np.int32)
    mesh.attributes[".corner_vert"].data.foreach_get("value", vertex)
    return vertex


def _evaluated_mesh(name, depsgraph):
    """A new mesh of what an object's modifiers make of it."""
    object = bpy.data.objects[name].evaluated_get(depsgraph)
    return bpy.data.meshes.new_from_object(object, preserve_all_data_layers=True, depsgraph=depsgraph)


def _result_copy(object, mesh):
    """A marked copy of an object with another mesh and no modifiers, in its place; the original is hidden."""
    copy = object.copy()
    copy.data = mesh
    copy.name = mesh.name = f"{object.name}_radiosity"
    copy.modifiers.clear()
    copy.animation_data_clear()
    mark(copy)
    copy[f"{KEY}_of"] = object.name
    for collection in object.users_collection:
        collection.objects.link(copy)
    object.hide_render = object.hide_viewport = True
    return copy
