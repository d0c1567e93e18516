"""Touching: faces that lie against others, front to front, as the bottom of a block does on a floor.

Rays start a little before their surface; from a face that touches another they would start beyond it, and see the sky
below the floor. Nothing lights such a face: its points are moved into the solid behind it, where it is dark. A face that
has no solid behind it stays what it is: two sheets in one plane, turned away from one another, are the two sides of a
thin wall.
"""

from __future__ import annotations

import numpy as np

from .raycast import OFFSET, RayCaster
from .sampling import hemisphere, lattice, tangents
from .vectors import by_coordinate, dot, rows_of, runs

TOUCH = (
    2 * OFFSET
)  # faces that are no further apart touch, in scene diagonals: what starts before one is beyond the other
SINK = TOUCH + 2 * OFFSET  # how far their points are moved: rays that start before them start behind both faces
RAYS = 16  # from behind a face, that must all meet backs of faces
TASK_RAYS = 1 << 15
LEAST_THERE = 0.3  # alpha of a face that can hide another: below one of less it would be darker than without
OPPOSED = -0.999  # most cosine between the normals of faces that touch
# Faces of one plane are found by bins of its normal and of its place. A bin is so much wider than what planes of faces that
# touch may differ by that most of them are in one bin.
NORMAL_BIN, PLACE_BIN = 1.0 / 64, 1.0 / 1024
ASIDE = 0.4  # of a bin they are moved: normals along the axes are not to lie between two
REACH = (*3 * (1e-3 / NORMAL_BIN,), TOUCH / PLACE_BIN)
SPREAD, MOST = 0x2545F4914F6CDD1D, (1 << 62) - 1  # makes one number of several; no smaller than 0
SPARSE = 16  # times as large as what is in it is a table
ACROSS = np.array((0.7245, 0.5698, 0.3875))  # one side of any plane's normal is that on which it is along this


def find_touching(scene, flipped, cells, polygon, place, normal):
    """(K,) bool: places on fronts of polygons (K,) that touch a face, and have the inside of a solid behind them.

    place: (K, 3) [m]; normal: (K, 3) unit, of the polygons. flipped: (P,) bool, polygons on whose backs the places are, or
    None. cells: started with `kernel.cast_arrays`, of the scene or of another with the same surfaces.
    """
    found, pairs = np.zeros(len(polygon), bool), _Pairs(scene)
    if pairs.any:
        front = pairs.polygon if flipped is None else pairs.polygon & ~flipped
        own = np.flatnonzero(front[polygon])
        own = own[pairs.against(place[own], normal[own])]
        found[own] = _inside(scene, cells, pairs, place[own], normal[own])
    return found


class _Pairs:
    """Triangles that lie in one plane with others that are turned the other way. any: there are some. polygon: (P,) bool, whose
    polygons they are."""

    def __init__(self, scene):
        self._scale, self._normal = scene.diagonal, scene.triangle_normal_area[0]
        ahead = dot(self._normal, ACROSS) > 0
        chosen = _with_partner(scene, self._normal, ahead)
        self.any = bool(chosen.any())
        self.polygon = np.zeros(len(scene.polygon_object), bool)
        self.polygon[scene.triangle_polygon[chosen]] = True
        if self.any:
            there = np.array([material.alpha >= LEAST_THERE for material in scene.materials])
            chosen &= there[scene.polygon_material[scene.triangle_polygon]]
            sides = chosen & ahead, chosen & ~ahead
            self._casters = [RayCaster(scene.vertices, scene.triangles, side) for side in sides]

    def against(self, place, normal):
        """(K,) bool: whether a face that is turned the other way touches places (K, 3) on faces with normals (K, 3)."""
        found = np.zeros(len(place), bool)
        ahead = dot(normal, ACROSS) > 0
        for caster, own in zip(self._casters, (np.flatnonzero(~ahead), np.flatnonzero(ahead))):
            step = TOUCH * self._scale * normal[own]
            start, stop = caster.place(place[own] + step), caster.place(place[own] - step)
            triangle, _, _, distance, _ = caster.hits(start, stop - start)
            found[own] = (triangle >= 0) & (distance <= 1.0)
            found[own] &= dot(rows_of(self._normal, triangle), normal[own]) < OPPOSED
        return found


def _with_partner(scene, normal, ahead):
    """(T,) bool: triangles in whose plane, or very near it, others are turned the other way. normal: (T, 3); ahead: (T,) bool,
    which way they are turned. A few that are not may be among them."""
    middle, scale = scene.bounds.mean(axis=0), max(scene.diagonal, 1e-300)
    triangle, number, also, near = np.flatnonzero(scene.solid), [], [], []
    for part in runs(len(triangle)):
        own = triangle[part]
        up, place = (
            by_coordinate(rows_of(a, b)) for a, b in ((normal, own), (scene.vertices, scene.triangles[own, 0]))
        )
        away = dot(place - middle, up)
        away *= 1.0 / (scale * PLACE_BIN)
        plane = np.stack([*(up.T / NORMAL_BIN), away])
        plane *= np.where(ahead[own], 1.0, -1.0)
        plane += ASIDE
        number.append(_number(plane))
        # Bins beside its own are also those of a triangle that is turned one way, where they are very near.
        row = np.flatnonzero(ahead[own])
        plane, first = plane[:, row], part.start
        for k, reach in enumerate(REACH):
            for step in (-reach, reach):
                beside = np.flatnonzero(np.floor(plane[k] + step) != np.floor(plane[k]))
                moved = plane[:, beside]
                moved[k] += step
                plane, row = np.concatenate([plane, moved], axis=1), np.append(row, row[beside])
        also.append(_number(plane))
        near.append(row + first)
    number, also, near = (np.concatenate([np.zeros(0, np.int64), *parts]) for parts in (number, also, near))
    behind = np.flatnonzero(~ahead[triangle])
    # Of most, a small table tells that there are none in their bin, and nothing need be sorted.
    for share in (shared, np.isin):
        there, here = share(also, number[behind]), share(number[behind], also)
        also, near, behind = also[there], near[there], behind[here]
    result = np.zeros(len(normal), bool)
    result[triangle[near]] = result[triangle[behind]] = True
    return result


def shared(values, others):
    """(K,) bool: values (K,) that may be among others (N,), integers; all that are, and by chance a few that are not."""
    size = 1 << int(SPARSE * max(len(others), 1)).bit_length()
    table = np.zeros(size, bool)
    table[others % size] = True
    return table[values % size]


def _number(bins):
    """(K,) int64 one number, spread out, for the bins of which places (4, K) are."""
    number = np.zeros(bins.shape[1], np.int64)
    for row in np.floor(bins):
        number *= SPREAD
        number += row.astype(np.int64)
    number ^= number >> 29
    return number & MOST


def _inside(scene, cells, pairs, place, normal):
    """(K,) bool: whether the inside of a solid is behind places on faces: nothing but backs of faces can be seen there. Where
    two faces touch either may be met, and neither tells."""
    local, inside = hemisphere(*lattice(RAYS)), np.zeros(len(place), bool)
    parts = runs(len(place), RAYS, TASK_RAYS)

    def rays():
        """What looks for the inside, a task for each part of the places."""
        for part in parts:
            behind = -normal[part]
            start, frame = place[part] + TOUCH * scene.diagonal * behind, np.stack([*tangents(behind), behind], axis=1)
            direction = np.einsum("nj,kjd->knd", local, frame).reshape(-1, 3)
            yield dict(position=start.repeat(RAYS, axis=0), normal=behind.repeat(RAYS, axis=0), direction=direction)

    for part, found in zip(parts, cells.flow("met", rays())):
        untold, back = found["facing"].any(axis=1), found["back"]
        untold[untold] = pairs.against(found["place"][untold], found["facing"][untold])
        front, back = ((told & ~untold).reshape(-1, RAYS).any(axis=1) for told in (~back, back))
        inside[part] = back & ~front
    return inside
