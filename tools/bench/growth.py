"""How cost grows with the size of what is baked, in one direction at a time.

Each measurement runs in a process of its own, so that peak memory is its own too. CPU seconds are those of host and
cells in survey, patches, transport and gather, if nothing else is said.
"""

from __future__ import annotations

import json
import subprocess
import sys
from time import process_time

import bpy
import numpy as np

from cell_radiosity.addon.job import Job, Options, default_cells
from cell_radiosity.core.cells import make_cells

from .law import exponent
from .scenes import ROOT, Lamp, Material, Mesh, Settings, bake, box, box_corners, grid, join_meshes, run

LONG = 30.0  # CPU seconds of a measurement, after which its series ends; that of points goes on
TILES = 10_000
WHITE, BLACK = Material("white", (0.7, 0.7, 0.7)), (0.0, 0.0, 0.0)
LAMP = Lamp("area", (10.0,) * 3, position=(2.0, 2.5, 2.9), size=(1.0, 1.0), name="panel")
SIZES = {
    "points": (10_000, 30_000, 100_000, 300_000, 1_000_000),
    "patches": (1_000, 3_000, 10_000, 30_000, 100_000),
    "emitters": (1, 10, 100, 1_000, 10_000),
    "objects": (10, 100, 1_000, 10_000),
}


def series(name):
    """A series of measurements, {"runs": [{size, cpu, ...}], "exponent": of them all, "end": of the last two}: fixed costs
    flatten the former."""
    runs = []
    for size in SIZES[name]:
        asked = [sys.executable, "-m", __spec__.name, name, str(size)]
        told = subprocess.run(asked, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout
        runs.append(json.loads(told.splitlines()[-1]))
        print(f"{name}: " + ", ".join(f"{k} {v:.5g}" for k, v in runs[-1].items()), flush=True)
        if runs[-1]["cpu"] > LONG and name != "points":
            break
    x, y = [r["size"] for r in runs], [r["cpu"] for r in runs]
    return {"runs": runs, "exponent": exponent(x, y), "end": exponent(x[-2:], y[-2:])}


def of_points(size):
    """More output points, on a finer mesh: 16 rays each."""
    n = round((size / 6) ** 0.5) - 1
    scene = join_meshes([walls(n), *_blocks()], [WHITE], [LAMP])
    with make_cells(default_cells()) as cells:
        run(bake(join_meshes([walls(10), *_blocks()], [WHITE], [LAMP]), Settings.for_error(0.02), cells))  # warms up
        found = run(bake(scene, Settings.for_error(0.02, gather_rays=16), cells))
    return _told(len(found.points), found)


def of_patches(size):
    """More patches in one mesh: CPU seconds until the end of transport."""
    scene = join_meshes([walls(1), *_blocks()], [WHITE], [LAMP])
    edge = (2 * (20 + 15 + 12) / size) ** 0.5 / scene.diagonal
    with make_cells(default_cells()) as cells:
        run(bake(scene, Settings.for_error(0.02), cells))  # warms up
        begun, used = process_time(), cells.usage.snapshot()
        settings = Settings.for_error(0.02, patch_edge=edge)
        generator = bake(scene, settings, cells)
        phase = ""
        while phase != "gather":
            phase = next(generator).phase
        now = cells.usage
        cpu = process_time() - begun + (now.cpu - used.cpu) - (now.here - used.here)
        rays = now.rays - used.rays
        found = run(generator)
    return {**_told(len(found.patches), found), "cpu": cpu, "rays": rays}


def of_emitters(size):
    """More glowing faces of together one square meter, which hang in a room, each turned its own way: at 2 %."""
    random = np.random.default_rng(1)
    per_row = int(np.ceil(size**0.5))
    k = np.arange(size)
    place = np.stack(
        [
            0.5 + 3 * (k % per_row + 0.5) / per_row,
            0.5 + 4 * (k // per_row + 0.5) / per_row,
            random.uniform(2.3, 2.7, size),
        ],
        axis=1,
    )
    glowing = tiles("glowing", place, 0.5 / size**0.5, random, material=1)
    materials = [WHITE, Material("glow", BLACK, exitance=(20.0,) * 3)]
    scene = join_meshes([walls(40), *_blocks(), glowing], materials, written=[True] * 4 + [False])
    with make_cells(default_cells()) as cells:
        found = run(bake(scene, Settings.for_error(0.02), cells))
    return {
        **_told(size, found),
        "points": len(found.points),
        "estimated": found.estimate.total,
        "converged": found.converged,
    }


def of_objects(size):
    """The same ten thousand tiles over a floor as more and more objects, read from Blender and written there: at 5 %."""
    random = np.random.default_rng(1)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    k = np.arange(TILES)
    place = np.stack([k % 100 / 10, k // 100 / 10, random.uniform(0.2, 0.8, TILES)], axis=1)
    for number, own in enumerate(np.array_split(place, size)):
        mesh = tiles("", own, 0.03, random)
        _add(f"tiles {number}", mesh.vertices, mesh.corner_vertex.reshape(-1, 4))
    _add("floor", *grid([(-1, -1, 0), (11, -1, 0), (11, 11, 0), (-1, 11, 0)], 60, 60))
    lamp = bpy.data.lights.new("lamp", "POINT")
    lamp.energy = 2000.0
    holder = bpy.data.objects.new("lamp", lamp)
    holder.location = (5, 5, 4)
    bpy.context.scene.collection.objects.link(holder)
    with make_cells(default_cells()) as cells:
        begun = process_time()
        job = Job(bpy.context, Options(error=0.05), cells)
        read = process_time() - begun
        run(job.bake())
        begun = process_time()
        job.write(bpy.context)
        write = process_time() - begun
    told = _told(size, job.result)
    return {**told, "cpu": read + told["cpu"] + write, "read": read, "write": write, "points": len(job.result.points)}


def _told(size, found):
    """What a Bake took; its peak memory [MB], of the host and of all cells."""
    return {
        "size": size, "cpu": found.seconds["cpu"], "rays": found.rays, "host_mb": found.cells["host_mb"],
        "cells_mb": sum(found.cells["cells_mb"]),
    }  # fmt: skip


def walls(n):
    """A room of n x n quads a wall, without lists of Python's numbers, which would count in the memory."""
    sides = [grid(corners, n, n) for corners in box_corners((0, 0, 0), (4, 5, 3)).values()]
    first = np.cumsum([0] + [len(v) for v, _ in sides])
    return _of_quads(
        "room", np.concatenate([v for v, _ in sides]), np.concatenate([q + f for (_, q), f in zip(sides, first)])
    )


def _blocks():
    """Three blocks that stand in the room."""
    return [
        box(f"block {k}", (0.6 + k, 1 + k, 0), (1.1 + k, 1.6 + k, 0.6 + 0.3 * k), 4, False, faces="xXyYZ")
        for k in range(3)
    ]


def tiles(name, place, half, random, material=0):
    """Squares with edges of 2 * half about places (K, 3), each turned its own way, as one Mesh."""
    normal = random.normal(size=(len(place), 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    across = np.cross(normal, np.eye(3)[np.abs(normal).argmin(axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    along = np.cross(normal, across)
    corners = [place + half * (a * across + b * along) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    vertices = np.stack(corners, axis=1).reshape(-1, 3)
    return _of_quads(name, vertices, np.arange(len(vertices)).reshape(-1, 4), material)


def _of_quads(name, vertices, quads, material=0):
    start = 4 * np.arange(len(quads) + 1)
    return Mesh(
        name,
        vertices,
        start.astype(np.int32),
        quads.reshape(-1).astype(np.int32),
        np.full(len(quads), material, np.int32),
    )


def _add(name, vertices, quads):
    """A mesh object in Blender's open file."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices.tolist(), [], quads.tolist())
    bpy.context.scene.collection.objects.link(bpy.data.objects.new(name, mesh))


if __name__ == "__main__":
    print(json.dumps(globals()[f"of_{sys.argv[1]}"](int(sys.argv[2]))), flush=True)
