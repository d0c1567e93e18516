"""Faces whose light varies over them, as screens and lampshades have it, or that are there in part: as sources.

Owns the choice of them and the sources that stand for them: the elements of their patches, each with its mean light.
"""

from __future__ import annotations

import numpy as np

from .lights import MOST_FLATS, emitting_polygons, flat_sources, join_sources
from .surfaces import make_surfaces


def add_pictures(scene, patches, sources, sampled):
    """Sources and the polygons (P,) bool that they stand for, with those of the faces whose light `make_sources` leaves
    out because it is not even, unless these are too many: then rays find them."""
    uneven = np.setdiff1d(emitting_polygons(scene), np.flatnonzero(sampled))
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
