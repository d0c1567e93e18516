"""Write the light of a bake into Blender's meshes, as linear color attributes.

An object takes its light in its own mesh; if the mesh is shared, in a copy of the mesh; if its modifiers change its
polygons, in a copy of the object, and the original is hidden. What a bake makes is marked, and replaced by the next.
"""

from __future__ import annotations

import contextlib
from collections import Counter
from dataclasses import dataclass
from math import inf

import bpy
import numpy as np

from ..core.bake import run
from ..core.health import Finding
from ..core.layers import vertex_means
from .errors import Refused
from .images import BRIGHTEST
from .lookup import Lookup
from .marks import KEY, hide, made_layers, mark, mark_layers, originals_shown, stand_ins
from .material_setup import is_set_up
from .steps import aside

# Of one value of an attribute; 4 of all others.
VALUE_BYTES = {
    "BOOLEAN": 1, "INT8": 1, "FLOAT2": 8, "INT32_2D": 8, "FLOAT_VECTOR": 12, "FLOAT_COLOR": 16, "QUATERNION": 16,
    "FLOAT4X4": 64,
}  # fmt: skip
MANY = 20_000  # corners of a mesh from which on it is large: a layer of it takes some milliseconds


def check_names(lookup, targets, layers):
    """Raise Refused if an attribute or UV map of a layer's name exists that is not ours."""
    for target in targets:
        mesh = lookup.target(target).data
        for layer in layers:
            if layer in mesh.attributes and layer not in made_layers(mesh):
                raise Refused(
                    f"{target.object}: it has an attribute {layer!r} that no bake made; rename it, or leave out that layer"
                )


def write_result(context, colors, targets, domain):
    """Write layers {name: (C, 3) color of every corner of the scene} to the objects of targets; returns Findings about
    objects that have changed since they were read, and are left as they are. domain: "CORNER" or "POINT"."""
    return run(writing_result(context, colors, targets, domain))


def writing_result(context, colors, targets, domain, encoded=(), channel=None, step=inf, remade=None):
    """`write_result` in steps of some `step` seconds: a generator that yields between objects, and before each layer of a
    large one.

    encoded: names of the layers that are written as 8-bit colors. channel: (attribute, number of its channel, (C,)
    values), to be written into an attribute that is there. remade: the set of Blender's numbers for copies that this bake
    has made anew, which are added to it; all others are of an earlier one, whose modifiers may have made another shape.
    """
    findings, remade = [], set() if remade is None else remade
    lookup, copies = Lookup(context.scene), copy_names(context.scene)
    new = [t for t in targets if not t.same and not _kept(lookup, t, copies, remade)]
    sources = yield from source_meshes(context, new, step)
    try:
        lookup = Lookup(context.scene)
        make_room(lookup, new, sources, copies)
        for target in targets:
            large = target.last - target.first > MANY
            # What needs no Blender comes first: in the turns that it takes the mesh may go.
            own = yield from aside(step if large else inf, _layers_of_target, target, colors, domain)
            filled = channel and (*channel[:2], _of_target(target, channel[2]))
            holder = None
            for layer in own:
                if large or (holder is None and lookup.over(step)):
                    yield
                    lookup, holder = Lookup(context.scene), None
                holder = holder or _place(lookup, target, copies, remade, sources)
                if isinstance(holder, Finding):
                    findings.append(holder)
                    break
                _write_layer(holder.data, layer, domain, own[layer], layer in encoded)
                mark_layers(holder.data, [layer])
            else:
                _finish(holder.data, next(iter(own)), filled)
    finally:
        drop_sources(sources)
    return tuple(findings)


def write_layers(mesh, colors, domain, encoded=(), channel=None):
    """Write layers {name: (K, 3) color of every corner of the mesh}; the others as for `writing_result`."""
    for layer, values in colors.items():
        if domain == "POINT":
            values = vertex_means(values, _corner_vertices(mesh), len(mesh.vertices))
        _write_layer(mesh, layer, domain, _ready(values), layer in encoded)
    mark_layers(mesh, colors)
    _finish(mesh, next(iter(colors)), channel)


def _finish(mesh, shown, channel):
    """Fill the channel of a mesh that has its layers, and show one of them."""
    if channel:
        _write_channel(mesh, *channel)
    mesh.color_attributes.active_color = mesh.color_attributes[shown]
    mesh.update()


@dataclass(frozen=True)
class Copies:
    """What meshes of their own take that objects get in place of shared ones. count: of meshes; bytes: of all; largest:
    name of the object whose mesh takes most of it with its copies, or ""."""

    count: int = 0
    bytes: int = 0
    largest: str = ""


def copies_of_shared(objects):
    """The Copies that objects need if each is to have its own light."""
    users = Counter(object.data for object in objects)
    # One of all that share a mesh may keep it.
    counts = {mesh: min(n, mesh.users - mesh.use_fake_user - 1) for mesh, n in users.items()}
    taken = {mesh: n * _size(mesh) for mesh, n in counts.items() if n > 0}
    most = max(taken, key=taken.get, default=None)
    largest = next((object.name for object in objects if object.data == most), "")
    return Copies(sum(counts[mesh] for mesh in taken), sum(taken.values()), largest)


def _size(mesh):
    """Bytes that a mesh takes, about."""
    keys = len(mesh.shape_keys.key_blocks) if mesh.shape_keys else 0
    own = sum(VALUE_BYTES.get(a.data_type, 4) * len(a.data) for a in mesh.attributes)
    return own + 4 * len(mesh.polygons) + 12 * keys * len(mesh.vertices)


def result_copies(scene):
    """{name of an object: copy in a scene that holds its result, the first of several}."""
    return {o[f"{KEY}_of"]: o for o in reversed(stand_ins(scene))}


def copy_names(scene):
    """{name of an object: name of its result copy}: what there is before anything is written."""
    return {name: copy.name for name, copy in result_copies(scene).items()}


def remove_copies(lookup, copies):
    """Remove copies that a bake made in a scene, and show their originals again. All at once: for each single one Blender
    looks through the whole file."""
    meshes = [copy.data for copy in copies]
    for copy in copies:
        original = lookup.own(copy.get(f"{KEY}_of", ""))
        if original is not None:
            hide([original], False)
            _select_instead(original, copy)
    lookup.drop(copies)
    bpy.data.batch_remove(copies)
    _drop_meshes(meshes)


def make_room(lookup, targets, sources, copies):
    """Remove the former copies of those targets that have a mesh among sources. copies: {name of an object: name of its
    copy}, from which they are taken."""
    former = []
    for target in targets:
        source, copy = source_of(lookup, target, sources), lookup.own(copies.get(target.object))
        if copy is None or isinstance(source, Finding):
            continue
        if not source.materials:
            for material in filter(is_set_up, copy.data.materials):
                source.materials.append(material)
        del copies[target.object]
        former.append(copy)
    remove_copies(lookup, former)


def source_meshes(context, targets, step=inf):
    """{name of a target's object: name of a new mesh of it, as it is rendered}: a generator that yields between objects,
    every `step` seconds or so. All at once: after an object is hidden, or a copy made, Blender evaluates the whole scene
    anew."""
    made = {}
    try:
        with originals_shown(context.scene):
            lookup = Lookup(context.scene)
            for target in targets:
                if lookup.over(step):
                    yield
                    lookup = Lookup(context.scene)
                object = lookup.target(target)
                if object is not None:
                    made[target.object] = _evaluated_mesh(object, context.evaluated_depsgraph_get()).name
    except BaseException:
        drop_sources(made)
        raise
    return made


def source_of(lookup, target, sources):
    """The mesh among those of `source_meshes` whose corners are a target's; a Finding if the object is not what was read."""
    if lookup.target(target) is None:
        return deleted(target)
    mesh = lookup.mesh(sources.get(target.object))
    if mesh is None or len(mesh.loops) != target.last - target.first:
        return Finding(target.object, "its mesh was changed during the bake", "its light was dropped: bake it again")
    return mesh


def deleted(target):
    """The Finding about a target whose object is gone."""
    return Finding(target.object, "it was deleted during the bake", "its light was dropped")


def drop_sources(sources):
    """Remove those meshes of `source_meshes` that nothing uses."""
    names = set(sources.values())
    _drop_meshes([mesh for mesh in bpy.data.meshes if mesh.name in names and mesh.library is None] if names else [])


def _drop_meshes(meshes):
    unused = [mesh for mesh in set(meshes) if mesh.users == 0]
    if unused:
        bpy.data.batch_remove(unused)


def copy_with(lookup, target, mesh):
    """A marked copy of a target's object with another mesh and no modifiers, in place of the object, which is hidden. It is where
    the object is; of collections that belong to another file, it is in the scene's instead."""
    object = lookup.target(target)
    copy = object.copy()
    copy.data = mesh
    copy.name = mesh.name = f"{object.name}_radiosity"
    copy.modifiers.clear()
    copy.animation_data_clear()
    mark(copy)
    copy[f"{KEY}_of"] = object.name
    collections = [c for c in object.users_collection if c.is_editable and not c.override_library]
    for collection in collections or [lookup.scene.collection]:
        collection.objects.link(copy)
    lookup.add(copy)
    _select_instead(copy, object)
    hide([object], True)
    return copy


def _kept(lookup, target, copies, remade):
    """The copy of a target's object that this bake has made, and that still is what it was; or None."""
    copy = lookup.own(copies.get(target.object))
    fits = copy is not None and copy.session_uid in remade and len(copy.data.loops) == target.last - target.first
    return copy if fits else None


def _place(lookup, target, copies, remade, sources):
    """The object whose mesh takes a target's light, made if need be; a Finding if the object is not what was read.
    copies: {name of an object: name of the copy that holds its result}, kept up to date, as is remade; sources: of
    `source_meshes`."""
    if not target.same:
        copy = _kept(lookup, target, copies, remade)
        if copy is None or lookup.target(target) is None:
            mesh = source_of(lookup, target, sources)
            if isinstance(mesh, Finding):
                return mesh
            copy = copy_with(lookup, target, mesh)
            copies[target.object] = copy.name
            remade.add(copy.session_uid)
        return copy
    object = lookup.target(target)
    if object is None:
        return deleted(target)
    if len(object.data.loops) != target.last - target.first or object.mode == "EDIT":
        return Finding(target.object, "its mesh was changed during the bake", "its light was dropped: bake it again")
    copy = lookup.own(copies.get(target.object))
    if copy is not None:
        remove_copies(lookup, [copy])
    if object.data.users - object.data.use_fake_user > 1:
        object.data = object.data.copy()
    return object


def _of_target(target, values):
    """(K, ...) those of the scene's corner values (C, ...) that are a target's, in the order of its mesh."""
    own = np.empty((target.last - target.first, *values.shape[1:]))
    own[target.corner] = values[target.first : target.last]
    return own


def _layers_of_target(target, colors, domain):
    """{layer: those of the scene's corner values that are a target's, ready to be written}."""
    own = {layer: _of_target(target, values) for layer, values in colors.items()}
    if domain == "POINT":
        own = {layer: vertex_means(values, target.vertex, target.vertices) for layer, values in own.items()}
    return {layer: _ready(values) for layer, values in own.items()}


def _ready(values):
    """Colors (K, 3) as an attribute takes them, (K, 4) float32."""
    rgba = np.ones((len(values), 4), np.float32)
    np.minimum(values, BRIGHTEST, out=rgba[:, :3], casting="same_kind")
    return rgba


def _write_layer(mesh, layer, domain, values, encoded):
    """Put values that are `_ready` into the mesh's color attribute `layer`, made anew if it is of another kind. encoded:
    it holds 8-bit colors."""
    kind = "BYTE_COLOR" if encoded else "FLOAT_COLOR"
    attribute = mesh.color_attributes.get(layer)
    if attribute is not None and (attribute.domain != domain or attribute.data_type != kind):
        mesh.color_attributes.remove(attribute)
        attribute = None
    if attribute is None:
        attribute = mesh.color_attributes.new(layer, kind, domain)
    attribute.data.foreach_set("color", values.reshape(-1))


def _write_channel(mesh, name, channel, values):
    """Put corner values (K,) into one channel of a color attribute that is there, in the light's own or 8-bit terms."""
    attribute = mesh.color_attributes[name]
    if attribute.domain == "POINT":
        values = vertex_means(values[:, None], _corner_vertices(mesh), len(mesh.vertices))[:, 0]
    stored = "color_srgb" if attribute.data_type == "BYTE_COLOR" else "color"
    rgba = np.empty(4 * len(attribute.data), np.float32)
    attribute.data.foreach_get(stored, rgba)
    if stored == "color_srgb":
        values = np.clip(values, 0.0, 1.0)
        values = values if channel == 3 else srgb(values)
    rgba.reshape(-1, 4)[:, channel] = values
    attribute.data.foreach_set(stored, rgba)


def srgb(values):
    """What sRGB stores for linear values 0..1 (IEC 61966-2-1)."""
    return np.where(values <= 0.0031308, 12.92 * values, 1.055 * np.maximum(values, 0.0) ** (1 / 2.4) - 0.055)


def _corner_vertices(mesh):
    vertex = np.empty(len(mesh.loops), np.int32)
    mesh.attributes[".corner_vert"].data.foreach_get("value", vertex)
    return vertex


def _evaluated_mesh(object, depsgraph):
    """A new mesh of what an object's modifiers make of it, without the layers that earlier bakes have left on it."""
    evaluated = object.evaluated_get(depsgraph)
    mesh = bpy.data.meshes.new_from_object(evaluated, preserve_all_data_layers=True, depsgraph=depsgraph)
    for name in made_layers(object.data):
        if name in mesh.color_attributes:
            mesh.color_attributes.remove(mesh.color_attributes[name])
    return mesh


def _select_instead(shown, hidden):
    """Let an object be selected, and active, as another was in place of which it is shown."""
    active = bpy.context.view_layer.objects.active == hidden
    with contextlib.suppress(RuntimeError):  # where one of them is not in the view layer
        shown.select_set(hidden.select_get())
        if active:
            bpy.context.view_layer.objects.active = shown
