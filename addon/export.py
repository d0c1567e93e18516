"""Baked scenes as files for engines: glTF and USD, with vertex colors in 0..1 and their scale beside them.

glTF wants colors from 0 to 1, and Blender's exporter lets larger ones wrap around in some versions: so the light is
divided by its largest value, which goes into the extras of the scene and of every object as `radiosity_scale`.
"""

from __future__ import annotations

import os

import addon_utils
import bpy
import numpy as np

from ..core.saving import written_together, written_whole
from .errors import Refused
from .files import writing
from .marks import made_layers
from .shown import discard, show

SCALE = "radiosity_scale"
COLORS = {"USD": "displayColor"}  # names of the color attribute that readers look for; others take any
KINDS = {".glb": "GLB", ".gltf": "GLTF_SEPARATE", ".usd": "USD", ".usda": "USD", ".usdc": "USD"}


def kind_of(path):
    """The kind of file that a name's ending asks for; raises Refused for others."""
    suffix = os.path.splitext(path)[1].lower()
    if suffix not in KINDS:
        raise Refused(f"cannot export {path}: its name must end in {', '.join(KINDS)}")
    if KINDS[suffix] == "USD" and not hasattr(bpy.types, "WM_OT_usd_export") and "usd_export" not in dir(bpy.ops.wm):
        raise Refused(f"cannot export {path}: this Blender was built without USD")
    return KINDS[suffix]


def export_scene(context, path, layer="Radiosity"):
    """Export the meshes of a context's scene with a baked layer as their vertex colors; returns the scale, by which the
    colors must be multiplied to be light. Raises Refused if no mesh has the layer, or the file cannot be written."""
    kind = kind_of(path)
    baked = [
        o for o in context.scene.objects if o.type == "MESH" and layer in made_layers(o.data) and not o.hide_render
    ]
    if not baked:
        raise Refused(f"no mesh of this scene has a baked layer {layer!r}: bake it to vertex colors first")
    scale = max(float(_colors(o.data, layer)[:, :3].max(initial=0.0)) for o in baked) or 1.0
    others = [o for o in context.scene.objects if o.type == "MESH" and o not in baked and not o.hide_render]
    before = context.window.scene
    scene = bpy.data.scenes.new(f"{context.scene.name} export")
    made = []
    try:
        scene[SCALE] = scale
        for object in baked:
            made.append(_scaled_copy(object, layer, scale, COLORS.get(kind, "Color")))
            scene.collection.objects.link(made[-1])
        for object in others:
            scene.collection.objects.link(object)
        context.window.scene = scene
        context.view_layer.update()
        _write(path, kind)
    finally:
        context.window.scene = before
        bpy.data.scenes.remove(scene)
        for copy, object in zip(made, baked):
            name = copy.name
            discard(copy)
            object.name = name
    return scale


def _scaled_copy(object, layer, scale, name):
    """A copy of an object whose only color attribute is a layer over the scale, shown as a material's base color."""
    copy = object.copy()
    copy.data = object.data.copy()
    copy.animation_data_clear()
    mesh, source = copy.data, object.data.color_attributes[layer]
    colors, domain = _colors(object.data, layer), source.domain
    for old in [attribute.name for attribute in mesh.color_attributes]:
        mesh.color_attributes.remove(mesh.color_attributes[old])
    made = mesh.color_attributes.new(name, "FLOAT_COLOR", domain)
    colors[:, :3] /= scale
    made.data.foreach_set("color", np.clip(colors, 0.0, 1.0).reshape(-1))
    mesh.color_attributes.active_color = made
    mesh.color_attributes.render_color_index = mesh.color_attributes.active_color_index
    copy[SCALE] = scale
    name_in_file, object.name = object.name, f"{object.name} exported"
    copy.name = mesh.name = name_in_file
    show(copy, name, "base")
    return copy


def _colors(mesh, layer):
    """(K, 4) float32 values of a color attribute."""
    attribute = mesh.color_attributes[layer]
    values = np.empty(4 * len(attribute.data), np.float32)
    attribute.data.foreach_get("color", values)
    return values.reshape(-1, 4)


def _write(path, kind):
    """Write the context's scene to a file, whole or not at all."""
    os.makedirs(os.path.dirname(path) or ".", exist_ok=True)
    written = written_together if kind == "GLTF_SEPARATE" else written_whole
    with writing(path, os.path.splitext(path)[1], written) as temporary:
        if kind == "USD":
            bpy.ops.wm.usd_export(**_known(bpy.ops.wm.usd_export, dict(
                filepath=temporary, export_materials=True, export_custom_properties=True, export_animation=False,
            )))  # fmt: skip
        else:
            addon_utils.enable("io_scene_gltf2")
            bpy.ops.export_scene.gltf(**_known(bpy.ops.export_scene.gltf, dict(
                filepath=temporary, export_format=kind, export_vertex_color="MATERIAL", export_extras=True,
                export_apply=True, export_animations=False, export_yup=True, use_active_scene=True,
            )))  # fmt: skip


def _known(operator, options):
    """Those of an operator's options that this Blender has."""
    names = operator.get_rna_type().properties.keys()
    return {name: value for name, value in options.items() if name in names}
