"""Cuts: patches cut by planes along which light changes at once.

Owns the pieces of patches, and the records by which a hit finds its piece.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .patches import CUTS, join_elements
from .polygons import clip_polygons
from .vectors import counted, cross, length

LEAST = 1e-3  # share of a patch that is worth a cut


def cut_patches(patches, ids, plane):
    """Patches with those of ids (K,) cut by planes (K, 4), each a normal and an offset along it, and the ids of what may be
    cut again: the pieces, and patches that share a record with one of them."""
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
    owner, element = elements_of(patches, ids)
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
        np.concatenate([elements_of(patches, np.arange(len(patches)))[0][stays], ids[kept[0][0]], piece[kept[1][0]]]),
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


def elements_of(patches, ids):
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
