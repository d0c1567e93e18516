"""How much of the light is reflected, and how evenly it falls: a look at a few places, before there are patches.

What patches average away is an error of reflected light alone. Where sun and sky give nearly all of it, or lamps light all
faces about alike, patches may be larger for the same error of the whole, and their rows shorter.
"""

from __future__ import annotations

import numpy as np

from .lights import BALL, FLAT, make_sources, unoccluded
from .points import face_normals, smooth_vertices
from .records import to_arrays
from .sampling import R4, R5, fraction, hemisphere, scatter, tangents
from .sky import cells_of, split_sky
from .vectors import by_coordinate, ratio, rows_of

COMMON = 0.5  # of the light of common interiors is reflected: what is taken where nobody looks
PLACES = 1024  # that are looked at
EVENNESS = 64  # sources at most that are looked at, to see how evenly light falls,
PAIRS = 4096  # of one of them and a place
INSIDE = 0.998  # how far toward its rim rays set out from a face
FEW = 20.0  # rays that met lit places: of fewer, the light may come from a few spots, and more of it than was seen
SALT = 29  # of the samples


def indirect_share(scene, returned, cells, back=False):
    """About how much of its light what is written gets by reflection, 0..1 (root mean square); rather too much where
    that comes from few spots. The share of what lies on no edge, if that is larger: narrow things, sunlit slats for one,
    may get most of the light, and what patches miss of the rest would not tell beside it. returned: (M,) the most that
    each material sends on. cells: started with the arrays that rays need. back: of the backs of faces.

    From every place goes a ray, and one more from what it meets; all of them are lit by a source each. A place and the next
    one are near each other in most meshes, so that the product of their light stands for a square, without what chance adds
    to one.
    """
    triangle = _by_area(scene, scene.usable & scene.written[scene.polygon_object[scene.triangle_polygon]], PLACES)
    if not len(triangle):
        return COMMON
    sources, sampled = make_sources(scene)
    number, sky = np.arange(PLACES), np.pi * split_sky(scene.world)[0].mean(axis=1)
    glow = np.array([np.mean(m.exitance) for m in scene.materials])[scene.polygon_material] * ~sampled

    def look(position, normal, direction):
        """What rays meet: where (K,), the places and normals there (K, 3), and (P,) light of sky and glowing faces."""
        (hit,) = cells.take([cells.submit("cast", position=position, normal=normal, direction=direction)])
        met = np.flatnonzero(hit["triangle"] >= 0)
        there = hit["triangle"][met]
        facing = scene.triangle_normal_area[0][there] * np.where(hit["back"][met], -1.0, 1.0)[:, None]
        on = position[met] + scene.diagonal * hit["distance"][met, None].astype(float) * direction[met]
        found = sky[cells_of(direction, int(np.sqrt(len(sky))))]
        found[met] = glow[scene.triangle_polygon[there]]
        return met, there, on, facing, found

    position, normal, direction = face_rays(scene, triangle, number, int(back))
    met, there, on, facing, direct = look(position, normal, direction)
    arriving = look(on, facing, from_faces(facing, *_samples(2, len(met), 1)))[4]
    if len(sources):
        cells.start(to_arrays("sources", sources))
        places, up = np.concatenate([position, on]), np.concatenate([normal, facing])
        (lit,) = cells.take([cells.submit("lit", position=places, normal=up, samples=_samples(3, len(places), 2))])
        direct += lit["light"][:PLACES]
        arriving += lit["light"][PLACES:]
    reflected = np.zeros(PLACES)
    reflected[met] = returned[scene.polygon_material[scene.triangle_polygon[there]]] * arriving
    inner = _inner(scene)[scene.triangle_polygon[triangle]]
    return max(_share(direct[part], reflected[part]) for part in (slice(None), inner))


def _inner(scene):
    """(P,) bool: polygons with a vertex that lies on no crease and no open edge."""
    smooth = smooth_vertices(scene, face_normals(scene))
    polygon = np.repeat(np.arange(len(scene.polygon_object)), np.diff(scene.polygon_start))
    return np.bincount(polygon, smooth[scene.corner_vertex], len(scene.polygon_object)) > 0


def _share(direct, reflected):
    """What reflected light (K,) is of all that arrives at K places, one after the other, as if it went on so."""
    light, count = direct + reflected, np.count_nonzero(reflected)
    if not count:
        return 0.0
    square, part = (max(float((x[1:] * x[:-1]).mean()), 0.0) if len(x) > 1 else 0.0 for x in (light, reflected))
    once = max(np.sqrt(part), float(reflected.mean())) / max(np.sqrt(square), 1e-300)
    often = once / max(1.0 - once, 1e-9)  # what is reflected again is about the same share of that
    return min(often * (1.0 + FEW / (count + 1.0)), 1.0)


def light_contrast(scene):
    """Mean square of what all sources would give faces with nothing in between, over the square of its mean; 1 if there is
    none. A lamp in the middle of a room has 1 to 3, one close to a wall, or a spot, ten times as much. Of many sources some
    are looked at, picked by their strength: light of a few is less even than that of all."""
    sources, _ = make_sources(scene)
    reach = np.select([sources.kind == FLAT, sources.kind == BALL], [sources.areas / np.pi, 1.0], scene.diagonal**2)
    power = sources.strength.mean(axis=1) * reach
    chosen, weight = np.arange(len(sources)), np.ones(len(sources))
    if len(sources) > EVENNESS:
        upto = np.cumsum(power)
        chosen = np.searchsorted(upto, (np.arange(EVENNESS) + 0.5) / EVENNESS * upto[-1], side="right")
        chosen, often = np.unique(chosen, return_counts=True)
        weight[chosen] = often * upto[-1] / EVENNESS / power[chosen]
    triangle = _by_area(scene, scene.usable, PAIRS // max(len(chosen), 1))
    position, normal, _ = face_rays(scene, triangle, np.arange(len(triangle)), 0)
    light = np.zeros(len(triangle))
    for s in chosen:
        light += weight[s] * sources.strength[s].mean() * unoccluded(sources, s, position, normal)
    light = ratio(light, light.max(initial=0.0))  # the square of very little light has no place in float64
    return float((light * light).mean() / light.mean() ** 2) if light.any() else 1.0


def _by_area(scene, chosen, count):
    """Triangles (count,) of the chosen ones (T,) bool, each as often as its area says; none if none is chosen."""
    triangle = np.flatnonzero(chosen)
    if not len(triangle):
        return triangle
    upper = np.cumsum(scene.triangle_normal_area[1][triangle])
    place = (np.arange(count) + 0.5) / count * upper[-1]
    return triangle[np.minimum(np.searchsorted(upper, place, side="right"), len(triangle) - 1)]


def face_rays(scene, triangle, number, side):
    """Position, normal and direction (K, 3) of cosine-distributed rays from triangles (K,), one each."""
    a, b, c = scene.corners_of(triangle)
    normal = by_coordinate(rows_of(scene.triangle_normal_area[0], triangle)) * (1 - 2 * side)
    u, v, s, t = fraction(number[:, None] * np.array(R4) + scatter(np.arange(4) + 4 * side, 13)).T
    # A little inside: rays from the very rim of a face see past its neighbors.
    root, t = np.sqrt(INSIDE * s)[:, None], INSIDE * t[:, None] + (1 - INSIDE) / 2
    position = a + root * (1 - t) * (b - a) + root * t * (c - a)
    return position, normal, from_faces(normal, u, v)


def from_faces(normal, u, v):
    """(K, 3) cosine-distributed directions about normals (K, 3), by u, v (K,) in [0, 1)."""
    local, (t1, t2) = hemisphere(u, v), tangents(normal)
    return local[:, :1] * t1 + local[:, 1:2] * t2 + local[:, 2:] * normal


def _samples(size, count, salt):
    """(size, count) samples in [0, 1)."""
    return fraction(np.arange(count) * R5[:size, None] + scatter(np.arange(size), SALT + salt)[:, None])
