"""Random scenes of many lamps and glowing faces: of any size, near one another or far away, dim or bright, among veils, under
skies, at any scale and place. What is in them is not broken, but of all ranges at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from random_scenes import Chance

from cell_radiosity.core.settings import EFFECTS
from cell_radiosity.core.surfaces import Readings, Texture

from scenes import Lamp, Material, Mesh, Settings, World, box, icosphere, join_meshes, sheet

KINDS = (("point",), ("spot",), ("area",), ("point", "area"), ("point", "spot", "area", "sun"))
GLOW = 3  # number of the first of the materials that emit


def lamps(chance):
    """A crowd of lamps."""
    random, count = chance.random, chance.pick((2, 9, 33, 33, 40, 80))
    places = {
        "spread": random.uniform(0, 1, (count, 3)),
        "in a cluster": 0.5 + 10.0 ** random.uniform(-12, -1) * random.normal(0, 1, (count, 3)),
        "far": 10.0 ** random.uniform(1, 10) * random.normal(0, 1, (count, 3)),
        "everywhere": 0.5 + random.normal(0, 1, (count, 3)) * 10.0 ** random.uniform(-8, 8, (count, 1)),
        "on a grid": random.integers(0, 4, (count, 3)) / 3,
        "in one place": np.tile(random.uniform(0, 1, 3), (count, 1)),
    }
    place, kinds = chance.pick(list(places.values())), chance.pick(KINDS)
    size, ratio = 10.0 ** random.uniform(-9, 1), chance.pick((0, 1, 12))
    strength = 10.0 ** (random.uniform(-3, 3) if chance.happens(0.7) else random.uniform(-30, 24))
    made = []
    for k in range(count):
        own = strength * 10.0 ** random.uniform(-ratio, ratio) * random.random(3) * chance.pick((1, 1, 1, 0))
        axes = np.linalg.qr(random.normal(0, 1, (3, 3)))[0]
        made.append(Lamp(
            chance.pick(kinds), tuple(own), tuple(place[k]), axes, f"lamp {k}", radius=chance.pick((0.0, 0.0, size, 3.0)),
            soft=chance.happens(0.5), angle=chance.pick((0.0, 1e-6, 0.01, 1.0, 3.14, 6.28)), blend=chance.pick((0.0, 0.15, 1.0)),
            size=tuple(size * 10.0 ** random.uniform(-1, 1, 2)), ellipse=chance.happens(0.2),
            spread=chance.pick((np.pi, np.pi, np.pi, 1.0, 0.02, 1e-9)),
        ))  # fmt: skip
    return made


def glowing(chance, name, material):
    """Many faces that emit: a grid, a ball, or scraps here and there, all of them small or not."""
    random, n, size = chance.random, chance.pick((1, 3, 7)), 10.0 ** chance.number(-6, 0)
    place = random.uniform(0.1, 0.9, 3)
    square = np.array([(0, 0, 0), (0, 1, 0), (1, 1, 0), (1, 0, 0)], float)
    if chance.happens(0.3):
        return sheet(name, place + size * square, n, n, material)
    if chance.happens(0.3):
        ball = icosphere(name, size / 2, int(random.integers(0, 2)), False, material)
        return replace(ball, vertices=ball.vertices + place)
    corners = np.repeat(random.uniform(0, 1, (n * n, 3)), 3, axis=0) + size * random.normal(0, 1, (3 * n * n, 3))
    return Mesh.of_polygons(name, corners, np.arange(3 * n * n).reshape(-1, 3).tolist(), material)


def things(chance):
    """Meshes that light falls on."""
    random = chance.random
    found = [box("room", n=int(random.integers(1, 4)), faces=[f for f in "xXyYzZ" if not chance.happens(0.1)] or "z")]
    for k in range(int(random.integers(0, 3))):
        low = random.uniform(0, 0.7, 3) * (1, 1, chance.pick((0, 1)))
        size = random.uniform(0.05, 0.3, 3) * (10.0 ** random.uniform(-4, 0) if chance.happens(0.3) else 1.0)
        found.append(box(f"block {k}", low, low + size, int(random.integers(1, 3)), chance.happens(0.2)))
    if chance.happens(0.2):
        island = box("island", n=2)
        found.append(
            replace(island, vertices=island.vertices * 10.0 ** random.uniform(-3, 1) + 10.0 ** random.uniform(0, 5))
        )
    if chance.happens(0.2):
        found.append(
            sheet(
                "ground",
                10.0 ** random.uniform(1, 5) * np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]),
                2,
                2,
            )
        )
    return [replace(m, polygon_material=random.integers(0, GLOW, len(m.polygon_material))) for m in found]


def materials(chance, textures):
    """Three that reflect and two that emit, some of them let light through."""
    random, found = chance.random, []
    exitance = 10.0 ** (random.uniform(-3, 3) if chance.happens(0.7) else random.uniform(-30, 24))
    for k in range(GLOW + 2):
        more = {}
        if chance.happens(0.2):
            more["alpha"] = chance.pick((0.0, 0.3, 0.999, 1e-9))
        if textures and chance.happens(0.2):
            more["alpha_texture"] = 0
        if chance.happens(0.15):
            more["translucency"] = tuple(random.random(3))
        light = exitance * 10.0 ** random.uniform(0, 6) * random.random(3) if k >= GLOW else np.zeros(3)
        found.append(Material(f"material {k}", tuple(random.random(3)), tuple(light), **more))
    return found


def read_anew(chance, scene):
    """The scene with the light of its glowing faces read place by place, as that of screens is."""
    random = chance.random
    triangle = np.flatnonzero(scene.polygon_material[scene.triangle_polygon] >= GLOW)
    corner, triangle = np.unique(scene.triangle_corner[triangle]), np.repeat(triangle, 6)
    uv, colors = random.random((len(triangle), 2)), [random.random((len(x), 3)) for x in (triangle, corner)]
    uv = np.where(uv.sum(axis=1, keepdims=True) > 1, 1 - uv, uv)
    light = [c * 10.0 ** random.uniform(-3, 3, (len(c), 1)) * (random.random((len(c), 1)) < 0.7) for c in colors]
    return replace(scene, readings=Readings(triangle, uv, colors[0], light[0], corner, colors[1], light[1]))


def sky(chance):
    if chance.happens(0.6):
        return World()
    level = 10.0 ** chance.number(-6, 6)
    if chance.happens(0.5):
        return World(tuple(level * chance.random.random(3)))
    pixels = level * chance.random.random((8, 8, 3))
    pixels[2, 3] *= chance.pick((1, 1e6))
    return World(map=pixels)


def crowded_scene(seed):
    """A random Scene."""
    chance = Chance((seed, 2))
    random = chance.random
    textures = (Texture("image", random.random((4, 4, 3)).astype(np.float32)),) if chance.happens(0.3) else ()
    meshes = things(chance) + [glowing(chance, f"glow {k}", GLOW + k) for k in range(chance.pick((0, 1, 2)))]
    found = lamps(chance) if chance.happens(0.8) else []
    scale = 10.0 ** random.uniform(-6, 6) if chance.happens(0.4) else 1.0
    place = random.normal(0, 1, 3) * scale * (10.0 ** random.uniform(0, 8) if chance.happens(0.25) else 0.0)
    meshes = [
        replace(
            m,
            vertices=scale * m.vertices + place,
            corner_uv=random.uniform(-1, 2, (len(m.corner_vertex), 2)) if textures else None,
        )
        for m in meshes
    ]
    found = [
        replace(
            k,
            position=tuple(scale * np.array(k.position) + place),
            radius=scale * k.radius,
            size=tuple(scale * np.array(k.size)),
            strength=tuple(np.array(k.strength) * (scale * scale if k.kind in ("point", "spot") else 1.0)),
        )
        for k in found
    ]
    scene = join_meshes(meshes, materials(chance, textures), found, sky(chance), textures=textures)
    glows = (scene.polygon_material >= GLOW).any()
    return read_anew(chance, scene) if glows and chance.happens(0.2) else scene


def crowded_settings(seed):
    """Random Settings, small ones, of more kinds than those of random scenes."""
    chance = Chance((seed, 3))
    return Settings(
        error=chance.pick((0.3, 0.1)), seed=int(chance.random.integers(0, 100)), per_object=chance.happens(0.2),
        patch_edge=chance.pick((None, 0.3, 0.15)), row_rays=chance.pick((4, 8)), gather_rays=chance.pick((4, 16, None)),
        bounces=chance.pick((None, None, 0, 2)), light_samples=chance.pick((1.0, 1.0, 0.25, 4.0)), pilot_rays=chance.pick((1, 4)),
        side=chance.pick(("front", "front", "back", "lit")), occlusion=chance.pick((None, None, 0.3, 1e30)),
        memory=chance.pick((4e9, 1e7)), force=chance.pick(((), (), (), EFFECTS, (chance.pick(EFFECTS),))),
    )  # fmt: skip
