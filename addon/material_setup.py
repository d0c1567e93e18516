"""Baked layers in materials: an optional node that puts a layer in, and can be taken out again without a trace.

The node is a marked group set into the one link that it changes: what was there leads into it, so nothing of the user's
is ever removed, and taking the group out joins the two ends again. While a scene is read the groups are passed by, so
that baked light is never read as a surface's own.
"""

from __future__ import annotations

import contextlib

import bpy

from .marks import is_made, mark

KINDS = {"EMISSION": "NodeSocketShader", "BASE_COLOR": "NodeSocketColor"}
BASE_INPUTS = {"BSDF_PRINCIPLED": "Base Color", "BSDF_DIFFUSE": "Color"}


def set_up(objects, layer, kind):
    """Let the materials of mesh objects show a layer; returns how many do. kind: "EMISSION" shows it as it is, in place of
    the shader; "BASE_COLOR" puts it into the base color. An object without a material gets one."""
    count = 0
    for material in _materials(objects):
        tree = _tree(material)
        for socket in _sockets(tree, kind):
            _insert(tree, socket, _group(layer, kind))
            count += 1
    return count


def take_out(materials):
    """Take the groups out of materials again, and remove those materials that were made for them."""
    for material in list(materials):
        for node in _groups(material.node_tree):
            _pass_by(material.node_tree, node)
            material.node_tree.nodes.remove(node)
        if is_made(material):
            for mesh in bpy.data.meshes:
                for k in reversed(range(len(mesh.materials))):
                    if mesh.materials[k] == material:
                        mesh.materials.pop(index=k)
            bpy.data.materials.remove(material)
    for tree in [t for t in bpy.data.node_groups if is_made(t) and t.users == 0]:
        bpy.data.node_groups.remove(tree)


def with_set_up():
    """The materials of the file that have a group."""
    return [m for m in bpy.data.materials if m.library is None and is_set_up(m)]


def is_set_up(material):
    """Whether a material, which may be None, has a group."""
    return material is not None and bool(_groups(material.node_tree))


def any_set_up():
    """Whether any material may have a group; quick enough for a panel."""
    return any(is_made(tree) and tree.users for tree in bpy.data.node_groups)


@contextlib.contextmanager
def passed_by():
    """While a scene is read, let the materials be what they are without their groups."""
    changed = []
    try:
        for material in with_set_up():
            for node in _groups(material.node_tree):
                for target in _pass_by(material.node_tree, node):
                    changed.append((material.name, node.name, target.node.name, target.identifier))
        yield
    finally:
        for material, node, target, identifier in changed:
            tree = bpy.data.materials[material].node_tree
            socket = next(s for s in tree.nodes[target].inputs if s.identifier == identifier)
            tree.links.new(tree.nodes[node].outputs[0], socket)


def _materials(objects):
    """The materials of mesh objects that can be changed, each once; made for those without any."""
    found = {}
    for object in objects:
        if not object.material_slots:
            material = bpy.data.materials.new(f"{object.name} Radiosity")
            mark(material)
            object.data.materials.append(material)
        for slot in object.material_slots:
            if slot.material is not None and slot.material.library is None:
                found[slot.material.name] = slot.material
    return found.values()


def _tree(material):
    """A material's node tree; one that has none gets it, with its viewport color."""
    if bpy.app.version < (5, 0, 0) and not material.use_nodes:
        material.use_nodes = True
    return material.node_tree


def _groups(tree):
    """The marked groups in a material's node tree, which may be None."""
    return [n for n in tree.nodes if n.type == "GROUP" and n.node_tree and is_made(n.node_tree)] if tree else []


def _sockets(tree, kind):
    """The input sockets that a group of a kind is set into."""
    outputs = {tree.get_output_node(target) for target in ("CYCLES", "EEVEE")} - {None}
    if kind == "EMISSION":
        return [output.inputs["Surface"] for output in sorted(outputs, key=lambda node: node.name)]
    return [node.inputs[BASE_INPUTS[node.type]] for node in tree.nodes if node.type in BASE_INPUTS]


def _insert(tree, socket, group):
    """Set a group into what leads to a socket; a group that is there already is exchanged."""
    source = socket.links[0].from_socket if socket.is_linked else None
    if source is not None and source.node in _groups(tree):
        source.node.node_tree = group
        return
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = group
    node.location = (socket.node.location.x - 200.0, socket.node.location.y + 60.0)
    if source is not None:
        tree.links.new(source, node.inputs[0])
    elif socket.type == "RGBA":
        node.inputs[0].default_value = socket.default_value
    tree.links.new(node.outputs[0], socket)


def _pass_by(tree, node):
    """Join what leads into a group to what it leads to; returns the sockets it led to."""
    source = node.inputs[0].links[0].from_socket if node.inputs[0].is_linked else None
    targets = [link.to_socket for link in node.outputs[0].links]
    for target in targets:
        if source is not None:
            tree.links.new(source, target)
        else:
            tree.links.remove(target.links[0])
    return targets


def _group(layer, kind):
    """The marked node group of a layer and kind, made the first time."""
    name = f"{layer} {'Emission' if kind == 'EMISSION' else 'Color'}"
    for tree in bpy.data.node_groups:
        if is_made(tree) and tree.name == name and tree.library is None:
            return tree
    tree = bpy.data.node_groups.new(name, "ShaderNodeTree")
    mark(tree)
    socket = "Shader" if kind == "EMISSION" else "Color"
    for direction in ("INPUT", "OUTPUT"):
        tree.interface.new_socket(socket, in_out=direction, socket_type=KINDS[kind])
    attribute, end = tree.nodes.new("ShaderNodeVertexColor"), tree.nodes.new("NodeGroupOutput")
    tree.nodes.new("NodeGroupInput").location = (-200.0, -200.0)
    attribute.layer_name = layer
    attribute.location, end.location = (-200.0, 0.0), (200.0, 0.0)
    source = attribute.outputs["Color"]
    if kind == "EMISSION":
        emission = tree.nodes.new("ShaderNodeEmission")
        tree.links.new(source, emission.inputs["Color"])
        source = emission.outputs[0]
    tree.links.new(source, end.inputs[0])
    return tree
