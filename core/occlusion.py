"""Ambient occlusion: how much of what a point could see stands within a given distance. No light is asked for."""

from __future__ import annotations

import numpy as np

from .points import Block, block_arrays
from .sampling import fraction, hemisphere, lattice, scatter, tangents
from .vectors import dot, runs

RAYS = 96  # of a point
FARTHEST = 1e6  # that a ray goes, in the caster's units, in which a scene is about 1
TASK_POINTS = 1 << 10
SALT = 21


def find_openness(points, distance, cells, seed):
    """(P,) cosine-weighted share of each point's hemisphere in which nothing stands within a distance [m]: 1 in the open.
    A generator that yields (points done, all points). cells: started with the scene."""
    parts = [slice(k, min(k + TASK_POINTS, len(points))) for k in range(0, len(points), TASK_POINTS)]
    each = (
        dict(distance=float(distance), seed=seed, **block_arrays(points, np.arange(p.start, p.stop), joined=False))
        for p in parts
    )
    openness = np.ones(len(points))
    for part, result in zip(parts, cells.flow("openness", each)):
        openness[part] = result["openness"]
        yield part.stop, len(points)
    return openness


def openness_of_points(kernel, distance, seed, **points):
    """{"openness": (K,)} of the K points of a Block, see `find_openness`."""
    points = Block(**points)
    u, v = lattice(RAYS)
    reach = np.float32(min(distance * kernel.caster.frame[1], FARTHEST))
    openness = np.empty(len(points))
    for part in runs(len(points), RAYS):
        ids = points.ids[part].astype(np.int64)
        normal, geometric = points.normal[part], points.geometric[part]
        turn = scatter(ids, SALT + 8 * seed)[:, None]
        local = hemisphere(np.broadcast_to(u, (len(ids), RAYS)), fraction(v + turn))
        t1, t2 = tangents(normal)
        direction = np.einsum("knj,kjd->knd", local, np.stack([t1, t2, normal], axis=1))
        above = dot(direction, geometric[:, None]) > 0
        origin = np.repeat(kernel.caster.start(points.position[part], geometric), RAYS, axis=0)
        target = origin + reach * direction.reshape(-1, 3).astype(np.float32)
        free = ~kernel.caster.blocked(origin, target).reshape(-1, RAYS) & above
        openness[part] = free.sum(axis=1) / RAYS
    return {"openness": openness}
