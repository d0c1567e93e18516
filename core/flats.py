"""Emitting faces as flat convex polygons, the shape that light is sampled from.

Owns which faces emit light and which of them are sampled: what lies in one plane is merged, what is bent or has a hole
is cut into triangles, and of too many the strongest are taken, or none.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .graphs import components
from .sampling import tangents
from .vectors import counted, cross, dot, numbered

MOST_SOURCES = 32  # that are tested one by one
MOST_FLATS = 1 << 16  # if there are more emitting faces, all but the strongest are found by the gather rays,
MOST_POWER = 0.5  # and these too if they do not give such a share of the light: rays must find it anyway
MOST_MERGED = 1 << 15  # emitting polygons beyond this number are not merged into flat ones
WARPED = 1e-3  # of the root of its area that a polygon's corners may be out of its plane
STRAIGHT = 1e-6  # of its area: a polygon's corner turns at least so much


class Flats(NamedTuple):
    """S flat convex polygons that emit light, the strongest first. corner: (C, 3) the corners of one after the other [m].
    sides: (S,) how many each has. exitance: (S, 3) [W/m^2]. polygon: (S,) of the scene, the first that each stands for."""

    corner: np.ndarray
    sides: np.ndarray
    exitance: np.ndarray
    polygon: np.ndarray


def emitting_polygons(scene):
    """(K,) polygons that emit light and have an area."""
    bright = np.array([max(m.exitance) > 0 for m in scene.materials], bool)[scene.polygon_material]
    if scene.readings is not None:
        bright[scene.triangle_polygon[scene.readings.triangle[scene.readings.exitance.max(axis=1) > 0]]] = True
    whole = np.zeros(len(bright), bool)
    whole[scene.triangle_polygon[scene.usable]] = True
    return np.flatnonzero(bright & whole)


def folded_polygons(scene):
    """(P,) bool: polygons that fold over themselves, as a bow tie does, so that some of their triangles are turned. As sources
    they would shine twice where they lie on themselves; rays find them once."""
    triangle, folded = np.flatnonzero(scene.usable), np.zeros(len(scene.polygon_material), bool)
    owner = scene.triangle_polygon[triangle]
    turned = dot(scene.triangle_normal_area[0][triangle], scene.polygon_normal[owner]) <= 0
    folded[owner[turned]] = True
    return folded


def emitting_flats(scene):
    """The Flats of a scene whose light is even, and which polygons (P,) bool they stand for: what lies in one plane is one
    of them, if it is convex; else each polygon, or each triangle of it. If there are too many, only the strongest are
    among them, or none."""
    exitance = np.array([m.exitance for m in scene.materials], float).reshape(-1, 3)
    exitance *= np.array([m.alpha for m in scene.materials], float).reshape(-1, 1)
    even = np.array([m.alpha_texture is None for m in scene.materials], bool)
    glows = ((exitance > 0).any(axis=1) & even)[scene.polygon_material] & ~_read(scene)
    if not glows.any():  # to look at all polygons all the same would be a fiftieth of a small bake
        nothing = Flats(np.zeros((0, 3)), np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0, np.int64))
        return nothing, np.zeros(len(glows), bool)
    glows &= ~folded_polygons(scene)
    triangle = np.flatnonzero(scene.usable & glows[scene.triangle_polygon])
    owner, size = scene.triangle_polygon[triangle], scene.triangle_normal_area[1][triangle]
    area = np.bincount(owner, size, len(glows))
    emitting = np.flatnonzero(area > 0)
    # A polygon that is out of its plane fills less than its triangles' areas say.
    once = dot(scene.triangle_normal_area[0][triangle], scene.polygon_normal[owner]) * size
    filled = emitting[np.bincount(owner, once, len(glows))[emitting] > 0.999 * area[emitting]]
    shapes = _merged(scene, filled, area) if len(filled) <= MOST_MERGED else []
    filled = np.setdiff1d(filled, np.concatenate([filled[:0], *(g for g, _ in shapes)]))
    square = _squares(scene, filled, area[filled])
    single = np.flatnonzero(~np.isin(owner, np.concatenate([square, *(g for g, _ in shapes)])))
    # The part of each polygon: what is one flat, or triangles of one polygon.
    part = np.arange(len(glows))
    for group, _ in shapes:
        part[group] = group[0]
    power = np.bincount(part, area * exitance[scene.polygon_material].sum(axis=1), len(glows))
    strongest = np.lexsort((np.arange(len(power)), -power))
    count = len(shapes) + len(square) + len(single)
    rank, chosen = np.empty(len(power), np.int64), len(power)
    rank[strongest] = np.arange(len(power))
    if count > MOST_FLATS:
        chosen = MOST_SOURCES if power[strongest[:MOST_SOURCES]].sum() >= MOST_POWER * power.sum() else 0

    polygon = np.concatenate([[g[0] for g, _ in shapes], square, owner[single]]).astype(np.int64)
    sides = np.array([*(len(c) for _, c in shapes), *[4] * len(square), *[3] * len(single)], np.int64)
    corner = (scene.polygon_start[square, None] + np.arange(4)).reshape(-1)
    corners = [scene.vertices[scene.corner_vertex[corner]], scene.vertices[scene.triangles[triangle[single]]]]
    corner = np.concatenate([*(c for _, c in shapes), *(c.reshape(-1, 3) for c in corners)])
    order = np.argsort(rank[part[polygon]], kind="stable")
    order = order[rank[part[polygon[order]]] < chosen]
    polygon, first = polygon[order], (np.cumsum(sides) - sides)[order]
    owner, number = counted(sides[order])
    flats = Flats(corner[first[owner] + number], sides[order], exitance[scene.polygon_material[polygon]], polygon)
    sampled = np.zeros(len(glows), bool)
    sampled[emitting] = rank[part[emitting]] < chosen
    return flats, sampled


def _merged(scene, polygons, area):
    """The convex shapes that some of polygons (K,) fill together, or one of many corners alone: a list of the polygons
    (k,) and the corners (V, 3) of each. area: (P,) of all polygons."""
    sides = np.diff(scene.polygon_start)
    groups = [g for g in _coplanar_groups(scene, polygons) if len(g) > 1 or sides[g[0]] > 4]
    shapes = [(g, _outline(_corners(scene, g), scene.polygon_normal[g[0]], area[g].sum())) for g in groups]
    return [(g, corners) for g, corners in shapes if corners is not None]


def _read(scene):
    """(P,) bool: polygons whose light was read place by place."""
    read = np.zeros(len(scene.polygon_material), bool)
    if scene.readings is not None:
        read[scene.triangle_polygon[scene.readings.triangle]] = True
    return read


def _corners(scene, polygons):
    """(C, 3) the corners of polygons (K,)."""
    corner = np.concatenate([np.arange(*scene.polygon_start[p : p + 2]) for p in polygons])
    return scene.vertices[scene.corner_vertex[corner]]


def _squares(scene, polygons, area):
    """Those of polygons (K,), of areas (K,), that have four corners in a plane and are convex."""
    four = np.diff(scene.polygon_start)[polygons] == 4
    polygons, area = polygons[four], area[four]
    corner = scene.vertices[scene.corner_vertex[scene.polygon_start[polygons, None] + np.arange(4)]]
    normal = scene.polygon_normal[polygons][:, None]
    side = np.roll(corner, -1, axis=1) - corner
    turn = dot(cross(side, np.roll(side, -1, axis=1)), normal)
    level = np.abs(dot(corner - corner[:, :1], normal)).max(axis=1, initial=0.0) <= WARPED * np.sqrt(area)
    return polygons[level & (turn > STRAIGHT * area[:, None]).all(axis=1)]


def _coplanar_groups(scene, polygons):
    """Polygons (K,) of one object, material and plane that are joined by vertices, as a list of arrays (k,)."""
    if not len(polygons):
        return []
    size = np.diff(scene.polygon_start)[polygons]
    owner = np.repeat(np.arange(len(polygons)), size)
    corner = np.arange(len(owner)) + np.repeat(scene.polygon_start[polygons] - np.cumsum(size) + size, size)
    place = (scene.vertices[scene.corner_vertex[corner]] - scene.bounds[0]) / max(scene.diagonal, 1e-300)
    n = scene.polygon_normal[polygons]
    level = np.einsum("kd,kd->k", place[np.cumsum(size) - size], n)
    alike = np.column_stack(
        [scene.polygon_object[polygons], scene.polygon_material[polygons], n.round(4), level.round(5)]
    )
    joint = numbered(np.column_stack([numbered(alike)[owner], place.round(6)]))
    label = components(owner, len(polygons) + joint, len(polygons) + int(joint.max()) + 1)[: len(polygons)]
    order = np.argsort(label, kind="stable")
    return np.split(polygons[order], np.flatnonzero(np.diff(label[order])) + 1)


def _outline(corners, normal, area):
    """The convex polygon (V, 3) that coplanar polygons with these corners (C, 3) fill, or None if they leave gaps."""
    frame = np.stack(tangents(normal))
    flat = np.einsum("kd,ad->ka", corners - corners[0], frame)
    order = np.lexsort((flat[:, 1], flat[:, 0]))
    chain = _half_hull(flat, order)[:-1] + _half_hull(flat, order[::-1])[:-1]
    x, y = flat[chain].T
    hull = 0.5 * abs((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())
    warped = np.abs(np.einsum("kd,d->k", corners - corners[0], normal)).max() > WARPED * np.sqrt(hull)
    return None if warped or abs(hull - area) > 1e-3 * hull else corners[chain]


def _half_hull(flat, order):
    """Indices of the lower (or, in reversed order, upper) half of the convex hull of points (C, 2) (Andrew 1979)."""
    hull = []
    for k in order:
        while len(hull) > 1:
            (ax, ay), (bx, by) = flat[hull[-1]] - flat[hull[-2]], flat[k] - flat[hull[-2]]
            if ax * by - ay * bx > 1e-9 * (abs(ax) + abs(ay)) * (abs(bx) + abs(by)):
                break
            hull.pop()
        hull.append(k)
    return hull
