"""Pieces of surface: polygons that touch at corners, by position, whether or not they share vertices."""

from __future__ import annotations

import numpy as np

from .flats import emitting_polygons
from .graphs import components
from .scene import following_corners
from .vectors import cross, dot

WELD = 1e-6  # of the scene's diagonal: positions closer than this are the same
MOST_TRIANGLES = 300_000  # that are sorted into pieces by their corners; in larger scenes each object is a piece


def pieces_of(scene):
    """(P,) number of the piece of surface that each polygon belongs to: polygons that touch at corners, by position."""
    if len(scene.triangles) > MOST_TRIANGLES or not scene.usable.any():
        return scene.polygon_object.astype(np.int64)
    vertex = welded(scene)
    size = np.diff(scene.polygon_start)
    corner = vertex[scene.corner_vertex]
    polygon = np.repeat(np.arange(len(size), dtype=np.int32), size)
    count = int(vertex.max()) + 1
    label = components(corner, count + polygon, count + len(size))[count:]
    return np.unique(label, return_inverse=True)[1].reshape(-1)


def welded(scene):
    """(V,) int32 number of the place that each vertex lies at: those closer than `WELD` share one."""
    step = WELD * max(scene.diagonal, 1e-300)
    with np.errstate(invalid="ignore", over="ignore"):
        place = np.clip(np.nan_to_num((scene.vertices - scene.bounds[0]) / step), -1, (1 << 21) - 2) + 1.5
    x, y, z = place.astype(np.int64).T
    return np.unique((x << 42) | (y << 21) | z, return_inverse=True)[1].reshape(-1).astype(np.int32)


def shut_in(scene, island):
    """(P,) bool: emitting polygons of closed surfaces, as lamps are made of, whose backs see nothing but the inside of
    these. island: see Survey."""
    shut, emitting = np.zeros(len(scene.polygon_material), bool), emitting_polygons(scene)
    if not len(emitting):
        return shut
    piece = pieces_of(scene)
    nodes = np.zeros((int(piece.max()) + 1, 2), np.int64)
    nodes[piece] = island
    alone = np.bincount(nodes.reshape(-1))[nodes[:, 1]] == 1
    alone[piece[scene.left_out | scene.double]] = False
    alone &= np.isin(np.arange(len(alone)), piece[emitting])
    # Closed: each edge is gone along as often in one direction as in the other; and turned outward.
    corner = np.flatnonzero(alone[np.repeat(piece, np.diff(scene.polygon_start))])
    owner = np.repeat(piece, np.diff(scene.polygon_start))[corner]
    vertex = welded(scene)
    here, there = (vertex[scene.corner_vertex[c]] for c in (corner, following_corners(scene.polygon_start)[corner]))
    low, high = np.minimum(here, there).astype(np.int64), np.maximum(here, there)
    _, edge = np.unique((low << 32) | high, return_inverse=True)
    once = np.bincount(edge.reshape(-1), np.sign(there - here)) != 0
    alone[owner[once[edge.reshape(-1)]]] = False
    own = piece[scene.triangle_polygon]
    a, b, c = np.moveaxis(scene.vertices[scene.triangles] - scene.bounds[0], 1, 0)
    volume = np.bincount(own, np.where(alone[own], dot(a, cross(b, c)), 0.0), len(alone))
    return (alone & (volume > 0))[piece]
