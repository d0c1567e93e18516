"""Scenes with known answers, and the way from them to light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cell_radiosity.core.bake import bake, run
from cell_radiosity.core.host import solve
from cell_radiosity.core.kernel import scene_arrays
from cell_radiosity.core.lights import make_sources
from cell_radiosity.core.patches import make_patches
from cell_radiosity.core.scene import Lamp, Material, Mesh, World, join_meshes
from cell_radiosity.core.settings import Settings
from cell_radiosity.core.sky import split_sky
from cell_radiosity.core.surfaces import make_surfaces

__all__ = ["Lamp", "Material", "Mesh", "Settings", "World", "bake", "join_meshes", "run"]

FACES = ("x", "X", "y", "Y", "z", "Z")  # of a box; a capital is the side of the higher coordinate


def grid(corners, columns=1, rows=1):
    """Vertices and quads of a grid over four corners, counterclockwise as seen from the front."""
    a, b, c, d = np.asarray(corners, float)
    u, v = (x.reshape(-1, 1) for x in np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1)))
    vertices = (1 - u) * (1 - v) * a + u * (1 - v) * b + u * v * c + (1 - u) * v * d
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).reshape(-1)
    return vertices, np.stack([first, first + 1, first + columns + 2, first + columns + 1], axis=1)


def sheet(name, corners, columns=1, rows=1, material=0):
    """A rectangle of quads as a Mesh."""
    vertices, quads = grid(corners, columns, rows)
    return Mesh.of_polygons(name, vertices, quads.tolist(), material)


def box_corners(low=(0, 0, 0), high=(1, 1, 1), inward=True):
    """{face: four corners} of a box whose faces look inward (a room) or outward (a block)."""
    (x, y, z), (X, Y, Z) = low, high
    faces = {
        "x": ((x, Y, z), (x, y, z), (x, y, Z), (x, Y, Z)),
        "X": ((X, y, z), (X, Y, z), (X, Y, Z), (X, y, Z)),
        "y": ((x, y, z), (X, y, z), (X, y, Z), (x, y, Z)),
        "Y": ((X, Y, z), (x, Y, z), (x, Y, Z), (X, Y, Z)),
        "z": ((x, Y, z), (X, Y, z), (X, y, z), (x, y, z)),
        "Z": ((x, y, Z), (X, y, Z), (X, Y, Z), (x, Y, Z)),
    }
    return {face: np.array(corners, float)[:: -1 if inward else 1] for face, corners in faces.items()}


def box(name="box", low=(0, 0, 0), high=(1, 1, 1), n=1, inward=True, materials=None, faces=FACES):
    """A box of n x n quads a face as one Mesh. materials: {face: number}, default 0."""
    vertices, polygons, slots = [], [], []
    corners = box_corners(low, high, inward)
    for face in faces:
        v, q = grid(corners[face], n, n)
        polygons += (q + sum(map(len, vertices))).tolist()
        slots += [(materials or {}).get(face, 0)] * len(q)
        vertices.append(v)
    return Mesh.of_polygons(name, np.concatenate(vertices), polygons, slots)


def icosphere(name="sphere", radius=1.0, splits=2, inward=True, material=0):
    """A sphere of 20 * 4^splits triangles; `material` may be a function of the triangles' centers (T, 3)."""
    g = (1 + 5**0.5) / 2
    v = np.array([(s * a, t * b, 0) for a, b in ((1, g),) for s in (1, -1) for t in (1, -1)], float)
    v = np.concatenate([v, np.roll(v, 1, axis=1), np.roll(v, 2, axis=1)])
    near = np.sqrt(((v[:, None] - v[None]) ** 2).sum(-1))
    edge = np.isclose(near, 2.0)
    triangles = [
        (i, j, k)
        for i in range(12)
        for j in range(i + 1, 12)
        for k in range(j + 1, 12)
        if edge[i, j] and edge[j, k] and edge[i, k]
    ]
    corners = v[np.array(triangles)]
    outward = (
        np.einsum("td,td->t", np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), corners[:, 0]) > 0
    )
    corners[~outward] = corners[~outward][:, ::-1]
    for _ in range(splits):
        a, b, c = (corners[:, k] for k in range(3))
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        corners = np.concatenate([np.stack(t, 1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    corners /= np.sqrt((corners**2).sum(-1, keepdims=True)) / radius
    if inward:
        corners = corners[:, ::-1]
    vertices, index = np.unique(corners.reshape(-1, 3).round(9), axis=0, return_inverse=True)
    triangles = index.reshape(-1, 3)
    slots = material(vertices[triangles].mean(axis=1)) if callable(material) else material
    return Mesh.of_polygons(name, vertices, triangles.tolist(), slots)


@dataclass(frozen=True)
class Solved:
    """A solved scene, with what it took."""

    scene: object
    patches: object
    surfaces: object
    solution: object

    @property
    def radiosity(self):
        """(C, 2 N) all light that leaves the sides."""
        return self.solution.reflected + self.surfaces.exitance

    def mean(self, values, polygons=None, side=0):
        """Area-weighted mean (C,) of values (C, 2 N) over the patches of some polygons, on one side."""
        chosen = np.ones(len(self.patches), bool) if polygons is None else np.isin(self.patches.polygon, polygons)
        area = self.patches.area[chosen]
        return (area * values[:, side::2][:, chosen]).sum(axis=1) / area.sum()


def solve_scene(scene, cells, edge=None, found=False, **settings):
    """Solve a scene for its patches. edge: of patches [m], None for one per polygon. found: emitting faces are no
    sampled sources, rays find them."""
    settings = Settings(**{"error": 1e-3, **settings})
    patches = make_patches(scene, edge)
    sources, sampled = make_sources(scene)
    if found:
        sources, sampled = make_sources(join_meshes([], lamps=scene.lamps))[0], np.zeros_like(sampled)
    surfaces = make_surfaces(scene, patches, sampled)
    sky = np.pi * split_sky(scene.world)[0].T
    cells.start(scene_arrays(scene, patches, sources, sky.shape[1]))
    return Solved(scene, patches, surfaces, run(solve(patches, surfaces, sky, cells, settings)))


def point_light(baked, places):
    """(K, C) irradiance at the points of a Bake that are nearest to places (K, 3)."""
    light = (baked.light.direct + baked.light.indirect).T
    gap = ((baked.points.position[None] - np.asarray(places, float)[:, None]) ** 2).sum(-1)
    return light[gap.argmin(axis=1)]
