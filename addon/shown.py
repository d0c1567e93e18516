"""Materials that show baked light, made as marked copies of those they stand for."""

from __future__ import annotations

import bpy

from .images import scale_of
from .marks import KEY, is_made, mark, shown_for


def show(object, source, shader="emission"):
    """Let an object, which a bake made, show baked light in place of what its materials reflect and emit.

    source: the name of a color attribute, or (image, UV map). shader: "emission", or "base" for a Principled shader's
    base color, which exporters read.
    """
    if not object.material_slots:
        object.data.materials.append(None)
    made = {}
    for slot in object.material_slots:
        key = slot.material.name_full if slot.material else None
        if key not in made:
            made[key] = _shown(slot.material, source, shader)
        slot.material = made[key]


def discard(object):
    """Remove an object with its mesh and the materials made for it."""
    mesh, materials = object.data, [slot.material for slot in object.material_slots]
    bpy.data.objects.remove(object)
    bpy.data.meshes.remove(mesh)
    for material in materials:
        if material and material.get(KEY) and not material.users:
            bpy.data.materials.remove(material)


def forget_others(images):
    """Remove materials and images that bakes made and nothing uses any more, but these images."""
    images = set(images)
    bpy.data.batch_remove([m for m in bpy.data.materials if m.get(KEY) and not m.users])
    bpy.data.batch_remove([i for i in bpy.data.images if i.get(KEY) and i not in images and i.users == i.use_fake_user])


def _shown(material, source, shader):
    """A copy of a material (None: a new one) that shows a source of light."""
    if material and is_made(material):
        material = shown_for(material)
    copy = material.copy() if material else bpy.data.materials.new("radiosity")
    copy.name = f"{material.name if material else 'default'}_radiosity"
    mark(copy)
    if material and shader == "emission":
        copy[f"{KEY}_of"] = material
    if bpy.app.version < (5, 0, 0):
        copy.use_nodes = True
    tree = copy.node_tree
    if shader == "base":
        tree.nodes.clear()
    outputs = [n for n in tree.nodes if n.type == "OUTPUT_MATERIAL"] or [tree.nodes.new("ShaderNodeOutputMaterial")]
    color = _color(tree, source)
    if shader == "emission":
        node = tree.nodes.new("ShaderNodeEmission")
        tree.links.new(color, node.inputs["Color"])
    else:
        node = tree.nodes.new("ShaderNodeBsdfPrincipled")
        tree.links.new(color, node.inputs["Base Color"])
    node.location = (outputs[0].location.x - 200, outputs[0].location.y + 200)
    for output in outputs:
        tree.links.new(node.outputs[0], output.inputs["Surface"])
    return copy


def _color(tree, source):
    """The socket of a new node that gives the color of a source of light."""
    if isinstance(source, str):
        node = tree.nodes.new("ShaderNodeVertexColor")
        node.layer_name = source
        return node.outputs["Color"]
    image, uv = source
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image, node.interpolation, node.extension = image, "Linear", "EXTEND"
    place = tree.nodes.new("ShaderNodeUVMap")
    place.uv_map = uv
    tree.links.new(place.outputs[0], node.inputs["Vector"])
    tree.nodes.active = node
    scale = scale_of(image)
    if scale == 1.0:
        return node.outputs["Color"]
    times = tree.nodes.new("ShaderNodeVectorMath")
    times.operation = "SCALE"
    times.inputs["Scale"].default_value = scale
    tree.links.new(node.outputs["Color"], times.inputs[0])
    return times.outputs[0]
