"""What a bake is going to do, said before it is started: how much there is to bake, and what stands in its way."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from hashlib import blake2b

import bpy

from ..core.health import Finding
from .job import NOTHING, Options, default_cells, wanted_by
from .marks import made_layers, stand_ins
from .outputs import make_output
from .preferences import preference
from .read_scene import SOLID, rendered_objects
from .session import Session
from .write_result import Copies, result_copies

LIGHTS = {"LIGHT"}
# Of the options, what a price list does not depend on.
ACCURACY = ("error", "time", "layers", "domain", "strict", "output", "bytes", "exposure", "channel", "image")


@dataclass(frozen=True)
class Preflight:
    """objects, corners: how many meshes and face corners get their light. copies: of shared meshes. findings: of
    objects that need a word, with what will be done. problem: why a bake cannot start, or "". names: of all objects
    that take part."""

    objects: int
    corners: int
    copies: Copies
    findings: tuple
    problem: str = ""
    names: tuple = ()


_last = (None, None)


def preflight(context, options):
    """The Preflight of the context's scene; looked up again only after an edit."""
    global _last
    key = (Session.edits, Session.writes, context.scene.name, context.view_layer.name, context.mode, options.objects, options.layers,
           options.shared, options.budget, options.target, options.mesh, bpy.data.filepath)  # fmt: skip
    if _last[0] != key:
        _last = (key, _look(context, options))
    return _last[1]


def price_key(context, options):
    """What the price list of a scene depends on beside its objects' data, as one word: which of them take part, the
    settings, and the cells."""
    usual = {field: getattr(Options, field) for field in ACCURACY}
    names = preflight(context, options).names
    told = repr((replace(options, **usual), names, preference("cells") or default_cells()))
    return blake2b(told.encode(), digest_size=8).hexdigest()


def _look(context, options):
    # While a panel is drawn nothing may be evaluated: what the view layer has is taken.
    scene, depsgraph = context.scene, context.view_layer.depsgraph or context.evaluated_depsgraph_get()
    rendered, copies, copies_of = rendered_objects(scene), set(stand_ins(scene)), result_copies(scene)
    users = Counter(o.data for o in scene.objects if o.type == "MESH")
    wanted = wanted_by(options.objects)
    findings, objects, own, corners, light, shapes, names = [], 0, [], 0, _world_shines(scene), 0, []

    def say(object, finding, action):
        findings.append(Finding(object.name, finding, action))

    for object in scene.objects:
        if object.type not in SOLID | LIGHTS or object in copies or (object.is_instancer and object.type not in SOLID):
            continue
        copy = copies_of.get(object.name) if object.hide_render and not object.library else None
        if copy is None and not _takes_part(object, rendered, say):
            continue
        names.append(object.name)
        shapes += object.type in SOLID
        light |= object.type == "LIGHT" or _may_shine(object)
        if object.type != "MESH" or (wanted is not None and not wanted(object.name)):
            continue
        if not _is_written(object, users, options, say):
            continue
        evaluated = (copy or object).evaluated_get(depsgraph).data
        # What is being edited, or has stepped aside for a copy that anything may have made, is not looked at as it renders.
        if object.mode == "EDIT" or (copy is not None and not any(m.show_render for m in object.modifiers)):
            evaluated = object.data
        if len(evaluated.loops) != len(object.data.loops):
            say(object, "its modifiers change its faces", f"its light is written to a copy, '{object.name}_radiosity'")
        else:
            own.append(object)
        objects += 1
        corners += len(evaluated.loops)
    needed = make_output(options).copies(own)
    problem = _too_many(needed, options) or _nothing_to_do(shapes, objects, light, options)
    return Preflight(objects, corners, needed, tuple(findings), problem, tuple(names))


def _takes_part(object, rendered, say):
    """Whether an object takes part in a bake; rendered: those that do. say(object, finding, action) is told what needs a
    word."""
    if object.hide_render or object.session_uid not in rendered:
        say(object, "it is not rendered", "it is left out: it casts neither light nor shadow")
        return False
    if not object.visible_get():
        say(object, "it is hidden in the viewport", "it is left out: it casts neither light nor shadow")
        return False
    return True


def _is_written(object, users, options, say):
    """Whether the light of a mesh object is written. users: of each mesh; say: see `_takes_part`."""
    mesh = object.data
    if object.library or not mesh.is_editable or mesh.override_library:
        say(object, "its mesh is linked from another file", "its light is not written: make it local to bake it")
        return False
    if users[mesh] > 1:
        if options.shared == "skip":
            say(object, f"its mesh is shared by {users[mesh]} objects", "its light is not written")
            return False
        say(object, f"its mesh is shared by {users[mesh]} objects", "it gets a mesh of its own")
    if object.mode == "EDIT":
        say(object, "it is in Edit Mode", "leave Edit Mode to bake")
    taken = [layer for layer in options.layers if layer in mesh.attributes and layer not in made_layers(mesh)]
    if taken:
        say(object, f"it has an attribute {taken[0]!r} that no bake made", "rename it, or leave out that layer")
    return True


def _nothing_to_do(shapes, objects, light, options):
    """Why there is nothing to bake, or "": how many solid objects take part, how many are written, whether any light may be."""
    if not shapes:
        return "There is no mesh to bake"
    if not objects and options.objects == NOTHING:
        return "No object is selected"
    if not objects:
        return "There is no mesh that light can be written to"
    return "" if light else "Nothing gives light: add a lamp, an emitting material or a world color"


def _too_many(needed, options):
    """Why the Copies of shared meshes are too many for the memory that may be used, or ""."""
    if needed.bytes <= options.budget:
        return ""
    gigabytes = f"{needed.bytes / 1e9:.1f} GB, more than the {options.budget / 1e9:.1f} GB that may be used"
    return f"{needed.count} copies of shared meshes take {gigabytes}: write to fewer objects, or skip shared meshes"


def _world_shines(scene):
    """Whether a world may give light; what its nodes say is left to the bake."""
    return scene.world is not None and (scene.world.node_tree is not None or max(scene.world.color) > 0)


def _may_shine(object):
    """Whether an object has a material that may emit light."""
    return any(slot.material is not None for slot in object.material_slots)
