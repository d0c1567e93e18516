"""Small Blender scenes, made in place, and what Cycles and our own bake say of them."""

from __future__ import annotations

import bpy
import numpy as np

from cell_radiosity.addon.job import Job, Options
from cell_radiosity.core.bake import run


def use_nodes(data):
    """Let a material or world use nodes; from Blender 5.0 on it always does."""
    if bpy.app.version < (5, 0, 0):
        data.use_nodes = True


def empty(world=(0.0, 0.0, 0.0)):
    """An empty file with a world of one color."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.world = bpy.data.worlds.new("World")
    use_nodes(scene.world)
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (*world, 1.0)
    return scene


def diffuse(name, color):
    """A material with a Diffuse BSDF."""
    made = bpy.data.materials.new(name)
    use_nodes(made)
    tree = made.node_tree
    tree.nodes.clear()
    shader = tree.nodes.new("ShaderNodeBsdfDiffuse")
    shader.inputs["Color"].default_value = (*color, 1.0)
    tree.links.new(shader.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    return made


def glowing(name, color, strength):
    """A material that only emits."""
    made = bpy.data.materials.new(name)
    use_nodes(made)
    tree = made.node_tree
    tree.nodes.clear()
    shader = tree.nodes.new("ShaderNodeEmission")
    shader.inputs["Color"].default_value = (*color, 1.0)
    shader.inputs["Strength"].default_value = strength
    tree.links.new(shader.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    return made


def mesh_object(name, vertices, faces, material=None, **placing):
    """An object in the scene. placing: location, rotation_euler, scale."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([tuple(map(float, v)) for v in vertices], [], [tuple(map(int, f)) for f in faces])
    mesh.update()
    if material:
        mesh.materials.append(material)
    made = bpy.data.objects.new(name, mesh)
    for key, value in placing.items():
        setattr(made, key, value)
    bpy.context.scene.collection.objects.link(made)
    return made


def plane(name="plane", size=2.0, n=4, material=None, **placing):
    """A square of n x n quads about the origin, facing up."""
    line = np.linspace(-size / 2, size / 2, n + 1)
    vertices = [(x, y, 0) for y in line for x in line]
    faces = [(r * (n + 1) + c, r * (n + 1) + c + 1, (r + 1) * (n + 1) + c + 1, (r + 1) * (n + 1) + c)
             for r in range(n) for c in range(n)]  # fmt: skip
    return mesh_object(name, vertices, faces, material, **placing)


def cube(name="cube", size=2.0, material=None, **placing):
    """A cube of six quads about the origin, facing outward."""
    s = size / 2
    vertices = [(x, y, z) for z in (-s, s) for y in (-s, s) for x in (-s, s)]
    faces = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    return mesh_object(name, vertices, faces, material, **placing)


def lamp(kind, energy=100.0, **settings):
    """A lamp; settings of its data, or location and rotation_euler of the object."""
    data = bpy.data.lights.new(kind, kind)
    data.energy = energy
    made = bpy.data.objects.new(kind, data)
    for key, value in settings.items():
        setattr(made if key in ("location", "rotation_euler", "scale") else data, key, value)
    bpy.context.scene.collection.objects.link(made)
    return made


def bake_ours(cells, **options):
    """Bake the open scene and write the layers; returns the Job."""
    bpy.context.view_layer.update()
    job = Job(bpy.context, Options(**options), cells=cells)
    run(job.bake())
    job.write(bpy.context)
    return job


def bake_cycles(names, samples=256, parts=("DIRECT", "INDIRECT")):
    """{name: (corners, 3)} Cycles' diffuse vertex bake of objects without their color, nothing clamped."""
    scene = bpy.context.scene
    scene.cycles.samples, scene.cycles.use_adaptive_sampling = samples, False
    scene.cycles.max_bounces = scene.cycles.diffuse_bounces = 32
    scene.cycles.sample_clamp_direct = scene.cycles.sample_clamp_indirect = 0.0
    objects = [bpy.data.objects[n] for n in names]
    for o in objects:
        attributes = o.data.color_attributes
        attributes.active_color = attributes.get("Cycles") or attributes.new("Cycles", "FLOAT_COLOR", "CORNER")
    for o in scene.objects:
        o.select_set(o in objects)
    bpy.context.view_layer.objects.active = objects[0]
    bpy.ops.object.bake(type="DIFFUSE", pass_filter=set(parts), target="VERTEX_COLORS")
    return {o.name: colors(o.data, "Cycles") for o in objects}


def colors(mesh, layer):
    """(K, 3) float64 values of a color attribute."""
    attribute = mesh.color_attributes[layer]
    values = np.empty(4 * len(attribute.data), np.float32)
    attribute.data.foreach_get("color", values)
    return values.reshape(-1, 4)[:, :3].astype(float)
