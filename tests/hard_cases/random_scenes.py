"""Random broken scenes: whatever a file can hold, and more. The seed is all that a scene depends on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cell_radiosity.core.settings import EFFECTS
from cell_radiosity.core.surfaces import Texture

from scenes import Lamp, Material, Mesh, Settings, World, box, icosphere, join_meshes, sheet

ODD = (0.0, -0.0, 1.0, -1.0, 1e-300, 1e-30, 1e-7, 1e7, 1e30, 1e300, -1e30, np.nan, np.inf, -np.inf)


class Chance:
    """Draws of one random scene."""

    def __init__(self, seed):
        self.random = np.random.default_rng(seed)

    def happens(self, share):
        return bool(self.random.random() < share)

    def pick(self, items):
        return items[int(self.random.integers(len(items)))]

    def number(self, low, high):
        return float(self.random.uniform(low, high))

    def odd(self, values, share):
        """Values with a share of them replaced by odd numbers."""
        values = np.array(values, float)
        hit = self.random.random(values.shape) < share
        values[hit] = self.random.choice(ODD, int(hit.sum()))
        return values


def soup(chance, name):
    """Triangles anywhere."""
    count = int(chance.random.integers(1, 12))
    return Mesh.of_polygons(
        name, chance.random.uniform(-1, 2, (3 * count, 3)), np.arange(3 * count).reshape(-1, 3).tolist()
    )


def polygons(chance, name):
    """Polygons of any number of corners, repeated ones too, that cross themselves and one another."""
    vertices = chance.random.uniform(-1, 1, (8, 3)) * (1, 1, chance.pick((0, 0, 1)))
    sizes = chance.random.integers(3, 7, int(chance.random.integers(1, 5)))
    return Mesh.of_polygons(name, vertices, [chance.random.integers(0, 8, n).tolist() for n in sizes])


def thin(chance, name):
    """A fan of slivers."""
    widths = np.cumsum(10.0 ** chance.random.uniform(-9, 0, 6))
    vertices = [(0, 0, 0), *((x, 1, 0) for x in widths)]
    return Mesh.of_polygons(name, vertices, [(0, k + 2, k + 1) for k in range(5)])


def block(chance, name):
    low = chance.random.uniform(0, 0.6, 3).round(1)
    return box(
        name,
        low,
        low + chance.random.uniform(0.1, 0.4, 3).round(1),
        int(chance.random.integers(1, 4)),
        chance.happens(0.3),
    )


def room(chance, name):
    faces = "".join(f for f in "xXyYzZ" if not chance.happens(0.1)) or "z"
    return box(name, n=int(chance.random.integers(1, 4)), faces=faces, inward=not chance.happens(0.2))


def ball(chance, name):
    made = icosphere(name, chance.number(0.05, 0.5), int(chance.random.integers(0, 3)), chance.happens(0.3))
    return replace(made, vertices=made.vertices + 0.5)


def quad(chance, name):
    corners = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], float) + (0, 0, chance.pick((0.0, 0.5, 1.0, 1e-6)))
    if chance.happens(0.3):
        corners[2] += chance.random.normal(0, 0.3, 3)  # warped
    return sheet(
        name, corners[:: chance.pick((1, -1))], int(chance.random.integers(1, 4)), int(chance.random.integers(1, 4))
    )


def dot(chance, name):
    return Mesh.of_polygons(name, np.zeros((4, 3)) + chance.number(0, 1), [(0, 1, 2, 3), (0, 0, 0)])


def nothing(chance, name):
    return Mesh.of_polygons(name, chance.random.uniform(0, 1, (int(chance.random.integers(0, 3)), 3)), [])


MAKERS = (soup, polygons, thin, block, block, room, room, ball, quad, quad, dot, nothing)


def broken(chance, mesh, materials):
    """A mesh with odd materials, normals, places and vertices."""
    count = len(mesh.polygon_material)
    changes = dict(polygon_material=chance.random.integers(0, materials, count))
    vertices = mesh.vertices
    if chance.happens(0.3):
        scale = 10.0 ** chance.random.uniform(-7, 7) if chance.happens(0.2) else 10.0 ** chance.random.uniform(-1, 1)
        vertices = (
            vertices * scale * (np.where(chance.random.random(3) < 0.1, 0.0, 1.0) if chance.happens(0.2) else 1.0)
        )
    if chance.happens(0.2):
        vertices = vertices + chance.random.normal(0, 1, 3) * 10.0 ** chance.random.uniform(
            -3, 8 if chance.happens(0.1) else 1
        )
    if chance.happens(0.2):
        vertices = chance.odd(vertices, 0.05)
    if chance.happens(0.1) and len(vertices):
        vertices = vertices[chance.random.integers(0, len(vertices), len(vertices))]
    if chance.happens(0.2):
        normal = chance.random.normal(0, 1, (len(mesh.corner_vertex), 3))
        changes["corner_normal"] = chance.odd(normal / np.sqrt((normal**2).sum(axis=1, keepdims=True)), 0.05)
    if chance.happens(0.2):
        changes["corner_uv"] = chance.odd(chance.random.normal(0, 2, (len(mesh.corner_vertex), 2)), 0.05)
    return replace(mesh, vertices=vertices, **changes)


def material(chance, k, textures):
    exitance = 10.0 ** chance.random.uniform(-3, 3) * chance.random.random(3) if chance.happens(0.25) else (0, 0, 0)
    reflectance = chance.random.random(3) if chance.happens(0.7) else np.full(3, chance.pick((0, 0.5, 0.95, 1.0, 1.5)))
    extra = {}
    if textures and chance.happens(0.2):
        extra["texture"] = 0
    if chance.happens(0.15):
        extra["alpha"] = chance.pick((0.0, 0.3, 0.999, 1.5, -1.0))
    if chance.happens(0.15):
        extra["translucency"] = tuple(chance.random.random(3))
    return Material(
        f"material {k}", tuple(chance.odd(reflectance, 0.02)), tuple(chance.odd(exitance, 0.02)), **extra
    )  # fmt: skip


def lamp(chance, k):
    axes = np.linalg.qr(chance.random.normal(0, 1, (3, 3)))[0]
    strength = 10.0 ** chance.random.uniform(-3, 3) * chance.random.random(3)
    return Lamp(
        chance.pick(("point", "spot", "sun", "area")), tuple(chance.odd(strength, 0.02)),
        tuple(chance.odd(chance.pick((chance.random.uniform(-0.5, 1.5, 3), chance.random.integers(0, 3, 3) / 2)), 0.01)),
        axes, f"lamp {k}", radius=chance.pick((0.0, 0.01, 0.5, 5.0)), soft=chance.happens(0.5),
        angle=chance.pick((0.0, 0.01, 1.0, 3.0, 3.14159265, 6.5)), blend=chance.pick((0.0, 0.15, 1.0)),
        size=tuple(chance.pick(((1, 1), (0.1, 0.3), (0, 1), (0, 0), (1e-6, 1e-6), (-1, 1)))), ellipse=chance.happens(0.3),
    )  # fmt: skip


def random_scene(seed):
    """A random Scene."""
    chance = Chance(seed)
    textures = (Texture("image", chance.random.random((4, 4, 3)).astype(np.float32)),) if chance.happens(0.2) else ()
    count = int(chance.random.integers(1, 5))
    materials = [material(chance, k, textures) for k in range(count)]
    meshes = []
    for k in range(int(chance.random.integers(0, 6))):
        meshes.append(broken(chance, chance.pick(MAKERS)(chance, f"object {k}"), count))
        if chance.happens(0.1):
            meshes.append(replace(meshes[-1], name=f"again {k}"))
    lamps = [lamp(chance, k) for k in range(int(chance.random.integers(0, 4)))]
    world = World(tuple(chance.odd(chance.random.random(3), 0.02))) if chance.happens(0.3) else World()
    written = chance.random.random(len(meshes)) < 0.9
    return join_meshes(meshes, materials, lamps, world, written, textures=textures)


def random_settings(seed, scene):
    """Random Settings for a random scene, small ones. The paper's schedule, for which white rooms have no end, is for
    a few dark faces."""
    chance = Chance((seed, 1))
    most = max(np.nanmax(np.abs(np.add(m.reflectance, m.translucency))) for m in scene.materials)
    paper = chance.happens(0.3) and len(scene.triangles) < 20 and most < 0.7 and not scene.textures
    return Settings(
        error=chance.pick((0.3, 0.1, 0.02)), seed=int(chance.random.integers(0, 100)),
        patch_edge=None if paper else chance.pick((None, 0.3, 0.15, 0.15)), row_rays=int(chance.pick((4, 8))),
        gather_rays=int(chance.pick((4, 16))), side=chance.pick(("front", "back", "lit")),
        schedule="paper" if paper else "dynamic", rows=chance.pick(("rays", "analytic")) if paper else "rays",
        memory=chance.pick((2e9, 2e9, 1e7)), force=EFFECTS if chance.happens(0.1) else (),
    )  # fmt: skip
