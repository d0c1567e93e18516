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
from .scene import following_corners
from .touching import SINK, find_touching
from .vectors import by_coordinate, counted, dot, length, rows_of, runs, unit

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
    none. area: (P,) [m^2]. object: (P,) int32. smooth: (P,) bool, not on a crease or an open edge. neighbor_start: (P +
    1,) int32, neighbor: (E,) int32; the neighbors of point p, joined to it by a polygon's edge, are
    neighbor[neighbor_start[p] : neighbor_start[p + 1]]. corner: (C,) int32 corners of the scene that are written.
    corner_point: (C,) int32 the point of each of them.
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
        return len(self.position)


def make_points(scene, flipped=None, cells=None):
    """The Points of all corners of the scene's written objects whose polygons have an area.

    flipped: (P,) bool, polygons whose back side's light is asked for. cells: started with `kernel.scene_arrays`, to keep
    points clear of surfaces that pass through or beside their vertices; None leaves them where they are.
    """
    corners = _Corners(scene, flipped)
    point, sunk = group_corners(corners.vertex, corners.normals(slice(None))), np.zeros(0, np.int64)
    size = np.diff(scene.polygon_start)
    move, width, stout, crossed = _moves(scene, corners, cells)
    if cells is not None and len(point):
        point = _part(scene, cells, corners, point, crossed, move)
        point, sunk = _apart(point, _touching(scene, flipped, cells, corners, move))
    del crossed

    count = int(point.max(initial=-1)) + 1
    weight = (corners.polygon_area / np.maximum(size, 1))[corners.polygon]
    area = np.bincount(point, weight, count)
    first = np.zeros(count, np.int32)
    first[point[::-1]] = np.arange(len(point), dtype=np.int32)[::-1]
    normal = _mean(corners.normals(slice(None)), point, weight, count)
    normal = unit(normal, corners.normals(first))
    facing = corners.face_normal
    geometric = np.stack(
        [np.bincount(point, weight * np.take(facing[:, k], corners.polygon), count) / area for k in range(3)], axis=1
    )
    geometric = unit(geometric, corners.facing(first))
    del weight
    move = scene.diagonal * _mean(move, point, np.maximum(width, 1e-30), count)
    del width
    position = rows_of(scene.vertices, corners.vertex[first]) + move
    position += _lift(scene, corners, move, point, geometric)
    position[sunk] -= SINK * scene.diagonal * geometric[sunk]
    thin = np.ones(count, bool)
    thin[point[stout]] = False
    smooth = smooth_vertices(scene, facing)[corners.vertex[first]]
    object = scene.polygon_object[corners.polygon[first]]
    corner = corners.corner
    del corners, facing, move, stout, first

    order = morton_order(position)
    rank = np.empty(count, np.int32)
    rank[order] = np.arange(count, dtype=np.int32)
    point = rank[point]
    neighbor_start, neighbor = _neighbors(scene, corner, point, count)
    return Points(
        position=rows_of(position, order),
        normal=rows_of(normal, order),
        geometric=rows_of(geometric, order),
        area=area[order],
        object=object[order],
        smooth=smooth[order],
        neighbor_start=neighbor_start,
        neighbor=neighbor,
        corner=corner,
        corner_point=point,
        thin=thin[order],
    )


@dataclass(frozen=True)
class Block:
    """K points and, behind them, those of their neighbors that are not among them: N in all, as they travel with a task.

    ids: (N,) int32 their numbers among all points, the first K in order. size: (K,) float32 square root of the area [m].
    position, normal, geometric: (N, 3), see Points; geometric is empty where it is the normal. degree: (K,) int32 number
    of the neighbors of each; neighbor: (E,) int32 which of the N they are, one point's after the other's.
    """

    ids: np.ndarray
    size: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    geometric: np.ndarray
    degree: np.ndarray
    neighbor: np.ndarray

    def __post_init__(self):
        if not len(self.geometric):
            object.__setattr__(self, "geometric", self.normal)

    def __len__(self):
        return len(self.degree)

    @property
    def level(self):
        """Whether the hemispheres of all of its points lie on the surface itself."""
        return self.geometric is self.normal

    @property
    def edges(self):
        """Its points (E,), repeated, and their neighbors (E,), as numbers from 0 to N - 1."""
        return np.repeat(np.arange(len(self)), self.degree), self.neighbor


def block_arrays(points, own, joined=True):
    """{name: array} of the Block of points own (K,), which are sorted. joined: with their neighbors, or without any."""
    ids, degree, there = own, np.zeros(len(own), np.int32), np.zeros(0, np.int32)
    if joined:
        start = points.neighbor_start
        if len(own) and own[-1] - own[0] == len(own) - 1:  # all in a row, as most are
            degree = np.diff(start[own[0] : own[-1] + 2])
            neighbor = points.neighbor[start[own[0]] : start[own[-1] + 1]]
            there = neighbor - own[0]
            outside = (there < 0) | (there >= len(own))
        else:
            degree, neighbor = start[own + 1] - start[own], pairs(points, own)[1]
            there = np.searchsorted(own, neighbor).astype(np.int32)
            outside = np.append(own, -1)[there] != neighbor
        more, number = np.unique(neighbor[outside], return_inverse=True)
        there[outside] = len(own) + number.reshape(-1)
        ids = np.concatenate([own, more])
    position, normal, geometric = (np.take(x, ids, axis=0) for x in (points.position, points.normal, points.geometric))
    return dict(
        ids=ids.astype(np.int32), size=np.sqrt(points.area[own]).astype(np.float32), position=position, normal=normal,
        geometric=geometric[: 0 if (geometric == normal).all() else None],
        degree=degree, neighbor=there,
    )  # fmt: skip


class _Corners:
    """The C corners of a scene that are written, of polygons that have an area: corner, vertex and polygon (C,) int32
    of each; wanted (P,) bool, face_normal (P, 3) and polygon_area (P,) of all polygons. flipped: see `make_points`."""

    def __init__(self, scene, flipped):
        solid, size = scene.solid, np.diff(scene.polygon_start)
        self.polygon_area = np.bincount(scene.triangle_polygon[solid], scene.triangle_normal_area[1][solid], len(size))
        self.wanted = wanted = scene.written[scene.polygon_object] & (self.polygon_area > 0)
        polygon = np.repeat(np.arange(len(size), dtype=np.int32), size)
        self.corner = np.flatnonzero(wanted[polygon]).astype(np.int32)
        self.polygon = polygon[self.corner]
        self.vertex = scene.corner_vertex[self.corner]
        self.face_normal, self._normal = face_normals(scene), scene.corner_normal
        self._flipped = flipped if flipped is not None and flipped.any() else None
        if self._flipped is not None:
            self.face_normal = np.where(flipped[:, None], -self.face_normal, self.face_normal)

    def facing(self, own):
        """(K, 3) unit normals of the faces of some of the corners."""
        return rows_of(self.face_normal, self.polygon[own])

    def normals(self, own):
        """(K, 3) unit shading normals of some of the corners."""
        normal, polygon = np.empty((len(self.corner[own]), 3)), self.polygon[own]
        corner = self.corner[own]
        for part in runs(len(normal)):
            shading = by_coordinate(rows_of(self._normal, corner[part]))
            if self._flipped is not None:
                shading = np.where(self._flipped[polygon[part], None], -shading, shading)
            normal[part] = unit(shading, rows_of(self.face_normal, polygon[part]))  # a custom normal may be 0 or NaN
        return normal


def pairs(points, ids):
    """Points ids (K,), as rows 0 to K - 1, repeated, and their neighbors: two (E,) arrays."""
    here, number = counted((points.neighbor_start[ids + 1] - points.neighbor_start[ids]).astype(np.int64))
    return here, points.neighbor[points.neighbor_start[ids][here] + number]


def face_normals(scene):
    """(P,) unit normals of polygons; that of its largest triangle for one that turns against itself, as a bow tie does."""
    normal = scene.polygon_normal
    own, area = scene.triangle_normal_area
    order = np.argsort(area, kind="stable")
    largest = np.zeros_like(normal)
    largest[scene.triangle_polygon[order]] = own[order]
    return np.where((dot(normal, largest) > 0.5)[:, None], normal, largest)


def _insides(scene, triangle, corner):
    """A place inside the polygon of each corner (K,), in order, near it whatever the polygon's shape: the middle of the
    triangles (T,) that meet there, (K, 3); the width of the widest of them, (K,) [m]; and whether one is wide enough to
    stand on, (K,)."""
    at, (a, b, c) = rows_of(scene.triangle_corner, triangle), scene.corners_of(triangle)
    longest = np.maximum(np.maximum(length(b - a), length(c - b)), length(a - c))
    wide = 2 * scene.triangle_normal_area[1][triangle] / longest
    at, count = np.searchsorted(corner, at).reshape(-1), len(corner)
    width, stout = np.zeros(count), np.zeros(count, bool)
    np.maximum.at(width, at, np.repeat(wide, 3))
    stout[at[np.repeat(wide > THIN * np.minimum(longest, scene.diagonal), 3)]] = True
    middle = _mean(np.repeat((a + b + c) / 3, 3, axis=0), at, np.ones(len(at)), count, at_least=1)
    # A corner without a triangle, where the polygon has no area: its vertex.
    there = np.bincount(at, minlength=count) > 0
    return np.where(there[:, None], middle, rows_of(scene.vertices, scene.corner_vertex[corner])), width, stout


def _moves(scene, corners, cells):
    """Of each corner (C,) how far its point should move from its vertex toward the inside of its face, (C, 3) float32; the
    width of its face there, (C,) float32, both in scene diagonals; whether that is wide enough to stand on, (C,); and
    whether a surface is close before or beyond the vertex, (C,). cells: None looks for no surfaces."""
    count, scale = len(corners.corner), max(scene.diagonal, 1e-300)
    toward, width = np.empty((count, 3), np.float32), np.empty(count, np.float32)
    stout, crossed = np.zeros((2, count), bool)
    order = np.argsort(scene.triangle_polygon, kind="stable")
    solid = scene.solid & corners.wanted[scene.triangle_polygon]
    parts = _whole_polygons(corners.polygon)
    bounds = [corners.polygon[part.start] for part in parts] + [len(scene.polygon_start)]
    first = np.searchsorted(scene.triangle_polygon, bounds, sorter=order)

    def segments():
        """Where surfaces are looked for, a task for each block of corners."""
        for part, *triangles in zip(parts, first[:-1], first[1:]):
            corner = corners.corner[part]
            triangle = order[slice(*triangles)]
            triangle = triangle[solid[triangle]]
            inner, wide, stout[part] = _insides(scene, triangle, corner)
            place = rows_of(scene.vertices, corners.vertex[part])
            way = inner - place
            toward[part], width[part] = way / scale, wide / scale
            up = corners.facing(part)
            yield dict(start=place + ACROSS * way, stop=place - ACROSS * way, up=up, stop_up=up)

    if cells is None:
        for _ in segments():
            pass
    else:
        for part, found in zip(parts, cells.flow("blocked", segments())):
            crossed[part] = found["blocked"]
    near = np.flatnonzero(crossed)
    if len(near):
        way, place, up = scale * toward[near].astype(float), scene.vertices[corners.vertex[near]], corners.facing(near)
        reach = ask_segments(cells, "reach", place + BEFORE * way, place - ACROSS * way, up, up)
        met = BEFORE - (BEFORE + ACROSS) * reach  # where along the way, 0 at the vertex
        gap = CLEAR * scene.diagonal / np.maximum(length(way), 1e-300)
        share = np.clip(met + gap, INWARD, np.maximum((met + BEFORE) / 2, INWARD))
        toward[near] = share[:, None] / INWARD * way / scale
    toward *= INWARD
    return toward, width, stout, crossed


def _part(scene, cells, corners, point, crossed, move):
    """The number (C,) of each corner's point, where those that a surface parts from the first one get another."""
    touched = np.zeros(int(point.max(initial=-1)) + 1, bool)
    touched[point[crossed]] = True
    left = np.flatnonzero(touched[point])
    left = left[np.argsort(point[left], kind="stable")]
    for _ in range(PARTINGS):
        if not len(left):
            break
        leading = np.append(True, point[left][1:] != point[left][:-1])
        leader = left[leading][np.cumsum(leading) - 1]
        other = np.flatnonzero(~leading & (dot(corners.facing(left), corners.facing(leader)) > LEVEL))
        ends = leader[other], left[other]
        places = (scene.vertices[corners.vertex[rows]] + scene.diagonal * move[rows] for rows in ends)
        apart = ask_segments(cells, "blocked", *places, *(corners.facing(rows) for rows in ends))
        parted = left[other][apart]
        _, number = np.unique(point[parted], return_inverse=True)
        point[parted] = point.max() + 1 + number.reshape(-1)
        left = parted
    return point


def _touching(scene, flipped, cells, corners, move):
    """(C,) bool: corners on fronts of faces against which another face lies, see `touching`."""
    place = rows_of(scene.vertices, corners.vertex)
    place += scene.diagonal * move
    return find_touching(scene, flipped, cells, corners.polygon, place, corners.facing(slice(None)))


def _apart(point, chosen):
    """The number (C,) of each corner's point, where chosen ones (C,) have others than those that are not, and the numbers
    of theirs."""
    if not chosen.any():
        return point, np.zeros(0, np.int64)
    number, point = np.unique(2 * point.astype(np.int64) + chosen, return_inverse=True)
    return point.reshape(-1).astype(np.int32), np.flatnonzero(number % 2)


def group_corners(vertex, normal, agreement=SAME_NORMAL):
    """(C,) number of the (vertex, normal) pair of each corner: round by round, the first corner left at each vertex
    takes those whose normals' cosine to its own is at least `agreement`."""
    left, point, count = np.argsort(vertex, kind="stable").astype(np.int32), np.empty(len(vertex), np.int32), 0
    while len(left):
        leading = np.append(True, vertex[left][1:] != vertex[left][:-1])
        run = np.cumsum(leading, dtype=np.int32) - 1
        leader = left[leading]
        near = np.empty(len(left), bool)
        for part in runs(len(left)):
            first = leader[run[part]]
            near[part] = dot(rows_of(normal, left[part]), rows_of(normal, first)) >= agreement
            near[part] |= left[part] == first
        point[left[near]] = count + run[near]
        count += run[-1] + 1
        left = left[~near]
    return point


def _whole_polygons(polygon):
    """Slices that cut corners, of polygons (C,) in order, into blocks of whole polygons, each for a task."""
    start = np.unique(np.searchsorted(polygon, polygon[::TASK_SEGMENTS]))
    return [slice(a, b) for a, b in zip(start, [*start[1:], len(polygon)])]


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


def _lift(scene, corners, move, point, geometric):
    """(P, 3) what puts points on top of each of their faces.

    The mean of places inside faces that meet at an angle lies below them; the lift undoes that.
    """
    lift = np.zeros(len(move))
    for part in runs(len(point)):
        facing, own = corners.facing(part), point[part]
        slope = np.maximum(dot(facing, geometric[own]), SHARPEST)
        np.maximum.at(lift, own, (OFFSET * scene.diagonal * (1 - slope) - dot(facing, move[own])) / slope)
    return lift[:, None] * geometric


def smooth_vertices(scene, face_normal):
    """(V,) bool: vertices whose faces bend little, and all of whose edges have a face on either side. face_normal: (P, 3)
    of polygons."""
    count, vertex = len(scene.vertices), scene.corner_vertex
    polygon = np.repeat(np.arange(len(face_normal), dtype=np.int32), np.diff(scene.polygon_start))
    mean = (np.bincount(vertex, np.take(face_normal[:, k], polygon), count) for k in range(3))
    mean = unit(np.stack(list(mean), axis=1))
    flat = np.ones(count, bool)
    for part in runs(len(vertex)):
        own = vertex[part]
        flat[own[dot(rows_of(face_normal, polygon[part]), rows_of(mean, own)) < BENT]] = False
    del polygon, mean
    following = vertex[following_corners(scene.polygon_start)]
    edge = np.minimum(vertex, following).astype(np.int64) * count + np.maximum(vertex, following)
    edge.sort()
    fresh = np.append(True, edge[1:] != edge[:-1])
    once = fresh[: len(edge)] & np.append(fresh[1:], True)[: len(edge)]
    for end in np.divmod(edge[once], max(count, 1)):
        flat[end] = False
    return flat


def _neighbors(scene, corner, point, count):
    """Where each point's neighbors start (P + 1,), and the neighbors (E,): points at the other ends of polygons' edges."""
    of_corner = np.full(len(scene.corner_vertex), -1, np.int32)
    of_corner[corner] = point
    following = of_corner[following_corners(scene.polygon_start)[corner]]
    key = np.minimum(point, following).astype(np.int64) * count + np.maximum(point, following)
    key = _once(key[point != following])
    here, there = np.divmod(key, max(count, 1))
    key = np.concatenate([key, there * count + here])
    key.sort()
    start = np.zeros(count + 1, np.int32)
    np.cumsum(np.bincount(here, minlength=count) + np.bincount(there, minlength=count), out=start[1:])
    return start, (key % max(count, 1)).astype(np.int32)


def _once(key):
    """The different ones of a key (K,), in order; it is sorted in place."""
    key.sort()
    return key[np.append(True, key[1:] != key[:-1])] if len(key) else key
