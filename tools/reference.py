"""Make a reference of a scene's light with Cycles, to measure bakes against:

    python tools/reference.py SCENE.blend OUT.npz [--samples 1024] [--bounces 32]

OUT.npz holds for each mesh object NAME, at its n vertices: NAME.A (n,) area [m^2]; NAME.mask (n,) bool, interior
vertices: not on a crease or an open edge, with nothing else within 1e-3 of the scene's diagonal, nor on what reflects nothing; NAME.EA and NAME.EB
(n, 3) irradiance / pi from two bakes with other seeds, so that their noise cancels from a measured error.
Objects that reflect nothing are left out: Cycles bakes 0 there.
"""

from __future__ import annotations

import argparse
import time

import bpy
import numpy as np

from cell_radiosity.addon.read_scene import read_scene
from cell_radiosity.core.layers import vertex_means
from cell_radiosity.core.raycast import RayCaster
from cell_radiosity.core.sampling import hemisphere, lattice, tangents
from cell_radiosity.core.scene import newell_normals
from cell_radiosity.core.surfaces import reflecting_polygons

NEAR = 1e-3  # of the scene's diagonal
FLAT = 0.9  # least cosine between the faces at a vertex that is not on a crease


def bake_with_cycles(samples, seed, wanted=None, bounces=32):
    """{name: (corners, 3)} irradiance / pi of every mesh object, by Cycles' vertex bake, nothing clamped.
    wanted: function of an object's name, whether it is baked. bounces: of light at most."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.threads_mode, scene.render.threads = "FIXED", 2
    cycles = scene.cycles
    cycles.samples, cycles.seed, cycles.use_adaptive_sampling = samples, seed, False
    cycles.max_bounces = cycles.diffuse_bounces = bounces
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    objects = [o for o in scene.objects if o.type == "MESH" and not o.hide_render and (not wanted or wanted(o.name))]
    for o in objects:
        o.data.color_attributes.active_color = o.data.color_attributes.get("Cycles") or o.data.color_attributes.new(
            "Cycles", "FLOAT_COLOR", "CORNER"
        )
    for o in scene.objects:
        o.select_set(o in objects)
    bpy.context.view_layer.objects.active = objects[0]
    bpy.ops.object.bake(type="DIFFUSE", pass_filter={"DIRECT", "INDIRECT"}, target="VERTEX_COLORS")
    result = {}
    for o in objects:
        values = np.empty(4 * len(o.data.loops), np.float32)
        o.data.color_attributes["Cycles"].data.foreach_get("color", values)
        result[o.name] = values.reshape(-1, 4)[:, :3].astype(float)
    return result


def vertex_facts(scene):
    """Area (V,) and interior (V,) of every vertex of a core Scene."""
    size = np.diff(scene.polygon_start)
    polygon = np.repeat(np.arange(len(size)), size)
    area = np.bincount(scene.triangle_polygon, np.nan_to_num(scene.triangle_normal_area[1]), len(size))
    vertex, count = scene.corner_vertex, len(scene.vertices)
    normal = newell_normals(scene.vertices, scene.polygon_start, scene.corner_vertex)
    mean = np.stack([np.bincount(vertex, normal[polygon][:, k], count) for k in range(3)], axis=1)
    mean /= np.maximum(np.sqrt((mean * mean).sum(axis=1, keepdims=True)), 1e-12)
    bend = np.ones(count)
    np.minimum.at(bend, vertex, (normal[polygon] * mean[vertex]).sum(axis=1))

    last = np.arange(len(vertex)) == scene.polygon_start[1:][polygon] - 1
    following = vertex[np.where(last, scene.polygon_start[:-1][polygon], np.arange(len(vertex)) + 1)]
    edge, uses = np.unique(np.sort(np.stack([vertex, following], axis=1), axis=1), axis=0, return_counts=True)
    rim = np.zeros(count, bool)
    rim[edge[uses == 1].reshape(-1)] = True

    caster = RayCaster(scene.vertices, scene.triangles, scene.usable)
    u, v = lattice(32)
    local = hemisphere(u, v)
    t1, t2 = tangents(mean)
    crowded = np.zeros(count, bool)
    for sign in (1.0, -1.0):
        for x, y, z in local:
            direction = x * t1 + y * t2 + sign * z * mean
            triangle, _, _, distance, _ = caster.hits(
                caster.start(scene.vertices, sign * mean), direction.astype(np.float32)
            )
            own = (scene.triangles[triangle] == np.arange(count)[:, None]).any(axis=1)
            crowded |= (triangle >= 0) & (distance < NEAR) & ~own
    glowing = np.zeros(count, bool)
    glowing[vertex[~reflecting_polygons(scene)[polygon]]] = True
    return np.bincount(vertex, (area / size)[polygon], count), (bend > FLAT) & ~rim & ~crowded & ~glowing


def baked_light(bakes, name):
    """Whether an object got any light."""
    return any(b[name].any() for b in bakes)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("scene")
    parser.add_argument("output")
    parser.add_argument("--samples", type=int, default=1024)
    parser.add_argument("--bounces", type=int, default=32, help="more where surfaces reflect over .8 of the light")
    arguments = parser.parse_args()
    bpy.ops.wm.open_mainfile(filepath=arguments.scene)
    scene, targets = read_scene(bpy.context)
    area, interior = vertex_facts(scene)
    wall, cpu = time.perf_counter(), time.process_time()
    bakes = [bake_with_cycles(arguments.samples, seed, bounces=arguments.bounces) for seed in (1, 2)]
    arrays = {
        "seconds": np.array([time.process_time() - cpu, time.perf_counter() - wall]),
        "samples": arguments.samples,
    }
    for target in targets:
        if not baked_light(bakes, target.object):
            continue
        mesh = bpy.data.objects[target.object].data
        vertex = scene.corner_vertex[target.first : target.last]
        first, count = vertex.min(), len(mesh.vertices)
        corner_vertex = np.empty(len(mesh.loops), np.int32)
        mesh.attributes[".corner_vert"].data.foreach_get("value", corner_vertex)
        arrays[f"{target.object}.A"] = area[first : first + count]
        arrays[f"{target.object}.mask"] = interior[first : first + count]
        for key, baked in zip(("EA", "EB"), bakes):
            arrays[f"{target.object}.{key}"] = vertex_means(baked[target.object], corner_vertex, count).astype(
                np.float32
            )
    np.savez_compressed(arguments.output, **arrays)
    noise = [arrays[f"{t.object}.EA"] - arrays[f"{t.object}.EB"] for t in targets if f"{t.object}.EA" in arrays]
    print(
        "rms difference",
        np.sqrt(np.mean(np.concatenate(noise) ** 2)),
        "{:.0f} CPU s, {:.0f} s".format(*arrays["seconds"]),
    )


if __name__ == "__main__":
    main()
