"""Points: the places whose light is asked for.

Owns the making of points from the corners of meshes. Vertices, corners and texels are all points to the gather.
A point is one pair of vertex and normal: the corners of a vertex whose shading normals agree within a degree share it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .raycast import OFFSET
from .sampling import morton_order
from .scene import newell_normals
from .vectors import dot, unit

SAME_NORMAL = 0.99984769515639127  # cosine of one degree
INWARD = 1e-3  # how far a point moves from its vertex toward the middle of its faces
SHARPEST = 0.1  # least cosine between a point's normal and a face that it is lifted out of


@dataclass(frozen=True)
class Points:
    """P points, in Morton order, so that neighbors in the arrays are neighbors in space.

    position: (P, 3) float64, where rays start but for the offset along `geometric`. normal: (P, 3) unit shading
    normals, the axis of the hemisphere. geometric: (P, 3) unit normals of the surface; light from below it counts as
    none. area: (P,) [m^2]. object: (P,) int32. neighbor_start: (P + 1,) int32, neighbor: (E,) int32; the neighbors
    of point p, joined to it by a polygon's edge, are neighbor[neighbor_start[p] : neighbor_start[p + 1]].
    corner: (C,) int32 corners of the scene that are written. corner_point: (C,) int32 the point of each of them.
    """

    position: np.ndarray
    normal: np.ndarray
    geometric: np.ndarray
    area: np.ndarray
    object: np.ndarray
    neighbor_start: np.ndarray
    neighbor: np.ndarray
    corner: np.ndarray
    corner_point: np.ndarray

    def __len__(self):
        return len(self.area)


def make_points(scene, flipped=None):
    """The Points of all corners of the scene's written objects whose polygons have an area.

    flipped: (P,) bool, polygons whose back side's light is asked for.
    """
    size = np.diff(scene.polygon_start)
    polygon_area = np.bincount(
        scene.triangle_polygon[scene.usable], scene.triangle_normal_area[1][scene.usable], len(size)
    )
    wanted = scene.written[scene.polygon_object] & (polygon_area > 0)
    polygon = np.repeat(np.arange(len(size)), size)
    corner = np.flatnonzero(wanted[polygon])
    polygon = polygon[corner]
    vertex = scene.corner_vertex[corner]
    face_normal = newell_normals(scene.vertices, scene.polygon_start, scene.corner_vertex)
    normal = scene.corner_normal[corner]
    if flipped is not None and flipped.any():
        sign = np.where(flipped, -1.0, 1.0)[:, None]
        face_normal, normal = face_normal * sign, normal * sign[polygon]
    normal = unit(normal, face_normal[polygon])  # a custom normal may be 0 or NaN

    point = group_corners(vertex, normal)
    count = int(point.max(initial=-1)) + 1
    weight = polygon_area[polygon] / size[polygon]
    area = np.bincount(point, weight, count)
    first = np.zeros(count, np.int64)
    first[point[::-1]] = np.arange(len(corner))[::-1]
    normal = unit(_mean(normal, point, weight, count), normal[first])
    geometric = unit(_mean(face_normal[polygon], point, weight, count), face_normal[polygon[first]])
    position = _place(scene, vertex, polygon, point, first, geometric, face_normal)

    order = morton_order(position)
    rank = np.empty(count, np.int64)
    rank[order] = np.arange(count)
    neighbor_start, neighbor = _neighbors(scene, corner, polygon, rank[point], count)
    return Points(
        position=position[order],
        normal=normal[order],
        geometric=geometric[order],
        area=area[order],
        object=scene.polygon_object[polygon[first]][order],
        neighbor_start=neighbor_start,
        neighbor=neighbor,
        corner=corner.astype(np.int32),
        corner_point=rank[point].astype(np.int32),
    )


def group_corners(vertex, normal, agreement=SAME_NORMAL):
    """(C,) number of the (vertex, normal) pair of each corner: round by round, the first corner left at each vertex
    takes those whose normals' cosine to its own is at least `agreement`."""
    order = np.argsort(vertex, kind="stable")
    left, point, count = order, np.empty(len(vertex), np.int64), 0
    while len(left):
        leading = np.append(True, vertex[left][1:] != vertex[left][:-1])
        run = np.cumsum(leading) - 1
        leader = left[leading][run]
        near = dot(normal[left], normal[leader]) >= agreement
        near |= left == leader
        point[left[near]] = count + run[near]
        count += run[-1] + 1
        left = left[~near]
    return point


def _mean(values, owner, weight, count):
    """(count, 3) weighted means of rows (C, 3) by owner (C,)."""
    total = np.bincount(owner, weight, count)
    return np.stack([np.bincount(owner, weight * values[:, k], count) for k in range(3)], axis=1) / total[:, None]


def _place(scene, vertex, polygon, point, first, geometric, face_normal):
    """(P, 3) positions: a little inside the faces, and on top of each of them.

    The mean of the centers of faces that meet at an angle lies below them; the lift undoes that.
    """
    size = np.diff(scene.polygon_start)
    owner = np.repeat(np.arange(len(size)), size)
    center = _mean(scene.vertices[scene.corner_vertex], owner, np.ones(len(owner)), len(size))[polygon]
    count = len(first)
    start = scene.vertices[vertex[first]]
    move = INWARD * (_mean(center, point, np.ones(len(point)), count) - start)
    normal = face_normal[polygon]
    below = -dot(normal, move[point])
    lift = np.zeros(count)
    slope = np.maximum(dot(normal, geometric[point]), SHARPEST)
    np.maximum.at(lift, point, (below + OFFSET * scene.diagonal * (1 - slope)) / slope)
    return start + move + lift[:, None] * geometric


def _neighbors(scene, corner, polygon, point, count):
    """Where each point's neighbors start (P + 1,), and the neighbors (E,): points at the other ends of polygons' edges."""
    of_corner = np.full(len(scene.corner_vertex), -1, np.int64)
    of_corner[corner] = point
    last = corner == scene.polygon_start[1:][polygon] - 1
    following = of_corner[np.where(last, scene.polygon_start[:-1][polygon], corner + 1)]
    here, there = np.concatenate([point, following]), np.concatenate([following, point])
    apart = here != there
    key = np.unique(here[apart] * max(count, 1) + there[apart])
    here, there = np.divmod(key, max(count, 1))
    return np.searchsorted(here, np.arange(count + 1)).astype(np.int32), there.astype(np.int32)
