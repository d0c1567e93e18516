"""Subdivision: a finer mesh where the light needs it.

Owns the refinement of triangles and the rule that says which to refine. A triangle is split at the middle of its longest
edge, after the triangle on the other side of that edge has been made ready for it (Rivara 1984): so there are no
T-junctions and no cracks, no angle gets less than half of the least there was, nothing flips, and the shape stays what
it was. Edges at one place are one edge, whatever objects they belong to, so walls modeled as sheets that touch stay tight.

Vertices are only ever added: what is known of the light at the old ones stays good.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from math import inf

import numpy as np

from .pieces import WELD
from .points import SAME_NORMAL, make_points
from .remesh import Remesh
from .surfaces import Readings
from .vectors import TINY, counted, dot, numbered, unit


@dataclass(frozen=True)
class Fitting:
    """How fine a mesh is to be. max_edge: the longest edge that is left [m], as far as vertices allow it. min_edge: no
    edge is split that would give pieces shorter than this [m]. contrast: a triangle is split where its corners' light
    differs by more than this share of the brightest of them, or of the scene's mean if that is more. vertices: the most
    that there may be, as long as there are not more to begin with. passes: of refinement by light."""

    max_edge: float
    min_edge: float
    contrast: float = 0.1
    vertices: float = 1e6
    passes: int = 6

    @classmethod
    def for_scene(cls, scene, max_edge=None, min_edge=None, contrast=None, vertices=None):
        """The fitting that suits a scene, with what was asked for."""
        longest = max_edge or scene.diagonal / 40
        shortest = min(min_edge or longest / 16, longest)
        return cls(longest, shortest, 0.1 if contrast is None else contrast, vertices or 1e6)


@dataclass(frozen=True)
class Pieces:
    """T triangles, each a piece of a triangle of a scene.

    triangle: (T,) of the scene. weight: (T, 3, 3) of each corner, by the scene triangle's corners. vertex: (T, 3) numbers
    of the vertices; position: (V, 3) of these [m]; place: (V,) a number that vertices at one place share.
    """

    triangle: np.ndarray
    weight: np.ndarray
    vertex: np.ndarray
    position: np.ndarray
    place: np.ndarray

    def edges(self):
        """The edges by place: number (T, 3) of the edge from each corner to the next, its two places (E, 2), its length
        (E,), and its rank (E,), by length and then by places."""
        ends = self.place[self.vertex]
        ends = np.sort(np.stack([ends, np.roll(ends, -1, axis=1)], axis=2), axis=2)
        size = int(self.place.max(initial=0)) + 1
        key, number = np.unique(ends[..., 0] * size + ends[..., 1], return_inverse=True)
        ends = np.stack(np.divmod(key, size), axis=1)
        at = np.empty((size, 3))
        at[self.place[::-1]] = self.position[::-1]
        apart = at[ends[:, 1]] - at[ends[:, 0]]
        length = np.sqrt(dot(apart, apart))
        rank = np.empty(len(key), np.int64)
        rank[np.lexsort((np.arange(len(key)), length))] = np.arange(len(key))
        return number.reshape(-1, 3), ends, length, rank


def whole_pieces(scene):
    """The Pieces of a scene that are its written objects' solid triangles, uncut."""
    written = scene.written[scene.polygon_object[scene.triangle_polygon]]
    triangle = np.flatnonzero(written & scene.solid)
    used = np.unique(scene.triangles[triangle])
    vertex = np.searchsorted(used, scene.triangles[triangle])
    cell = np.rint((scene.vertices[used] - scene.bounds[0]) / max(WELD * scene.diagonal, TINY))
    place = numbered(cell)
    weight = np.broadcast_to(np.eye(3), (len(triangle), 3, 3)).copy()
    return Pieces(triangle, weight, vertex, scene.vertices[used], place)


def split(pieces, marked):
    """Pieces with the marked edges (E,) bool of `pieces.edges()` halved, and all others that must be for that."""
    number, _, _, rank = pieces.edges()
    longest = rank[number].argmax(axis=1)
    main = np.take_along_axis(number, longest[:, None], axis=1)[:, 0]
    marked = marked.copy()
    while True:
        needed = main[marked[number].any(axis=1)]
        if marked[needed].all():
            break
        marked[needed] = True

    # Turn every triangle so that its longest edge goes from its first corner to its second.
    turn = (longest[:, None] + np.arange(3)) % 3
    vertex, number = np.take_along_axis(pieces.vertex, turn, axis=1), np.take_along_axis(number, turn, axis=1)
    weight = np.take_along_axis(pieces.weight, turn[..., None], axis=1)
    cut = marked[number]

    # Middles: one vertex for each edge of vertices, one place for each edge of places.
    row, side = np.nonzero(cut)
    a, b = vertex[row, side], vertex[row, (side + 1) % 3]
    low, high = np.minimum(a, b), np.maximum(a, b)
    key, first, index = np.unique(low * len(pieces.position) + high, return_index=True, return_inverse=True)
    middle = np.full(cut.shape, -1)
    middle[row, side] = len(pieces.position) + index.reshape(-1)
    low, high = np.divmod(key, len(pieces.position))
    edge = np.flatnonzero(marked)
    place_of_edge = np.full(len(marked), -1)
    place_of_edge[edge] = int(pieces.place.max(initial=-1)) + 1 + np.arange(len(edge))
    position = np.concatenate([pieces.position, (pieces.position[low] + pieces.position[high]) / 2])
    place = np.concatenate([pieces.place, place_of_edge[number[row, side][first]]])
    halfway = (weight + np.roll(weight, -1, axis=1)) / 2

    # Corners 0, 1, 2 and the middles 3, 4, 5 of the edges that begin there: how many edges are cut says into what.
    corners = np.concatenate([vertex, middle], axis=1)
    weights = np.concatenate([weight, halfway], axis=1)
    made = []
    for second, third, parts in (
        (False, False, ((0, 3, 2), (3, 1, 2))),
        (True, False, ((0, 3, 2), (3, 1, 4), (3, 4, 2))),
        (False, True, ((0, 3, 5), (5, 3, 2), (3, 1, 2))),
        (True, True, ((0, 3, 5), (5, 3, 2), (3, 1, 4), (3, 4, 2))),
    ):
        rows = np.flatnonzero(cut[:, 0] & (cut[:, 1] == second) & (cut[:, 2] == third))
        made += [(rows, part) for part in parts]
    kept = np.flatnonzero(~cut.any(axis=1))
    made.append((kept, (0, 1, 2)))
    row = np.concatenate([rows for rows, _ in made])
    which = np.concatenate([np.tile(part, (len(rows), 1)) for rows, part in made])
    order = np.argsort(row, kind="stable")
    row, which = row[order], which[order]
    return Pieces(
        pieces.triangle[row],
        np.take_along_axis(weights[row], which[..., None], axis=1),
        np.take_along_axis(corners[row], which, axis=1),
        position,
        place,
    )


def split_long(pieces, longest, most=inf):
    """Pieces without an edge longer than `longest` [m]; or with all edges split as evenly as `most` vertices allow."""
    while True:
        _, _, length, _ = pieces.edges()
        marked = length > longest * (1 + 1e-9)
        if not marked.any() or len(pieces.position) + np.count_nonzero(marked) > most:
            return pieces
        finer = split(pieces, marked)
        if len(finer.position) > most:
            return pieces
        pieces = finer


def longest_edge(scene):
    """Length of the longest edge of the triangles of a scene's written objects [m]."""
    written = scene.written[scene.polygon_object[scene.triangle_polygon]] & scene.solid
    corner = scene.vertices[scene.triangles[written]]
    edge = corner - np.roll(corner, -1, axis=1)
    return float(np.sqrt(dot(edge, edge).max(initial=0.0)))


def split_by_light(pieces, light, fitting, mean, room):
    """Pieces refined once where the light needs it, or None if it needs no more.

    light: (T, 3) at the corners of the pieces; mean: of the scene. room: how many vertices may be added; where it does not
    suffice, the triangles that change the light over the largest surface come first.
    """
    number, _, length, rank = pieces.edges()
    main = np.take_along_axis(number, rank[number].argmax(axis=1)[:, None], axis=1)[:, 0]
    spread = light.max(axis=1) - light.min(axis=1)
    needs = spread > fitting.contrast * np.maximum(light.max(axis=1), mean)
    needs &= length[main] >= 2 * fitting.min_edge
    rows = np.flatnonzero(needs)
    if not len(rows) or room <= 0:
        return None
    # Edge for edge the gain is the square of what the light changes by, over the triangles beside it.
    gain = np.zeros(len(length))
    np.add.at(gain, main[rows], spread[rows] ** 2 * _areas(pieces)[rows])
    edges = np.flatnonzero(gain)
    edges = edges[np.argsort(-gain[edges], kind="stable")]
    while True:
        marked = np.zeros(len(length), bool)
        marked[edges] = True
        finer = split(pieces, marked)
        added = len(finer.position) - len(pieces.position)
        if added <= room:
            return finer
        # Other edges come with those that are marked: fewer of them, until the vertices suffice.
        fewer = int(len(edges) * min(0.9 * room / added, 0.9))
        if not fewer:
            return None
        edges = edges[:fewer]


def _areas(pieces):
    """(T,) areas of pieces [m^2]."""
    a, b, c = np.moveaxis(pieces.position[pieces.vertex], 1, 0)
    u, v = b - a, c - a
    return np.sqrt(np.maximum(dot(u, u) * dot(v, v) - dot(u, v) ** 2, 0.0)) / 2


def make_remesh(scene, pieces):
    """The Remesh of a scene whose cut polygons are replaced by their pieces, the others staying whole; and which of its
    corners (T, 3) the corners of the pieces are."""
    size = np.diff(scene.polygon_start)
    polygon = scene.triangle_polygon[pieces.triangle]
    cut = np.zeros(len(size), bool)
    cut[polygon[(pieces.weight.max(axis=2) < 1).any(axis=1)]] = True
    whole, own = np.flatnonzero(~cut), np.flatnonzero(cut[polygon])

    owner, step = counted(size[whole])
    corner = scene.polygon_start[whole][owner] + step
    used = np.unique(scene.triangles[pieces.triangle])
    number = np.concatenate([used, len(scene.vertices) + np.arange(len(pieces.position) - len(used))])
    parts = (
        (np.repeat(corner[:, None], 3, axis=1), scene.triangle_corner[pieces.triangle[own]].repeat(3, axis=0)),
        (np.tile([1.0, 0.0, 0.0], (len(corner), 1)), pieces.weight[own].reshape(-1, 3)),
        (scene.corner_vertex[corner].astype(np.int64), number[pieces.vertex[own]].reshape(-1)),
    )
    sources, weights, vertices = (np.concatenate(part) for part in parts)
    sizes = np.concatenate([size[whole], np.full(len(own), 3)])
    source = np.concatenate([whole, polygon[own]])

    # In the order of the polygons that they come from.
    order = np.argsort(source, kind="stable")
    start = np.cumsum(sizes) - sizes
    owner, step = counted(sizes[order])
    corner_order = start[order][owner] + step
    place = np.empty(len(corner_order), np.int64)
    place[corner_order] = np.arange(len(corner_order))
    new = np.full(len(scene.corner_vertex), -1)
    new[corner] = place[: len(corner)]
    which = np.take_along_axis(scene.triangle_corner[pieces.triangle], pieces.weight.argmax(axis=2), axis=1)
    of_piece = new[which]
    of_piece[own] = place[len(corner) :].reshape(-1, 3)
    remesh = Remesh(
        polygon_start=np.concatenate([[0], np.cumsum(sizes[order])]),
        polygon_source=source[order],
        corner_vertex=vertices[corner_order],
        corner_source=sources[corner_order],
        corner_weight=weights[corner_order],
    )
    return remesh, of_piece


def remeshed(scene, remesh):
    """The scene with a Remesh in place of its polygons; positions and normals, places in textures and colors that were
    read are mixed."""
    source, weight = remesh.corner_source, remesh.corner_weight

    def mixed(values):
        return np.einsum("kn,kn...->k...", weight, values[source])

    used, vertex = np.unique(remesh.corner_vertex, return_inverse=True)
    first = np.zeros(len(used), np.int64)
    first[vertex.reshape(-1)[::-1]] = np.arange(len(source))[::-1]
    size = np.diff(remesh.polygon_start)

    # Whole polygons keep their triangles, pieces are their own.
    whole = np.flatnonzero(
        np.bincount(remesh.polygon_source, minlength=len(scene.polygon_material))[scene.triangle_polygon] == 1
    )
    new_polygon = np.zeros(len(scene.polygon_material), np.int64)
    new_polygon[remesh.polygon_source] = np.arange(len(size))
    kept = new_polygon[scene.triangle_polygon[whole]]
    shift = remesh.polygon_start[kept] - scene.polygon_start[scene.triangle_polygon[whole]]
    pieces = np.flatnonzero(
        np.bincount(remesh.polygon_source, minlength=len(scene.polygon_material))[remesh.polygon_source] > 1
    )
    triangle_polygon = np.concatenate([kept, pieces])
    triangle_corner = np.concatenate(
        [scene.triangle_corner[whole] + shift[:, None], remesh.polygon_start[pieces][:, None] + np.arange(3)]
    )
    order = np.argsort(triangle_polygon, kind="stable")
    normal = mixed(np.nan_to_num(scene.corner_normal))
    return replace(
        scene,
        vertices=mixed(scene.vertices[scene.corner_vertex])[first],
        polygon_start=remesh.polygon_start.astype(np.int32),
        polygon_object=scene.polygon_object[remesh.polygon_source],
        polygon_material=scene.polygon_material[remesh.polygon_source],
        corner_vertex=vertex.reshape(-1).astype(np.int32),
        corner_normal=unit(normal),
        corner_uv=None if scene.corner_uv is None else mixed(scene.corner_uv),
        triangle_corner=triangle_corner[order].astype(np.int32),
        triangle_polygon=triangle_polygon[order].astype(np.int32),
        readings=_mixed_readings(scene, remesh),
        left_out=scene.left_out[remesh.polygon_source],
        double=scene.double[remesh.polygon_source],
    )


def _mixed_readings(scene, remesh):
    """What was read of surfaces, at the corners of a Remesh."""
    read = scene.readings
    if read is None:
        return None
    place = np.full(len(scene.corner_vertex), -1)
    place[read.corner] = np.arange(len(read.corner))
    corner = np.flatnonzero((place[remesh.corner_source] >= 0).all(axis=1))
    rows, weight = place[remesh.corner_source[corner]], remesh.corner_weight[corner]
    colors = {
        name: np.einsum("kn,knc->kc", weight, getattr(read, name)[rows])
        for name in ("corner_reflectance", "corner_exitance")
    }
    none = np.zeros((0, 3))
    return Readings(np.zeros(0, np.int32), np.zeros((0, 2)), none, none, corner, **colors)


def fit_mesh(scene, fitting, flipped, cells, light):
    """Refine a scene's written objects to their light: a generator that returns the finer Scene, its Points, and the
    Remesh that leads there.

    light: generator function of Points that returns their light (P,), roughly; every point is asked for once. flipped:
    (P,) bool, polygons whose back side's light is asked for. cells: started with the scene's arrays.
    """
    pieces = split_long(whole_pieces(scene), fitting.max_edge, fitting.vertices)
    known = None
    for number in range(fitting.passes + 1):
        remesh, corner = make_remesh(scene, pieces)
        finer = remeshed(scene, remesh)
        points = make_points(finer, flipped[remesh.polygon_source], cells)
        if number == fitting.passes:
            break
        values = _known_light(known, finer, points)
        new = np.flatnonzero(np.isnan(values))
        values[new] = yield from light(chosen_points(points, new))
        known = (points.normal, point_vertices(finer, points), values)

        at_corner = np.zeros(len(finer.corner_vertex))
        at_corner[points.corner] = values[points.corner_point]
        mean = (points.area * values).sum() / max(points.area.sum(), TINY)
        room = fitting.vertices - len(pieces.position)
        more = split_by_light(pieces, at_corner[corner], fitting, mean, room)
        if more is None:
            break
        pieces = more
    return finer, points, remesh


def _known_light(known, scene, points):
    """(P,) light of the points that had some in a coarser mesh, at the same vertex with the same normal; NaN for others.

    known: normals (K, 3), vertices (K,) and light (K,), or None.
    """
    values = np.full(len(points), np.nan)
    if known is None:
        return values
    normal, vertex, light = known
    order = np.argsort(vertex, kind="stable")
    own = point_vertices(scene, points)
    start, stop = (np.searchsorted(vertex[order], own, side=side) for side in ("left", "right"))
    new, step = counted(stop - start)
    old = order[start[new] + step]
    same = dot(points.normal[new], normal[old]) >= SAME_NORMAL
    values[new[same]] = light[old[same]]
    return values


def point_vertices(scene, points):
    """(P,) the vertex of the scene at each of its points."""
    vertex = np.zeros(len(points), np.int64)
    vertex[points.corner_point] = scene.corner_vertex[points.corner]
    return vertex


def chosen_points(points, ids):
    """The Points of ids (K,) alone, neighbors of one another as they were; they write no corners."""
    number = np.full(len(points), -1)
    number[ids] = np.arange(len(ids))
    owner, step = counted(np.diff(points.neighbor_start)[ids])
    neighbor = number[points.neighbor[points.neighbor_start[ids][owner] + step]]
    owner, neighbor = owner[neighbor >= 0], neighbor[neighbor >= 0]
    none = np.zeros(0, np.int32)
    own = {"neighbor_start", "neighbor", "corner", "corner_point"}
    return replace(
        points,
        **{f.name: getattr(points, f.name)[ids] for f in fields(points) if f.name not in own},
        neighbor_start=np.searchsorted(owner, np.arange(len(ids) + 1)).astype(np.int32),
        neighbor=neighbor.astype(np.int32),
        corner=none,
        corner_point=none,
    )
