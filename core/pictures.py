"""Faces whose light varies over them, as screens and lampshades have it, or that are there in part: as sources.

Owns the choice of them, how fine their patches are, and the sources that stand for them: the elements of these patches,
each with its mean light.
"""

from __future__ import annotations

import numpy as np

from .flats import MOST_FLATS, emitting_polygons, folded_polygons
from .lights import flat_sources, join_sources
from .share import face_rays
from .surfaces import make_surfaces
from .vectors import counted

RAYS = 1 << 14  # in all from each side of such faces, that look for what is near them,
LEAST_RAYS = 4  # and from each triangle
NEAR = 0.2  # of the rays from a side of a face meet what is near it
LONGEST = 0.5  # of the distance to what is near, its patches are at most long,
FINEST = 0.02  # and so many times as long as others at the least


def near_pictures(scene, sampled, edge, cells):
    """(P,) how many times `edge` [m] patches of polygons may be long: where a face whose light is not even is close before
    a surface, this sees the light of each part by itself. sampled: (P,) bool, those whose light is even. cells: started with
    the arrays that rays need."""
    longest = np.ones(len(scene.polygon_material))
    uneven = _left_out(scene, sampled)
    if not len(uneven):
        return longest
    triangle = np.flatnonzero(scene.usable & np.isin(scene.triangle_polygon, uneven))
    if not 0 < LEAST_RAYS * len(triangle) <= RAYS:  # of more triangles, each is small
        return longest
    owner, number = counted(np.full(len(triangle), RAYS // len(triangle)))
    polygon = scene.triangle_polygon[triangle[owner]]
    for side in (0, 1):
        position, normal, direction = face_rays(scene, triangle[owner], number, side)
        (hit,) = cells.take([cells.submit("cast", position=position, normal=normal, direction=direction)])
        distance = np.where(hit["triangle"] >= 0, scene.diagonal * hit["distance"].astype(float), np.inf)
        order = np.lexsort((distance, polygon))
        first = np.flatnonzero(np.diff(polygon[order], prepend=-1))
        size = np.diff(np.append(first, len(order)))
        near = distance[order[first + (NEAR * size).astype(np.int64)]]
        longest[polygon[order[first]]] = np.minimum(longest[polygon[order[first]]], LONGEST * near / edge)
    return np.maximum(longest, FINEST)


def _left_out(scene, sampled):
    """(K,) emitting polygons that are not among those for which sources stand, sampled: (P,) bool."""
    emitting = emitting_polygons(scene)
    return emitting[~sampled[emitting]]


def add_pictures(scene, patches, sources, sampled):
    """Sources and the polygons (P,) bool that they stand for, with those of the faces whose light `make_sources` leaves
    out because it is not even, unless these are too many: then rays find them."""
    uneven = _left_out(scene, sampled)
    if not len(uneven):
        return sources, sampled
    uneven = uneven[~folded_polygons(scene)[uneven]]
    own = np.isin(patches.polygon, uneven)
    if not own.any():
        return sources, sampled
    surfaces = make_surfaces(scene, patches, sampled)
    light = surfaces.found if surfaces.coverage is None else surfaces.found * surfaces.coverage
    light = light[:, ::2].T  # both sides give the same
    own &= light.max(axis=1) > 0
    element = np.flatnonzero(np.repeat(own, np.diff(patches.element_start)))
    if len(element) + len(sources) > MOST_FLATS:
        return sources, sampled
    patch = np.repeat(np.arange(len(patches)), np.diff(patches.element_start))[element]
    p, a, b = np.moveaxis(patches.element_frame[element], 1, 0)
    square = patches.element_square[element]
    corner = np.stack([p, p + a, np.where(square[:, None], p + a + b, p + b), p + b], axis=1)
    kept = np.ones((len(element), 4), bool)
    kept[:, 3] = square
    flats = flat_sources(corner[kept], kept.sum(axis=1), light[patch], scene.polygon_object[patches.polygon[patch]])
    return join_sources([sources, flats]), sampled | np.isin(np.arange(len(sampled)), uneven)
