"""Patches: the pieces of surface between which light is exchanged.

Owns the cutting of polygons into patches, the lookup from a ray's hit to the patch it fell on, and the drawing of
points on patches. A patch is a polygon or the part of one that lies in a cell of a regular grid over it; its
elements are the parallelograms and triangles it consists of, most often a single one. The grid is never added to the
traced geometry: a hit carries its place in its triangle (u, v), and an affine map turns that into a cell. Walls stay
two triangles for the ray tracer, no T-junctions appear, and patches of another size need no new BVH.

Polygons much smaller than that are clustered: those of one object and material that lie together and face the same
way make up one patch.

Each patch has two sides with a radiosity of their own: side 2 p is the front of patch p, side 2 p + 1 its back.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .polygons import clip_polygons
from .sampling import scatter
from .scene import FLAT, LEAST_AREA, box_of
from .vectors import changes, counted, cross, dot, doubled_areas, from_coordinates, length, rows_of, runs, unit

CELL = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])  # corners of a cell
SMALL = 0.5  # facets below this share of a patch's edge are clustered
CLUSTER = 0.75  # size of a cluster, as a share of a patch's edge
TURNS = 4  # steps per unit in which the normals of a cluster's facets agree
WORTH = 0.7  # clusters are made if they are fewer than this share of the facets
CUTS = 3  # planes that cut one patch where other surfaces touch it, at most
SLACK = 0.25  # of an edge: a face so little longer is not cut in two for it
THIN = 1e-12  # least area of a triangle, in the square that holds its facet, that a grid is laid over


@dataclass(frozen=True)
class Patches:
    """N patches, as arrays.

    area: (N,) float64 [m^2]. normal: (N, 3) unit. centroid: (N, 3) [m].
    polygon: (N,) int32 of the scene, the first of a cluster.
    flatness: (N,) 1 where all elements face the same way, less where they turn.
    element_start: (N + 1,) int32, patch p owns elements element_start[p] to element_start[p + 1].
    element_frame: (M, 3, 3) float64 origin and two edges of each element [m]. element_area: (M,) [m^2].
    element_square: (M,) bool, it is the parallelogram over the two edges, not the triangle.
    triangle_cell: (T,) int32 first cell of the grid that a triangle lies in.
    triangle_map: (T,) int32 the row of maps that tells its place there.
    maps: (K, 8) float32 (s0, su, sv, t0, tu, tv, columns, rows): a hit (u, v) lies in column floor(s0 + su u + sv v) and
        row floor(t0 + tu u + tv v). Row 0 is that of all grids of a single cell.
    cell_patch: (G,) int32 patch of a cell; of a cell that is cut, -1 - q.
    cut_plane: (Q, CUTS, 4) planes (normal, offset) that cut it.
    cut_patch: (Q, 2^CUTS) int32 patch of each piece, by the planes that it lies in front of (1 for the first, 2 for the
        second, 4 for the third).
    """

    area: np.ndarray
    normal: np.ndarray
    centroid: np.ndarray
    polygon: np.ndarray
    flatness: np.ndarray
    element_start: np.ndarray
    element_frame: np.ndarray
    element_square: np.ndarray
    element_area: np.ndarray
    triangle_map: np.ndarray
    triangle_cell: np.ndarray
    maps: np.ndarray
    cell_patch: np.ndarray
    cut_plane: np.ndarray
    cut_patch: np.ndarray

    def __len__(self):
        return len(self.area)

    @cached_property
    def area_before(self):
        """(M + 1,) area of the elements before each, and of all [m^2]."""
        return np.append(0.0, np.cumsum(self.element_area))

    @cached_property
    def of_triangle(self):
        """(T + 1,) int32 the patch of each triangle that lies in one alone, -1 of the others; 0 at last, for no triangle."""
        patch = np.zeros(len(self.triangle_cell) + 1, np.int32)
        if len(self.cell_patch):
            patch[:-1] = np.where(self.triangle_map == 0, np.maximum(self.cell_patch[self.triangle_cell], -1), -1)
        return patch

    def cells_around(self, triangles):
        """(K,) int64 number of cells of the grids that triangles (K,) lie in."""
        return self.maps[self.triangle_map[triangles], 6:].astype(np.int64).prod(axis=1)


def patch_size(scene, settings):
    """The longest edge [m] of patches, None where every polygon is one, and what it is at least as a share of a polygon."""
    if settings.patch_edge is None:
        return None, 0.0
    return settings.patch_edge * scene.focus, settings.patch_edge if settings.graded else 0.0


def make_patches(scene, edge=None, growth=0.0, finer=None):
    """Cut the scene's usable triangles into Patches with edges of at most about `edge` meters (None: one per polygon),
    or a share `growth` of a polygon's extent, or of its distance from the scene's focus, where that is more: a wide
    ground around a room is not cut as finely as the room.
    """
    triangle, facet = scene.facets
    finer = np.ones(len(scene.polygon_material)) if finer is None else finer
    grid = _lay_grids(scene, triangle, facet, edge, growth, finer)
    cells = grid.columns * grid.rows
    first = np.cumsum(cells) - cells

    pieces = [_uncut(scene, triangle, facet, grid), _full_cells(facet, grid), _cut_cells(facet, grid)]
    leader = _clusters(scene, triangle, grid, edge, finer)
    cell = np.concatenate([first[leader[p.facet]] + p.cell for p in pieces])
    frame = np.concatenate([p.frame for p in pieces])
    square = np.concatenate([p.square for p in pieces])
    del pieces
    solid = np.concatenate([_areas(frame[part]) > LEAST_AREA for part in runs(len(frame))] or [np.zeros(0, bool)])
    if not solid.all():
        cell, frame, square = cell[solid], frame[solid], square[solid]

    # The cells that hold an element are the patches, in order.
    held, patch = np.unique(cell, return_inverse=True)
    facet_polygon = scene.triangle_polygon[triangle[grid.leading]]
    cell_patch = _patch_of_cells(held, first, int(cells.sum()))
    cell_patch[first] = cell_patch[first[leader]]
    return Patches(
        **join_elements(patch.reshape(-1), frame, square),
        polygon=facet_polygon[np.searchsorted(first, held, side="right") - 1],
        **_triangle_maps(len(scene.triangles), triangle, facet, grid, first),
        cell_patch=cell_patch,
        cut_plane=np.zeros((0, CUTS, 4)),
        cut_patch=np.zeros((0, 1 << CUTS), np.int32),
    )


def join_elements(patch, frame, square):
    """The fields of Patches that elements make up: patch (M,) of each element, frame (M, 3, 3) and square (M,)."""
    order = np.argsort(patch, kind="stable")
    patch, frame, square = patch[order], rows_of(frame, order), square[order]
    start = np.append(np.flatnonzero(changes(patch)), len(patch)).astype(np.int32)
    normal = cross(frame[:, 1], frame[:, 2])
    area = length(normal) * np.where(square, 1.0, 0.5)
    normal = _sums(normal * np.where(square, 1.0, 0.5)[:, None], start)
    whole = _sums(area, start)
    middle = frame[:, 0] + (frame[:, 1] + frame[:, 2]) * np.where(square, 0.5, 1 / 3)[:, None]
    return {
        "area": whole,
        "normal": unit(normal),
        "centroid": _sums(middle * area[:, None], start) / whole[:, None],
        "flatness": length(normal) / whole,
        "element_start": start,
        "element_frame": frame,
        "element_square": square,
        "element_area": area,
    }


def patch_of_hit(patches, vertices, triangles, triangle, u, v):
    """(K,) int32 patch on which the hits (triangle, u, v) of K rays fell, any where the triangle is -1; vertices, triangles:
    of the scene."""
    # In meshes finer than patches nine hits in ten are told by their triangle; so are rays that met nothing: under the sky all of
    # this took three times as long when they were looked up as if they had.
    patch = np.take(patches.of_triangle, triangle)
    other = np.flatnonzero(patch < 0)
    if len(other):
        each = (np.take(x, other) for x in (triangle, u, v))
        patch[other] = _patch_in_grid(patches, vertices, triangles, *each)
    return patch


def _patch_in_grid(patches, vertices, triangles, triangle, u, v):
    """(K,) int32 what `patch_of_hit` says where the triangle alone does not tell."""
    triangle = triangle.astype(np.intp)
    cell, grid = np.take(patches.triangle_cell, triangle), np.take(patches.triangle_map, triangle)
    laid = np.flatnonzero(grid)
    if len(laid):
        m, s, t = np.take(patches.maps, grid[laid], axis=0), np.take(u, laid), np.take(v, laid)
        # Rounding can carry a hit over the rim of the grid: clamp rather than trust the last bit.
        column = np.clip(m[:, 0] + m[:, 1] * s + m[:, 2] * t, 0.0, m[:, 6] - 1.0).astype(np.int32)
        row = np.clip(m[:, 3] + m[:, 4] * s + m[:, 5] * t, 0.0, m[:, 7] - 1.0).astype(np.int32)
        cell[laid] += row * m[:, 6].astype(np.int32) + column
    patch = np.take(patches.cell_patch, cell)
    if len(patches.cut_patch):
        hit = np.flatnonzero(patch < 0)
        # Up to half of the hits can be here: a coordinate and a plane at a time, which takes a third of the time.
        corners = np.take(triangles, np.take(triangle, hit), axis=0).T
        a, b, c = (np.take(vertices, corner, axis=0).T for corner in corners)
        s, t = np.take(u, hit).astype(float), np.take(v, hit).astype(float)
        place = [p + s * (q - p) + t * (r - p) for p, q, r in zip(a, b, c)]
        cut = -1 - np.take(patch, hit)
        planes, front = np.take(patches.cut_plane, cut, axis=0), np.zeros(len(hit), np.int64)
        for k in np.flatnonzero(planes.any(axis=(0, 2))):
            x, y, z, level = planes[:, k].T
            front |= (x * place[0] + y * place[1] + z * place[2] > level).astype(np.int64) << k
        patch[hit] = patches.cut_patch[cut, front]
    return patch


def draw_on_patches(patches, ids, a, b):
    """Points drawn evenly by area on patches: (K, n, 3) float64, and the normals there, (K, 1 or n, 3).

    ids: (K,) patches; a, b: (K, n) in [0, 1).
    """
    # What a patch gets must not depend on the others in `ids`: only those of several elements, or bent, are treated so.
    first, last = patches.element_start[ids], patches.element_start[ids + 1] - 1
    position, normal = _draw_on_elements(patches, first[:, None], a, b), np.take(patches.normal, ids, axis=0)[:, None]
    several = np.flatnonzero(first < last)
    if not len(several):
        return position, normal
    # The element at the share a of the patch's area, and the place in that element where a then is.
    upto = patches.area_before
    target = upto[first[several], None] + a[several] * patches.area[ids[several], None]
    element = np.clip(np.searchsorted(upto, target, side="right") - 1, first[several, None], last[several, None])
    a = np.clip((target - upto[element]) / patches.element_area[element], 0.0, 1.0)
    position[several] = _draw_on_elements(patches, element, a, b[several])
    bent = np.flatnonzero(patches.flatness[ids[several]] < FLAT)
    if len(bent):
        normal = np.broadcast_to(normal, position.shape).copy()
        frame = np.take(patches.element_frame, element[bent], axis=0)
        normal[several[bent]] = unit(cross(frame[..., 1, :], frame[..., 2, :]))
    return position, normal


def _draw_on_elements(patches, element, a, b):
    """(K, n, 3) places a, b (K, n) on elements (K, 1 or n), stored by coordinate: in a fifth of the time."""
    frame = np.take(patches.element_frame, element, axis=0)
    fold = ~patches.element_square[element] & (a + b > 1.0)
    a, b = np.where(fold, 1.0 - a, a), np.where(fold, 1.0 - b, b)
    return from_coordinates(*(frame[..., 0, k] + a * frame[..., 1, k] + b * frame[..., 2, k] for k in range(3)))


@dataclass(frozen=True)
class _Grid:
    """A grid of cells over each of F facets of K triangles.

    place: (K, 3, 2) corners of the triangles in units of cells. columns, rows: (F,). leading: (K,) bool, the first
    triangle of each facet. frame: (K, 3, 3) by each triangle's own measure, the world position of the grid's corner and
    the edges of a cell.
    """

    place: np.ndarray
    columns: np.ndarray
    rows: np.ndarray
    leading: np.ndarray
    frame: np.ndarray


def _lay_grids(scene, triangle, facet, edge, growth, finer):
    """Grids with cells of at most `edge`, see `make_patches`: over quads along their own edges, over others along the
    longest edge."""
    leading = changes(facet)
    count = int(leading.sum())
    place = np.zeros((len(triangle), 3, 2))  # as large as the mesh, but memory is taken only where grids are laid
    columns, rows, frame = np.ones(count, np.int64), np.ones(count, np.int64), np.zeros((len(triangle), 3, 3))
    grid = _Grid(place, columns, rows, leading, frame)
    if edge is None or not count:
        return grid
    size, away = _extents(scene)
    finer = finer[scene.triangle_polygon[triangle[leading]]]
    edge, wide = edge * finer, np.maximum(size, away) * finer
    for chosen, part, owner, lay in _kinds(scene, triangle, facet, leading, size > edge):
        corners = scene.vertices[scene.triangles[triangle[part]]]
        at, span = lay(scene, triangle[part], owner, corners, leading[part])
        cells = _cells_of(span, wide[chosen], edge[chosen], growth)
        # A sliver thinner than its digits has no frame: what it belongs to stays whole.
        thin = np.bincount(owner, ~(np.abs(doubled_areas(at)) > THIN)) > 0
        cells[thin] = 1
        columns[chosen], rows[chosen] = cells.astype(np.int64).T
        broad = ~thin[owner]
        part = part[broad]
        place[part] = (at * cells[owner, None])[broad]
        frame[part] = _frames(corners[broad], place[part])
    return grid


def count_patches(scene, sizes):
    """About how many patches each of some sizes (edge, growth) would make, before surfaces in contact cut them: a list."""
    triangle, facet = scene.facets
    leading = changes(facet)
    if not len(triangle):
        return [0.0] * len(sizes)
    (size, away), span = _extents(scene), np.zeros((int(leading.sum()), 2))
    for chosen, part, owner, lay in _kinds(scene, triangle, facet, leading, size > min(edge for edge, _ in sizes)):
        corners = scene.vertices[scene.triangles[triangle[part]]]
        span[chosen] = lay(scene, triangle[part], owner, corners, leading[part])[1]
    area = np.bincount(facet, scene.triangle_normal_area[1][triangle], len(size))
    found = []
    for edge, growth in sizes:
        cells = _cells_of(span, np.maximum(size, away), edge, growth).prod(axis=1)
        found.append(float(np.where(size > edge, cells, np.minimum(area / (CLUSTER * edge) ** 2, 1.0)).sum()))
    return found


def _cells_of(span, wide, edge, growth):
    """(F, 2) columns and rows of cells over facets with sides (F, 2) [m]; wide: (F,) what `growth` is a share of [m]."""
    return np.maximum(np.ceil(span / np.maximum(edge, growth * wide)[:, None] - SLACK), 1)


def _extents(scene):
    """Extents (F,) of facets, and how far (F,) they are from the scene's focus [m]."""
    (low, high), (inner, outer) = scene.facet_boxes, scene.focus_bounds
    return length(high - low), length(np.maximum(np.maximum(inner - high, low - outer), 0.0))


def _kinds(scene, triangle, facet, leading, large):
    """The large (F,) facets by the way that grids are laid over them: which facets (F,), their triangles (K,), the
    number 0, 1, ... of the facet of each (K,), and the function that lays the grids."""
    polygon = scene.triangle_polygon[triangle]
    quad = np.diff(scene.polygon_start)[polygon[leading]] == 4
    quad &= np.bincount(facet, minlength=len(quad)) == 2
    for chosen, lay in ((large & quad, _along_quads), (large & ~quad, _along_longest)):
        part = np.flatnonzero(chosen[facet])
        if len(part):
            yield chosen, part, (np.cumsum(chosen) - 1)[facet[part]], lay


def _along_quads(scene, triangle, owner, corners, leading):
    """Places (K, 3, 2) of the triangles' corners in the unit square of their quad, and the quad's sides (F, 2) [m]."""
    polygon = scene.triangle_polygon[triangle]
    number = scene.triangle_corner[triangle] - scene.polygon_start[polygon][:, None]
    first = scene.polygon_start[polygon[leading]]
    p0, p1, p2, p3 = _quads(scene, first)
    span = np.stack(
        [np.maximum(length(p1 - p0), length(p2 - p3)), np.maximum(length(p3 - p0), length(p2 - p1))], axis=1
    )
    return CELL[number], span


def _along_longest(scene, triangle, owner, corners, leading):
    """Places (K, 3, 2) of the triangles' corners in the unit square over each facet, along its longest edge, and the
    square's sides (F, 2) [m]."""
    along = _longest_edges(corners, owner)
    across = cross(scene.triangle_normal_area[0][triangle][leading], along)
    local = corners - corners[leading][owner, :1]
    flat = np.stack([dot(local, axis[owner, None]) for axis in (along, across)], axis=-1)
    least, most = box_of(np.moveaxis(flat, 1, 0), np.flatnonzero(leading))
    span = np.maximum(most - least, 1e-300)
    return (flat - least[owner, None]) / span[owner, None], span


def _frames(corners, place):
    """(K, 3, 3) world position of a grid's corner and the edges of its cells, from triangles' corners (K, 3, 3) in the
    world and (K, 3, 2) in cells."""
    a, b = place[:, 1] - place[:, 0], place[:, 2] - place[:, 0]
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    det = doubled_areas(place)[:, None]
    s = (b[:, 1:] * e1 - a[:, 1:] * e2) / det
    t = (a[:, :1] * e2 - b[:, :1] * e1) / det
    return np.stack([corners[:, 0] - place[:, 0, :1] * s - place[:, 0, 1:] * t, s, t], axis=1)


def _longest_edges(corners, owner):
    """(F, 3) unit direction of each owner's longest edge; an edge between two of its own triangles does not count."""
    following = np.roll(corners, -1, axis=1)
    edge = (following - corners).reshape(-1, 3)
    middle = ((following + corners) / 2).reshape(-1, 3)
    owner = np.repeat(owner, 3)
    order = np.lexsort((middle[:, 2], middle[:, 1], middle[:, 0], owner))
    same = (owner[order][1:] == owner[order][:-1]) & (middle[order][1:] == middle[order][:-1]).all(axis=1)
    inner = np.zeros(len(owner), bool)
    inner[order[1:][same]] = inner[order[:-1][same]] = True
    size = length(edge)
    best = np.lexsort((np.where(inner, 0.0, -size), owner))
    best = best[changes(owner[best])]
    return edge[best] / size[best, None]


@dataclass(frozen=True)
class _Pieces:
    """E elements: the facet (E,) and the cell (E,) in it that each belongs to, frame (E, 3, 3) and square (E,)."""

    facet: np.ndarray
    cell: np.ndarray
    frame: np.ndarray
    square: np.ndarray


def _areas(frame):
    """(K,) areas of parallelograms with frames (K, 3, 3)."""
    return length(cross(frame[:, 1], frame[:, 2]))


def _uncut(scene, triangle, facet, grid):
    """The elements of facets that are one cell: a parallelogram for a quad that is one, else a triangle each."""
    mine = np.flatnonzero((grid.columns * grid.rows == 1)[facet])
    leading, polygon = grid.leading[mine], scene.triangle_polygon[triangle[mine]]
    first = scene.polygon_start[polygon]

    # Two triangles of a quad: they fill a parallelogram if the quad's corners do.
    square = leading & ~np.append(leading, True)[1:]
    square &= scene.polygon_start[polygon + 1] - first == 4
    pair = np.flatnonzero(square)
    for part in runs(len(pair)):
        p0, p1, p2, p3 = _quads(scene, first[pair[part]])
        gap = np.abs(p0 - p1 + p2 - p3).max(axis=1) <= 1e-6 * np.abs(p2 - p0).max(axis=1)
        square[pair[part]] = gap
    kept = np.flatnonzero(~np.append(False, square)[: len(square)])
    square, mine, first = square[kept], mine[kept], first[kept]
    frame = np.empty((len(kept), 3, 3))
    for part in runs(len(kept)):
        own = square[part]
        a, b, c = scene.corners_of(triangle[mine[part]])
        a[own], b[own], _, c[own] = _quads(scene, first[part][own])
        frame[part] = np.stack([a, b - a, c - a], axis=1)
    return _Pieces(facet[mine], np.zeros(len(kept), np.int64), frame, square)


def _quads(scene, first):
    """Corners of quads, (K, 3) each, by the first one (K,) of each."""
    return tuple(rows_of(scene.vertices, scene.corner_vertex[first + k]) for k in range(4))


def _clusters(scene, triangle, grid, edge, finer):
    """(F,) the facet whose patch each facet belongs to: its own, or the first one of its cluster."""
    leader = np.arange(len(grid.rows))
    if edge is None or not len(leader):
        return leader
    (low, high), first = scene.facet_boxes, np.flatnonzero(grid.leading)
    own = edge * finer[scene.triangle_polygon[triangle[first]]]
    small = np.flatnonzero((grid.columns * grid.rows == 1) & (length(high - low) < SMALL * own))
    middle = (rows_of(low, small) + rows_of(high, small)) / 2
    first = first[small]
    polygon = scene.triangle_polygon[triangle[first]]
    normal = rows_of(scene.triangle_normal_area[0], triangle[first])
    place = np.floor((middle - scene.bounds[0]) / (CLUSTER * edge * finer[polygon])[:, None])
    alike = [*place.T, *np.round(normal * TURNS).T, scene.polygon_object[polygon], scene.polygon_material[polygon]]
    key = np.zeros(len(small), np.uint64)
    for number, part in enumerate(alike):
        key ^= (scatter(part.astype(np.int64) ^ key.astype(np.int64), number) * 2.0**53).astype(np.uint64)
    _, start, group = np.unique(key, return_index=True, return_inverse=True)
    if len(start) < WORTH * len(small):
        leader[small] = small[start[group.reshape(-1)]]
    return leader


def _filled(facet, grid):
    """(F,) bool: facets of several cells that fill their grid to the rim with cells of one shape, as rectangles do."""
    cells = grid.columns * grid.rows
    laid = np.flatnonzero((cells > 1)[facet])
    facet, leading, place, frame = facet[laid], grid.leading[laid], grid.place[laid], grid.frame[laid]
    area = np.bincount(facet, np.abs(doubled_areas(place)) / 2, len(cells))
    first = frame[leading][np.cumsum(leading) - 1]
    size = np.abs(first[:, 1:]).max(axis=(1, 2))
    differs = np.abs(frame[:, 1:] - first[:, 1:]).max(axis=(1, 2)) > 1e-6 * size
    alike = np.bincount(facet, differs, len(cells)) == 0
    return (cells > 1) & (area >= cells * (1 - 1e-6)) & alike


def _full_cells(facet, grid):
    """The cells of facets that fill their grid, a parallelogram each."""
    count = np.where(_filled(facet, grid), grid.columns * grid.rows, 0)
    owner, cell = counted(count)
    row, column = np.divmod(cell, grid.columns[owner])
    frame = _cell_frames(grid.frame[grid.leading][owner], column, row)
    return _Pieces(owner, cell, frame, np.ones(len(owner), bool))


def _cell_frames(frame, column, row):
    """(E, 3, 3) frames of cells, from those of their grids."""
    frame = frame.copy()
    frame[:, 0] += column[:, None] * frame[:, 1] + row[:, None] * frame[:, 2]
    return frame


def _cut_cells(facet, grid):
    """The elements of the other facets: their triangles, cut at the lines of the grid."""
    mine = ((grid.columns * grid.rows > 1) & ~_filled(facet, grid))[facet]
    facet, place, frame = facet[mine], grid.place[mine], grid.frame[mine]
    low = np.maximum(np.floor(place.min(axis=1) + 1e-6), 0).astype(np.int64)
    span = np.maximum(np.ceil(place.max(axis=1) - 1e-6).astype(np.int64) - low, 1)
    source, step = counted(span[:, 0] * span[:, 1])
    column = low[source, 0] + step % span[source, 0]
    row = low[source, 1] + step // span[source, 0]
    cell = row * grid.columns[facet[source]] + column

    # Signed distance of each cell's corners from the triangle's edges, positive inside.
    edge = np.roll(place, -1, axis=1) - place
    turn = np.sign(edge[:, 0, 0] * edge[:, 1, 1] - edge[:, 0, 1] * edge[:, 1, 0])[:, None, None]
    inward = np.stack([-edge[..., 1], edge[..., 0]], axis=-1) * turn
    inward = unit(inward)
    offset = dot(place, inward)
    corner = np.stack([column, row], axis=1)[:, None] + CELL
    normal = inward[source]
    inside = corner[..., :1] * normal[:, None, :, 0] + corner[..., 1:] * normal[:, None, :, 1] - offset[source, None]
    held = (inside.max(axis=1) > 1e-6).all(axis=1)
    out = (inside < -1e-6).any(axis=2)
    full = ~out.any(axis=1)

    # A cell that the triangle cuts along a diagonal is a triangle itself; others are clipped, and taken as fans.
    beyond = out.argmax(axis=1)
    across = np.abs(np.take_along_axis(inside, np.array([(1, 3), (0, 2), (1, 3), (0, 2)])[beyond][..., None], axis=1))
    half = held & (out.sum(axis=1) == 1) & (across < 1e-6).all(axis=1).any(axis=1)  # both corners on one edge
    opposite = (beyond[half] + 2) % 4
    right = np.stack([corner[half, 0] + CELL[(opposite + k) % 4] for k in (0, 1, 3)], axis=1)
    rim = np.flatnonzero(held & ~full & ~half)
    polygon, sides = corner[rim], np.full(len(rim), 4)
    for k in range(3):
        value = np.einsum("kvd,kd->kv", polygon, inward[source[rim], k]) - offset[source[rim], k, None]
        polygon, sides = clip_polygons(polygon, sides, value)
    which, step = counted(np.maximum(sides - 2, 0))
    fan = np.stack([polygon[which, 0], polygon[which, step + 1], polygon[which, step + 2]], axis=1)
    e1, e2 = fan[:, 1] - fan[:, 0], fan[:, 2] - fan[:, 0]
    solid = np.abs(e1[:, 0] * e2[:, 1] - e1[:, 1] * e2[:, 0]) > 1e-9

    part = np.concatenate([np.flatnonzero(half), rim[which[solid]]])
    triangles = _to_world(frame[source[part]], np.concatenate([right, fan[solid]]))
    squares = _cell_frames(frame[source[full]], column[full], row[full])
    return _Pieces(
        facet[source[np.concatenate([np.flatnonzero(full), part])]],
        np.concatenate([cell[full], cell[part]]),
        np.concatenate([squares, triangles]),
        np.append(np.ones(len(squares), bool), np.zeros(len(part), bool)),
    )


def _to_world(frame, triangle):
    """(E, 3, 3) frames of triangles (E, 3, 2), given in cells of grids with frames (E, 3, 3)."""
    world = frame[:, None, 0] + triangle[..., :1] * frame[:, None, 1] + triangle[..., 1:] * frame[:, None, 2]
    return np.stack([world[:, 0], world[:, 1] - world[:, 0], world[:, 2] - world[:, 0]], axis=1)


def _triangle_maps(count, triangle, facet, grid, first):
    """The fields of Patches that tell where hits on `count` triangles lie."""
    cell, row = np.zeros((2, count), np.int32)
    cell[triangle] = first[facet]
    laid = np.flatnonzero((grid.columns * grid.rows > 1)[facet])
    row[triangle[laid]] = 1 + np.arange(len(laid))
    maps = np.zeros((1 + len(laid), 8), np.float32)
    maps[0, [0, 3]], maps[:, 6:] = 0.5, 1.0
    for axis, number in enumerate((grid.columns, grid.rows)):
        p0, p1, p2 = np.moveaxis(grid.place[laid, :, axis], 1, 0)
        maps[1:, 3 * axis : 3 * axis + 3] = np.stack([p0, p1 - p0, p2 - p0], axis=1)
        maps[1:, 6 + axis] = number[facet[laid]]
    return {"triangle_map": row, "triangle_cell": cell, "maps": maps}


def _patch_of_cells(held, first, count):
    """(G,) patch of each cell. A cell that holds nothing (a hit can round into it) gets the nearest patch before it
    in its grid, or the first one of the grid."""
    patch = np.searchsorted(held, np.arange(count), side="right") - 1
    grid = np.searchsorted(first, np.arange(count), side="right") - 1
    first_held = np.minimum(np.searchsorted(held, first), len(held) - 1)
    return np.maximum(patch, first_held[grid]).astype(np.int32)


def _sums(values, start):
    """Sums of values (M, ...) over the runs that begin at start (N + 1,)."""
    return np.add.reduceat(values, start[:-1], axis=0) if len(start) > 1 else np.zeros((0, *values.shape[1:]))
