"""Meshes made out of others: where each part of them comes from.

A corner of the new mesh lies in a triangle of three corners of the old one, at some weights; that says what becomes of
everything that vertices and corners carry.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Remesh:
    """P polygons with C corners that cover polygons of a scene, sorted by them.

    polygon_start: (P + 1,) int64. polygon_source: (P,) the scene's polygon that each lies in. corner_vertex: (C,)
    numbers of vertices. corner_source: (C, 3) corners of the scene, of one of its polygons, and corner_weight: (C, 3)
    how much of each; corners of one vertex lie at one place.
    """

    polygon_start: np.ndarray
    polygon_source: np.ndarray
    corner_vertex: np.ndarray
    corner_source: np.ndarray
    corner_weight: np.ndarray

    def part(self, first, last, backward=False):
        """The polygons whose sources are first to last (less one), with vertices counted from 0 in their old order, and
        the corners (K,) of this Remesh that theirs are. backward: every polygon runs the other way."""
        low, high = np.searchsorted(self.polygon_source, [first, last])
        corner = np.arange(self.polygon_start[low], self.polygon_start[high])
        start = self.polygon_start[low : high + 1] - self.polygon_start[low]
        if backward:
            corner = np.repeat(start[:-1] + start[1:] - 1, np.diff(start)) - np.arange(len(corner)) + corner[:1]
        _, vertex = np.unique(self.corner_vertex[corner], return_inverse=True)
        of_part = (
            self.polygon_source[low:high],
            vertex.reshape(-1),
            self.corner_source[corner],
            self.corner_weight[corner],
        )
        return Remesh(start, *of_part), corner


def triangulated(scene):
    """The Remesh of a scene's triangles, each a polygon of its own."""
    order = np.argsort(scene.triangle_polygon, kind="stable")
    corner = scene.triangle_corner[order].reshape(-1)
    return Remesh(
        polygon_start=3 * np.arange(len(order) + 1),
        polygon_source=scene.triangle_polygon[order].astype(np.int64),
        corner_vertex=scene.corner_vertex[corner].astype(np.int64),
        corner_source=np.repeat(corner[:, None], 3, axis=1),
        corner_weight=np.tile([1.0, 0.0, 0.0], (len(corner), 1)),
    )
