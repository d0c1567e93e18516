"""Points: the places whose light is asked for.

Owns the making of points from the corners of meshes. Vertices, corners and texels are all points to the gather.
A point is one pair of vertex and normal: the corners of a vertex whose shading normals agree within a degree share it,
unless another surface stands between their faces: a wall on the line between two of a floor's quads parts them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .raycast import OFFSET
from .sampling import morton_order
from .vectors import counted, dot, length, unit

SAME_NORMAL = 0.99984769515639127  # cosine of one degree
INWARD = 1e-3  # how far a point moves from its vertex toward the middle of its faces
ACROSS = 2e-3  # how far beyond its vertex, and before it, surfaces that a point must stay clear of are looked for
BEFORE = 0.1  # where the search for the place before such a surface begins
CLEAR = 4 * OFFSET  # how far a point stays away from it, in scene diagonals
PARTINGS = 4  # points into which surfaces may part the corners of one, less one
LEVEL = 0.9510565162951535  # cosine of 18 degrees: faces that meet at more than that are not parted
TASK_SEGMENTS = 1 << 15
THIN = 1e-3  # a face less wide than this share of its length and of the scene's diagonal has no inside to stand on
BENT = 0.9  # least cosine between a face and the mean of those at its vertex, where there is no crease
SHARPEST = 0.1  # least cosine between a point's normal and a face that it is lifted out of


@dataclass(frozen=True)
class Points:
    """P points, in Morton order, so that neighbors in the arrays are neighbors in space.

    position: (P, 3) float64, where rays start but for the offset along `geometric`. normal: (P, 3) unit shading
    normals, the axis of the hemisphere. geometric: (P, 3) unit normals of the surface; light from below it counts as
    none. area: (P,) [m^2]. object: (P,) int32. smooth: (P,) bool, not on a crease or an open edge. neighbor_start: (P + 1,) int32, neighbor: (E,) int32; the neighbors
    of point p, joined to it by a polygon's edge, are neighbor[neighbor_start[p] : neighbor_start[p + 1]].
    corner: (C,) int32 corners of the scene that are written. corner_point: (C,) int32 the point of each of them.
    """

    position: np.ndarray
    normal: np.ndarray
    geometric: np.ndarray
    area: np.ndarray
    object: np.ndarray
    smooth: np.ndarray
    neighbor_start: np.ndarray
    neighbor: np.ndarray
    corner: np.ndarray
    corner_point: np.ndarray
    thin: np.ndarray

    def __len__(self):
        return len(self.area)


def make_points(scene, flipped=None, cells=None):
    """The Points of all corners of the scene's written objects whose polygons have an area.

    flipped: (P,) bool, polygons whose back side's light is asked for. cells: started with `kernel.scene_arrays`, to keep
    points clear of surfaces that pass through or beside their vertices; None leaves them where they are.
    """
    size = np.diff(scene.polygon_start)
    polygon_area = np.bincount(
        scene.triangle_polygon[scene.solid], scene.triangle_normal_area[1][scene.solid], len(size)
    )
    wanted = scene.written[scene.polygon_object] & (polygon_area > 0)
    polygon = np.repeat(np.arange(len(size)), size)
    corner = np.flatnonzero(wanted[polygon])
    polygon = polygon[corner]
    vertex = scene.corner_vertex[corner]
    face_normal = _face_normals(scene)
    normal = scene.corner_normal[corner]
    if flipped is not None and flipped.any():
        sign = np.where(flipped, -1.0, 1.0)[:, None]
        face_normal, normal = face_normal * sign, normal * sign[polygon]
    normal = unit(normal, face_normal[polygon])  # a custom normal may be 0 or NaN

    point = group_corners(vertex, normal)
    inner, width, stout = _insides(scene, corner)
    place, toward, facing = scene.vertices[vertex], inner - scene.vertices[vertex], face_normal[polygon]
    share = np.full(len(corner), INWARD)
    if cells is not None and len(corner):
        crossed, share = _clear_of_others(scene, cells, place, toward, facing)
        point = _part(scene, cells, point, crossed, place + share[:, None] * toward, facing)

    count = int(point.max(initial=-1)) + 1
    weight = polygon_area[polygon] / size[polygon]
    area = np.bincount(point, weight, count)
    first = np.zeros(count, np.int64)
    first[point[::-1]] = np.arange(len(corner))[::-1]
    normal = unit(_mean(normal, point, weight, count), normal[first])
    geometric = unit(_mean(facing, point, weight, count), facing[first])
    move = _mean(share[:, None] * toward, point, np.maximum(width, 1e-300), count)
    position = place[first] + move + _lift(scene, move, point, geometric, facing)
    thin = np.ones(count, bool)
    thin[point[stout]] = False

    order = morton_order(position)
    rank = np.empty(count, np.int64)
    rank[order] = np.arange(count)
    neighbor_start, neighbor = _neighbors(scene, corner, rank[point], count)
    return Points(
        position=position[order],
        normal=normal[order],
        geometric=geometric[order],
        area=area[order],
        object=scene.polygon_object[polygon[first]][order],
        smooth=_smooth(scene, face_normal)[vertex[first]][order],
        neighbor_start=neighbor_start,
        neighbor=neighbor,
        corner=corner.astype(np.int32),
        corner_point=rank[point].astype(np.int32),
        thin=thin[order],
    )


def pairs(points, ids):
    """Points ids (K,), as rows 0 to K - 1, repeated, and their neighbors: two (E,) arrays."""
    here, number = counted((points.neighbor_start[ids + 1] - points.neighbor_start[ids]).astype(np.int64))
    return here, points.neighbor[points.neighbor_start[ids][here] + number]


def _face_normals(scene):
    """(P,) unit normals of polygons; that of its largest triangle for one that turns against itself, as a bow tie does."""
    normal = scene.polygon_normal
    own, area = scene.triangle_normal_area
    order = np.argsort(area, kind="stable")
    largest = np.zeros_like(normal)
    largest[scene.triangle_polygon[order]] = own[order]
    return np.where((dot(normal, largest) > 0.5)[:, None], normal, largest)


def _insides(scene, corner):
    """A place inside the polygon of each corner (K,), near it whatever the polygon's shape: the middle of the triangles
    that meet there, (K, 3); the width of the widest of them, (K,) [m]; and whether one is wide enough to stand on, (K,)."""
    solid = np.flatnonzero(scene.solid)
    a, b, c = np.moveaxis(scene.vertices[scene.triangles[solid]], 1, 0)
    longest = np.maximum(np.maximum(length(b - a), length(c - b)), length(a - c))
    wide = 2 * scene.triangle_normal_area[1][solid] / longest
    width, stout = np.zeros(len(scene.corner_vertex)), np.zeros(len(scene.corner_vertex), bool)
    at = scene.triangle_corner[solid]
    np.maximum.at(width, at.reshape(-1), np.repeat(wide, 3))
    stout[at[wide > THIN * np.minimum(longest, scene.diagonal)].reshape(-1)] = True
    count = np.bincount(at.reshape(-1), minlength=len(width))
    middle = _mean(np.repeat((a + b + c) / 3, 3, axis=0), at.reshape(-1), np.ones(at.size), len(width), at_least=1)
    # A corner without a triangle, where the polygon has no area: its vertex.
    return (
        np.where(count[:, None] > 0, middle, scene.vertices[scene.corner_vertex])[corner],
        width[corner],
        stout[corner],
    )


def _clear_of_others(scene, cells, place, toward, facing):
    """Which corners have a surface close before or beyond their vertex, (C,) bool; and how far each point should move
    from it toward the inside of its face, (C,) as a share of the way."""
    share = np.full(len(place), INWARD)
    ask = lambda a, b, up, name: ask_segments(cells, name, a, b, up, up)
    ways = (place + ACROSS * toward, place - ACROSS * toward)
    crossed = ask(*ways, facing, "blocked")
    near = np.flatnonzero(crossed)
    if len(near):
        begin = BEFORE
        start, stop = place[near] + begin * toward[near], place[near] - ACROSS * toward[near]
        reach = ask(start, stop, facing[near], "reach")
        met = begin - (begin + ACROSS) * reach  # where along the way, 0 at the vertex
        gap = CLEAR * scene.diagonal / np.maximum(length(toward[near]), 1e-300)
        share[near] = np.clip(met + gap, INWARD, np.maximum((met + begin) / 2, INWARD))
    return crossed, share


def _part(scene, cells, point, crossed, place, facing):
    """The number (C,) of each corner's point, where those that a surface parts from the first one get another."""
    touched = np.zeros(int(point.max(initial=-1)) + 1, bool)
    touched[point[crossed]] = True
    left = np.flatnonzero(touched[point])
    left = left[np.argsort(point[left], kind="stable")]
    point = point.copy()
    for _ in range(PARTINGS):
        if not len(left):
            break
        leading = np.append(True, point[left][1:] != point[left][:-1])
        leader = left[leading][np.cumsum(leading) - 1]
        other = np.flatnonzero(~leading & (dot(facing[left], facing[leader]) > LEVEL))
        a, b = leader[other], left[other]
        apart = ask_segments(cells, "blocked", place[a], place[b], facing[a], facing[b])
        parted = left[other][apart]
        _, number = np.unique(point[parted], return_inverse=True)
        point[parted] = point.max() + 1 + number.reshape(-1)
        left = parted
    return point


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


def ask_segments(cells, name, start, stop, up, stop_up):
    """(K,) what a task says of segments between places (K, 3), each just above a surface with a normal (K, 3)."""
    parts = [slice(k, k + TASK_SEGMENTS) for k in range(0, len(start), TASK_SEGMENTS)]
    tasks = [
        cells.submit(name, start=start[part], stop=stop[part], up=up[part], stop_up=stop_up[part]) for part in parts
    ]
    found = cells.take(tasks)
    return np.concatenate([result[name] for result in found]) if found else np.zeros(0, bool)


def _mean(values, owner, weight, count, at_least=0.0):
    """(count, 3) weighted means of rows (C, 3) by owner (C,)."""
    total = np.maximum(np.bincount(owner, weight, count), at_least)
    return np.stack([np.bincount(owner, weight * values[:, k], count) for k in range(3)], axis=1) / total[:, None]


def _lift(scene, move, point, geometric, facing):
    """(P, 3) what puts points on top of each of their faces.

    The mean of places inside faces that meet at an angle lies below them; the lift undoes that.
    """
    below = -dot(facing, move[point])
    lift = np.zeros(len(move))
    slope = np.maximum(dot(facing, geometric[point]), SHARPEST)
    np.maximum.at(lift, point, (below + OFFSET * scene.diagonal * (1 - slope)) / slope)
    return lift[:, None] * geometric


def _smooth(scene, face_normal):
    """(V,) bool: vertices whose faces bend little, and all of whose edges have a face on either side."""
    count, vertex = len(scene.vertices), scene.corner_vertex
    polygon = np.repeat(np.arange(len(face_normal)), np.diff(scene.polygon_start))
    normal = face_normal[polygon]
    mean = unit(np.stack([np.bincount(vertex, normal[:, k], count) for k in range(3)], axis=1))
    flat = np.ones(count, bool)
    flat[vertex[dot(normal, mean[vertex]) < BENT]] = False
    following = vertex[_following(scene.polygon_start)]
    edge = np.minimum(vertex, following) * np.int64(count) + np.maximum(vertex, following)
    _, place, uses = np.unique(edge, return_index=True, return_counts=True)
    rim = place[uses == 1]
    flat[vertex[rim]] = flat[following[rim]] = False
    return flat


def _following(polygon_start):
    """(C,) the corner that follows each corner in its polygon."""
    following = np.arange(1, polygon_start[-1] + 1)
    full = polygon_start[1:] > polygon_start[:-1]
    following[polygon_start[1:][full] - 1] = polygon_start[:-1][full]
    return following


def _neighbors(scene, corner, point, count):
    """Where each point's neighbors start (P + 1,), and the neighbors (E,): points at the other ends of polygons' edges."""
    of_corner = np.full(len(scene.corner_vertex), -1, np.int64)
    of_corner[corner] = point
    following = of_corner[_following(scene.polygon_start)[corner]]
    here, there = np.concatenate([point, following]), np.concatenate([following, point])
    apart = here != there
    key = np.unique(here[apart] * max(count, 1) + there[apart])
    here, there = np.divmod(key, max(count, 1))
    return np.searchsorted(here, np.arange(count + 1)).astype(np.int32), there.astype(np.int32)
