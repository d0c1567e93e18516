"""Placing: what stands beside the places where points would lie, and what becomes of points that cannot lie anywhere.

Owns the rays by which points are kept clear of other surfaces, and the refilling of points on faces so thin that no
place on them is surely on the right side of their neighbors: they take the light of the points that they are joined to.
Points inside solids keep what they get there, nothing: a floor is dark below a box.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .health import Finding
from .scene import normal_and_area
from .vectors import length, rows_of

RINGS = 16  # steps from neighbor to neighbor, by which light is carried to points without their own


def find_blocked(kernel, start, stop, up, stop_up):
    """{"blocked": (K,) bool} whether anything lies on segments between places (K, 3), just above surfaces with normals
    (K, 3)."""
    ends = kernel.caster.start(start, up), kernel.caster.start(stop, stop_up)
    return {"blocked": kernel.caster.blocked(*ends)}


def find_reach(kernel, start, stop, up, stop_up):
    """{"reach": (K,)} share of the same segments up to the first thing on them, 1 where there is nothing."""
    begin = kernel.caster.start(start, up)
    triangle, _, _, distance, _ = kernel.caster.hits(begin, kernel.caster.start(stop, stop_up) - begin)
    return {"reach": np.where(triangle < 0, 1.0, np.minimum(distance.astype(float), 1.0))}


def find_met(kernel, position, normal, direction):
    """{"place": (K, 3), "facing": (K, 3), "back": (K,) bool} where rays from just above places on surfaces (K, 3) meet
    something, the unit normal of the face there, and whether they meet its back; all 0 where they meet nothing. direction:
    (K, 3)."""
    start = kernel.caster.start(position, normal)
    triangle, u, v, _, back = kernel.caster.hits(start, direction.astype(np.float32))
    a, b, c = (rows_of(kernel.vertices, corner) for corner in rows_of(kernel.triangles, triangle).T)
    place = a + u[:, None].astype(float) * (b - a) + v[:, None].astype(float) * (c - a)
    met = triangle >= 0
    there, facing = met[:, None], normal_and_area(a, b, c)[0]
    return {"place": np.where(there, place, 0.0), "facing": np.where(there, facing, 0.0), "back": back & met}


def refill(points, light):
    """A Light with that of thin points taken from their neighbors, and from theirs where these are thin as well."""
    if not points.thin.any():
        return light
    here, there = np.repeat(np.arange(len(points)), np.diff(points.neighbor_start)), points.neighbor
    near = 1.0 / np.maximum(length(points.position[here] - points.position[there]), 1e-300)
    rows = np.concatenate([light.direct, light.indirect])
    known = ~points.thin
    for _ in range(RINGS):
        use = ~known[here] & known[there]
        if not use.any():
            break
        weight = np.bincount(here[use], near[use], len(points))
        filled = weight > 0
        for row in rows:
            row[filled] = np.bincount(here[use], near[use] * row[there[use]], len(points))[filled] / weight[filled]
        known |= filled
    count = len(light.direct)
    return replace(light, direct=rows[:count], indirect=rows[count:])


def thin_findings(scene, points):
    """Findings about objects with faces that are too thin."""
    count = np.bincount(points.object[points.thin], minlength=len(scene.objects))
    for o in np.flatnonzero(count):
        yield Finding(
            scene.objects[o],
            f"{count[o]} points are only on faces a thousand times longer than wide",
            "they took the light of their neighbors",
        )
