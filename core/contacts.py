"""Contacts: patches on which something stands, or through which something passes, are cut along that line.

A patch that is half inside a box and half outside would lend the light of one half to the other: boxes on a lit floor
would glow inside, and the floor beside them would be too dark. Short rays along each patch, just above it, find what
crosses it; the patch is cut by the planes of the triangles they meet. (Lightscape's manual names explicit
intersections as the cure for light leaks, and leaves them to the user.)
"""

from __future__ import annotations

from itertools import product

import numpy as np

from .cuts import cut_patches
from .patches import CUTS
from .records import to_arrays
from .scene import FLAT, normal_and_area
from .vectors import by_coordinate, counted, dot, rows_of, runs

# Of the rays above the patch, in scene diagonals: they find what touches it, and what ends a little above it.
HEIGHTS = 5e-5, 1e-3
INSET = 1e-3  # how far they start inside the patch's corners, as a share of their length
# At each height: a triangle whose normal is closer to the patch's than this lies along it, and does not cut. Rays that are
# higher meet the next facets of a curved surface too.
ALONG = 0.999, 0.5
# Of the patch's length, at which further rays find what hangs close before it: hardly more light comes out behind it than
# below a box. Patches half behind pictures 3 cm before a wall took a 25th of the reflected light of a gallery there.
HANGS = 0.15
PATHS = 6  # along a parallelogram
MOST_ELEMENTS = 4  # of a cluster, from whose corners it is looked over
TASK_PATCHES = 1 << 13


def cut_contacts(scene, patches, cells):
    """Patches cut along whatever crosses them. cells: started with the arrays of the scene and these patches."""
    ids = np.arange(len(patches))
    for _ in range(CUTS):
        parts = [ids[k : k + TASK_PATCHES] for k in range(0, len(ids), TASK_PATCHES)]
        found = cells.take([cells.submit("contacts", ids=part) for part in parts])
        blocker = np.concatenate([np.zeros(0, np.int32), *(result["blocker"] for result in found)])
        crossed = np.flatnonzero(blocker >= 0)
        normal = scene.triangle_normal_area[0][blocker[crossed]]
        place = scene.vertices[scene.triangles[blocker[crossed], 0]]
        cut, ids = cut_patches(patches, ids[crossed], np.column_stack([normal, dot(normal, place)]))
        if not len(ids):  # nothing was cut
            break
        patches = cut
        cells.start(to_arrays("patches", patches))
    return patches


def find_contacts(kernel, ids):
    """{"blocker": (K,) int32} a triangle that crosses each of the patches ids (K,), on either side; -1 if none is found.

    Rays go from corner to opposite corner of a parallelogram, else from the centroid to every corner, and along all edges:
    no line through a convex patch misses them all, nor does a corner of a block that reaches into it.
    """
    blocker = np.full(len(ids), -1, np.int32)
    for part in runs(len(ids), PATHS):
        own = ids[part]
        owner, start, stop = _paths(kernel.patches, own)
        normal = rows_of(kernel.patches.normal, own[owner])
        up = normal.astype(np.float32)
        start, stop = kernel.caster.place(start), kernel.caster.place(stop)
        found = blocker[part]
        size = np.sqrt(kernel.patches.area[own])[owner, None] * kernel.caster.frame[1]
        levels = (*zip(HEIGHTS, ALONG), (np.maximum(HANGS * size, HEIGHTS[-1]).astype(np.float32), ALONG[-1]))
        for (height, along), side in product(levels, (1, -1)):
            begin = start + (side * height) * up
            # Whether anything is met takes a third of the time of what it is, and most meet nothing.
            met = np.flatnonzero((found[owner] < 0) & kernel.caster.blocked(begin, begin + (stop - start)))
            triangle, u, v, distance, _ = kernel.caster.hits(begin[met], (stop - start)[met])
            corners = rows_of(kernel.triangles, triangle).T
            corners = [by_coordinate(rows_of(kernel.vertices, corner)) for corner in corners]
            facing = normal_and_area(*corners)[0]
            across = (triangle >= 0) & (distance < 1.0) & (np.abs(dot(facing, rows_of(normal, met))) < along)
            across &= kernel.patch_hit(triangle, u, v) != own[owner[met]]
            # The plane that is nearest to the middle: others may cut off too little to be worth it.
            away = np.abs(dot(facing, rows_of(kernel.patches.centroid, own[owner[met]]) - corners[0]))
            last = np.flatnonzero(across)[np.argsort(-away[across], kind="stable")]
            found[owner[met[last]]] = triangle[last]
    return {"blocker": blocker}


def _paths(patches, ids):
    """Segments along patches: the patch of each as its row in ids (M,), and their ends (M, 3). Curved ones have none."""
    first, count = patches.element_start[ids], np.diff(patches.element_start)[ids]
    flat = patches.flatness[ids] >= FLAT
    plain = (count == 1) & patches.element_square[first]
    square, other = np.flatnonzero(plain), np.flatnonzero(~plain & flat)
    p, a, b = np.moveaxis(patches.element_frame[first[square]], 1, 0)
    ring = _drawn_in(p + (a + b) / 2, 2 * INSET, [p, p + a, p + a + b, p + b])
    owners, starts, stops = [square] * PATHS, [*ring, *ring[:2]], [*ring[1:], ring[0], *ring[2:]]

    # Of a cluster, the corners and the edges of a few elements spread over it.
    owner, step = counted(np.minimum(count[other], MOST_ELEMENTS))
    element = first[other][owner] + step * count[other][owner] // np.minimum(count[other], MOST_ELEMENTS)[owner]
    owner = other[owner]
    p, a, b = np.moveaxis(patches.element_frame[element], 1, 0)
    far = patches.element_square[element]
    for shape, corners in ((~far, (p, p + a, p + b)), (far, (p, p + a, p + a + b, p + b))):
        who = owner[shape]
        middle = patches.centroid[ids[who]]
        ring = _drawn_in(middle, INSET, [corner[shape] for corner in corners])
        owners += [who] * 2 * len(ring)
        starts += [*_drawn_in(middle, 1 + INSET, ring), *ring]  # from behind the centroid, for what passes through it
        stops += [*ring, *ring[1:], ring[0]]
    return tuple(np.concatenate(parts) for parts in (owners, starts, stops))


def _drawn_in(middle, share, corners):
    """Corners, a list of (K, 3), moved by a share of the way to the middle (K, 3) of each."""
    return [corner + share * (middle - corner) for corner in corners]
