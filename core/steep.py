"""Steep light: surfaces so near to a source that what they get changes much within a patch, and patches that are finer
there, or cut.

Owns the choice of polygons whose patches are made finer. A glowing strip a hand's breadth before a wall lights a stripe of
it many times as brightly as the room: patches wider than the stripe would spread it, and what sees it from nearby would
get too little. Behind a panel that hangs close before a wall or ceiling the wall is bright, and hardly any of that light
comes out; a patch that is half behind it and half beside it would send it into the room. So patches are cut along its
outline.
"""

from __future__ import annotations

import numpy as np

from .crowd import make_crowd
from .cuts import cut_patches, elements_of
from .lights import BALL, FLAT
from .patches import CUTS, make_patches
from .patches import FLAT as EVEN
from .vectors import cross, dot, length, ratio

STEEP = 0.35  # change of light across a patch, in units of what patches get in the mean, from which on it is made finer
MATTERS = 0.15  # mean square of the change where it is steep: below that, patches stay as they are
MOST_CHANGE = 5.0  # that counts there: more of it is on a few patches, which little sees
AGAIN = 2.0  # times the light that sources give patches in the mean they get with what is reflected
FINEST = 0.2  # times as long are patches at the least
MOST_PAIRS = 1 << 24  # of a patch and a piece of a source that are looked at
MOST_MORE, TRIES = 2.0, 3  # times as many patches there may be, or they are made less fine, in so many steps at most,
SPARE = 1.1  # times less than their number calls for
CLOSE = 0.5  # of its size, and of the source's, a patch must be nearer to the source to be cut along its outline
APART = 1e-6  # of the source's size, at least: what lies in its plane gets nothing
LEVEL = 0.7  # least cosine between patch and source
INSIDE = 1e-6  # of a patch's size, its corners lie at least beyond an outline that cuts it


def make_fine_patches(scene, sources, edge, growth, longest=1.0):
    """The Patches of a scene, see `make_patches`, shorter where light of Sources falls off steeply, and cut along the
    outlines of those that are close before them; None: nowhere. longest: (P,) how many times `edge` those of each polygon
    may be long."""
    patches = _steep_patches(scene, sources, edge, growth, np.minimum(longest, 1.0))
    return patches if edge is None or sources is None else _cut_outlines(patches, sources)


def _cut_outlines(patches, sources):
    """Patches cut along the outlines of FLAT Sources that are close before them."""
    ids, flat = np.arange(len(patches)), np.flatnonzero(sources.kind == FLAT)
    if len(patches) * len(flat) > MOST_PAIRS:
        return patches
    for _ in range(CUTS):
        plane = np.zeros((len(ids), 4))
        for s in flat:
            _find_outline(patches, ids, sources, s, plane)
        crossed = plane.any(axis=1)
        if not crossed.any():
            break
        patches, ids = cut_patches(patches, ids[crossed], plane[crossed])
    return patches


def _find_outline(patches, ids, sources, s, plane):
    """Put into plane (K, 4), where that is 0, the plane that stands upright on source s along one of its edges, where it
    crosses patches ids (K,) that the source is close before."""
    facing, extent = sources.direction[s], np.sqrt(sources.areas[s])
    corners = sources.polygon(s)
    toward, size = patches.centroid[ids] - sources.position[s], np.sqrt(patches.area[ids])
    rise = dot(toward, facing)
    gap = np.abs(rise)
    reach = length(corners - sources.position[s]).max()
    close = (gap < CLOSE * np.minimum(size, extent)) & (gap > APART * extent) & (length(toward) < reach + 2 * size)
    close &= (patches.flatness[ids] >= EVEN) & (np.abs(dot(patches.normal[ids], facing)) > LEVEL)
    if not sources.two_sided[s]:
        close &= rise > 0
    close = np.flatnonzero(close & ~plane.any(axis=1))
    if not len(close):
        return
    owner, element = elements_of(patches, ids[close])
    p, a, b = np.moveaxis(patches.element_frame[element], 1, 0)
    far = p + np.where(patches.element_square[element][:, None], a + b, b)
    places = np.stack([p, p + a, p + b, far])
    free = np.ones(len(close), bool)
    for start, stop in zip(corners, np.roll(corners, -1, axis=0)):
        along = stop - start
        normal = cross(along, facing)
        if not min(length(normal), dot(along, along)) > 0:
            continue
        normal /= length(normal)
        value = dot(places - start, normal)
        share = dot(places - start, along) / dot(along, along)
        low, high = np.full((2, len(close)), np.inf), np.full((2, len(close)), -np.inf)
        for k, each in enumerate((value, share)):
            np.minimum.at(low[k], owner, each.min(axis=0))
            np.maximum.at(high[k], owner, each.max(axis=0))
        least = INSIDE * size[close]
        crossed = free & (low[0] < -least) & (high[0] > least) & (low[1] < 1.0) & (high[1] > 0.0)
        plane[close[crossed]] = (*normal, dot(normal, start))
        free &= ~crossed


def _steep_patches(scene, sources, edge, growth, longest):
    """The Patches of a scene, shorter where light of Sources falls off steeply; longest: of each polygon, see
    `make_fine_patches`."""
    patches = make_patches(scene, edge, growth)
    if np.any(longest < 1.0):
        patches = _finer_patches(scene, edge, growth, longest, patches)
    crowd = None
    if sources is not None:
        crowd = make_crowd(sources, sources.kind <= BALL, np.mean(scene.bounds, axis=0), scene.diagonal)
    if (
        edge is None
        or crowd is None
        or not 0 < len(patches) * len(crowd.members) <= MOST_PAIRS
        or not patches.area.any()
    ):
        return patches
    slope = np.zeros(len(patches))
    size = np.sqrt(patches.area)
    for sign in (1.0, -1.0):
        for k in range(0, len(patches), 4096):
            part = slice(k, k + 4096)
            found = crowd.slope(patches.centroid[part], sign * patches.normal[part], size[part])
            slope[part] = np.maximum(slope[part], found)
    mean = AGAIN * crowd.members.flux() / patches.area.sum()
    change = ratio(slope * np.minimum(size, edge), mean)
    wanted = np.clip(np.sqrt(ratio(STEEP, change)), FINEST, 1.0)
    wanted[change <= STEEP] = 1.0
    steep = np.minimum(np.where(change > STEEP, change, 0.0), MOST_CHANGE)
    if (patches.area * steep * steep).sum() < MATTERS * patches.area.sum():
        return patches
    finer = np.ones(len(scene.polygon_material))
    np.minimum.at(finer, patches.polygon, wanted)
    if (finer == 1.0).all():
        return patches
    return _finer_patches(scene, edge, growth, np.minimum(finer, longest), patches)


def _finer_patches(scene, edge, growth, finer, patches):
    """Patches so many times (P,) finer, or less so, that there are not too many more of them than patches; else these."""
    for _ in range(TRIES):
        fine = make_patches(scene, edge, growth, finer)
        more = (len(fine) - len(patches)) / ((MOST_MORE - 1.0) * len(patches))
        if more <= 1.0:
            return fine
        finer = np.minimum(SPARE * np.sqrt(more) * finer, 1.0)
    return patches
