"""Contacts: patches on which something stands, or through which something passes, are cut along that line.

A patch that is half inside a box and half outside would lend the light of one half to the other: boxes on a lit floor
would glow inside, and the floor beside them would be too dark. Short rays along each patch, just above it, find what
crosses it; the patch is cut by the planes of the triangles they meet. (Lightscape's manual names explicit
intersections as the cure for light leaks, and leaves them to the user.)
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .kernel import blocks
from .patches import CUTS, join_elements
from .polygons import clip_polygons
from .records import to_arrays
from .scene import FLAT, normal_and_area
from .vectors import by_coordinate, counted, cross, dot, length, rows_of

HEIGHT = np.float32(5e-5)  # of the rays above the patch, in scene diagonals
INSET = 1e-3  # how far they start inside the patch's corners
LEAST = 1e-3  # share of a patch that is worth a cut
ALONG = 0.999  # a triangle whose normal is closer to the patch's than this lies along it, and does not cut
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
        cut, ids = _cut(scene, patches, ids[crossed], blocker[crossed])
        if not len(ids):  # nothing was cut
            break
        patches = cut
        cells.start(to_arrays("patches", patches))
    return patches


def find_contacts(kernel, ids):
    """{"blocker": (K,) int32} a triangle that crosses each of the patches ids (K,), on either side; -1 if none is found.

    Rays go from corner to opposite corner of a parallelogram, else from the centroid to every corner: no line through
    a convex patch misses them all.
    """
    blocker = np.full(len(ids), -1, np.int32)
    for part in blocks(len(ids), 4):
        own = ids[part]
        owner, start, stop = _paths(kernel.patches, own)
        normal = rows_of(kernel.patches.normal, own[owner])
        lift = HEIGHT * normal.astype(np.float32)
        start, stop = kernel.caster.place(start), kernel.caster.place(stop)
        found = blocker[part]
        for side in (1, -1):
            begin = start + side * lift
            # Whether anything is met takes a third of the time of what it is, and most meet nothing.
            met = np.flatnonzero(kernel.caster.blocked(begin, begin + (stop - start)))
            triangle, u, v, distance, _ = kernel.caster.hits(begin[met], (stop - start)[met])
            corners = rows_of(kernel.triangles, triangle).T
            facing = normal_and_area(*(by_coordinate(rows_of(kernel.vertices, corner)) for corner in corners))[0]
            across = (triangle >= 0) & (distance < 1.0) & (np.abs(dot(facing, rows_of(normal, met))) < ALONG)
            across &= kernel.patch_hit(triangle, u, v) != own[owner[met]]
            found[owner[met[across]]] = triangle[across]
    return {"blocker": blocker}


def _paths(patches, ids):
    """Segments along patches: the patch of each as its row in ids (M,), and their ends (M, 3). Curved ones have none."""
    first, count = patches.element_start[ids], np.diff(patches.element_start)[ids]
    flat = patches.flatness[ids] >= FLAT
    plain = (count == 1) & patches.element_square[first]
    square, other = np.flatnonzero(plain), np.flatnonzero(~plain & flat)
    p, a, b = np.moveaxis(patches.element_frame[first[square]], 1, 0)
    owners, starts, stops = [square, square], [p, p + a], [p + a + b, p + b]

    # Of a cluster, the corners of a few elements spread over it.
    owner, step = counted(np.minimum(count[other], MOST_ELEMENTS))
    element = first[other][owner] + step * count[other][owner] // np.minimum(count[other], MOST_ELEMENTS)[owner]
    owner = other[owner]
    p, a, b = np.moveaxis(patches.element_frame[element], 1, 0)
    far = patches.element_square[element]
    for who, corner in ((owner, p), (owner, p + a), (owner, p + b), (owner[far], (p + a + b)[far])):
        owners.append(who)
        starts.append(patches.centroid[ids[who]])
        stops.append(corner)
    start, stop = np.concatenate(starts), np.concatenate(stops)
    inset = INSET * (stop - start)
    return np.concatenate(owners), start + inset, stop - inset


def _cut(scene, patches, ids, blocker):
    """Patches with those of ids (K,) cut by the planes of triangles (K,), and the ids of what may be cut again."""
    normal = scene.triangle_normal_area[0][blocker]
    plane = np.column_stack([normal, dot(normal, scene.vertices[scene.triangles[blocker, 0]])])

    # Pieces of one cell share a record of its planes: one of them at a time is cut, and while there are planes left.
    record_of = np.full(len(patches), -1)
    record_of[patches.cut_patch.reshape(-1)] = np.repeat(np.arange(len(patches.cut_patch)), 1 << CUTS)
    record = record_of[ids]
    used = np.append((patches.cut_plane != 0).any(axis=2).sum(axis=1), 0)[record]
    fresh = record < 0
    chosen = fresh.copy()
    chosen[np.unique(record, return_index=True)[1]] = True
    waiting = ids[~chosen & (used < CUTS)]
    chosen &= used < CUTS

    # Split the elements in front of the plane from those behind; where nearly all is on one side, nothing is done.
    owner, element = _elements(patches, ids)
    front, back = (_half(patches, element, plane[owner], sign) for sign in (1.0, -1.0))
    areas = [np.bincount(owner[which], area, len(ids)) for which, _, area in (front, back)]
    chosen &= np.minimum(*areas) > LEAST * patches.area[ids]
    cut = np.flatnonzero(chosen)
    piece = np.full(len(ids), -1)
    piece[cut] = len(patches) + np.arange(len(cut))  # the part behind; the part in front keeps the patch's number
    stays = np.ones(len(patches.element_area), bool)
    stays[element[chosen[owner]]] = False
    kept = [(owner[which], frame) for which, frame, _ in (front, back)]
    kept = [(who[chosen[who]], frame[chosen[who]]) for who, frame in kept]
    joined = join_elements(
        np.concatenate([_elements(patches, np.arange(len(patches)))[0][stays], ids[kept[0][0]], piece[kept[1][0]]]),
        np.concatenate([patches.element_frame[stays], *(frame for _, frame in kept)]),
        np.append(patches.element_square[stays], np.zeros(sum(len(who) for who, _ in kept), bool)),
    )

    # Write the planes into the records; a cell that is cut for the first time gets one.
    new = np.flatnonzero(chosen & fresh)
    record[new] = len(patches.cut_patch) + np.arange(len(new))
    record_of[ids[new]] = record[new]
    first_cut = (patches.cell_patch >= 0) & np.isin(patches.cell_patch, ids[new])
    cell_patch = patches.cell_patch.copy()
    cell_patch[first_cut] = -1 - record_of[cell_patch[first_cut]]
    cut_plane = np.concatenate([patches.cut_plane, np.zeros((len(new), CUTS, 4))])
    cut_patch = np.concatenate([patches.cut_patch, np.repeat(ids[new, None], 1 << CUTS, axis=1)]).astype(np.int32)
    cut_plane[record[cut], used[cut]] = plane[cut]
    behind = (np.arange(1 << CUTS) >> used[cut, None]) & 1 == 0
    table = cut_patch[record[cut]]
    cut_patch[record[cut]] = np.where(behind & (table == ids[cut, None]), piece[cut, None], table)
    return replace(
        patches,
        **joined,
        polygon=np.append(patches.polygon, patches.polygon[ids[cut]]),
        cell_patch=cell_patch,
        cut_plane=cut_plane,
        cut_patch=cut_patch,
    ), np.concatenate([ids[cut], piece[cut], waiting])


def _elements(patches, ids):
    """The elements of patches: row in ids (M,) and element (M,)."""
    owner, number = counted(np.diff(patches.element_start)[ids])
    return owner, number + patches.element_start[ids][owner]


def _half(patches, element, plane, sign):
    """The triangles of elements (M,) in front of planes (M, 4), or behind them for sign -1: row in element (E,), frame
    (E, 3, 3), area (E,)."""
    p, a, b = np.moveaxis(patches.element_frame[element], 1, 0)
    square = patches.element_square[element]
    corner = np.stack([p, p + a, np.where(square[:, None], p + a + b, p + b), p + b], axis=1)
    value = sign * (np.einsum("kvd,kd->kv", corner, plane[:, :3]) - plane[:, 3:])
    polygon, sides = clip_polygons(corner, np.where(square, 4, 3), value)
    which, step = counted(np.maximum(sides - 2, 0))
    first = polygon[which, 0]
    frame = np.stack([first, polygon[which, step + 1] - first, polygon[which, step + 2] - first], axis=1)
    area = length(cross(frame[:, 1], frame[:, 2])) / 2
    solid = area > 0
    return which[solid], frame[solid], area[solid]
