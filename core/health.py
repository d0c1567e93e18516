"""Health: what is wrong with a scene's data, found before anything is computed, and mended.

Owns the record `Finding`, the mending of scenes (after it every number in a scene is finite and every share of light is
one), and the audit of a finished bake. Bad data in one object is left out or lowered and named; it never spoils others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .raycast import OFFSET, RayCaster
from .sampling import fraction, hemisphere, lattice, scatter, tangents
from .scene import following_corners
from .surfaces import LARGEST_REFLECTANCE
from .vectors import by_coordinate, dot, length, rows_of, whole_runs

FARTHEST = 1e15  # coordinates beyond it leave float64 too few digits to be squared, cubed and compared [m]
FAR = 1e9  # nothing is further from the middle than so many times what half of the scene is
SAME = 1e-6  # of the scene's diagonal: places closer than this are one place
BRIGHTEST = 1e30  # more light than this has no place in float64 beside any other [W/m^2]
WALKS, BOUNCES = 64, 24  # of light in a room that may be white all over
IMBALANCE = 1e-3  # share of the emitted power that may be unaccounted for without a word
NO_LIGHT = "it gives no light"  # what became of a lamp that cannot be used
LOST = 0.05  # share of the lamps' power in a closed scene that may not be found without a word


@dataclass(frozen=True)
class Finding:
    """Something wrong with an object's data, and what was done about it."""

    object: str
    finding: str
    action: str


def mend(scene):
    """The scene with all its numbers usable, and what was wrong in its `health`. A mended scene is returned as it is.

    Polygons with a vertex that is not finite or is absurdly far away are left out whole, as are parts without area;
    of polygons that lie on one another one takes part, the brightest; lamps, materials and the world keep within what
    light can be.
    """
    if scene.mended:
        return scene
    findings = list(scene.health)
    scene = _without_broken(scene, findings)
    scene = scene.but(double=_doubles(scene, findings))
    findings += [*_flat_parts(scene), *_turned(scene), *_tiny(scene), *_too_white(scene)]
    if scene.textures:
        uv = np.zeros((len(scene.corner_vertex), 2)) if scene.corner_uv is None else scene.corner_uv
        scene = scene.but(corner_uv=np.where(np.abs(uv) <= FARTHEST, uv, 0.0))
    lamps = tuple(lamp for lamp in scene.lamps if _shines(lamp, findings))
    materials = tuple(_even(_bounded(scene, k, findings), scene.textures) for k in range(len(scene.materials)))
    world = _clear(scene.world, findings)
    return scene.but(lamps=lamps, materials=materials, world=world, health=tuple(findings), mended=True)


def audit(scene, solution, error):
    """Yield findings about a finished transport: power that is unaccounted for, and lamps whose light was not found.

    error: the relative error asked for; sampled rows may leave half of it unbalanced, which the estimate sees.
    """
    energy = solution.energy
    emitted = energy["emitted_w"]
    gap = abs(emitted - energy["absorbed_w"] - energy["escaped_w"] - energy["unshot_w"])
    if not gap <= IMBALANCE * emitted:
        yield Finding("scene", f"{gap:.3g} W of {emitted:.3g} W are unaccounted for", "do not trust this bake")
    elif abs(energy["unshot_w"]) > max(IMBALANCE, error / 2) * emitted:
        share = 100 * energy["unshot_w"] / emitted
        yield Finding("scene", f"{share:.2g} % of the power is not balanced", "a smaller error asks for longer rows")
    landed = direct_check(scene, solution)
    if landed is not None and abs(landed - 1) > LOST:
        yield Finding(
            "lamps", f"{100 * landed:.3g} % of their light was found on surfaces", "a lamp is very near to one of them"
        )


def direct_check(scene, solution):
    """Power of the lamps that landed on surfaces, as a share of what they send; None where it cannot be known: where
    light escapes, comes from a sun, the sky or a surface, or there is none."""
    energy = solution.energy
    glowing = np.array([max(m.exitance) > 0 for m in scene.materials], bool)[scene.polygon_material].any()
    sent = [_sent(lamp) for lamp in scene.lamps if max(lamp.strength) > 0]
    # Where nothing was shot, nothing has been seen to escape: that the scene is closed is not known then.
    unknown = not solution.rounds or not solution.rounds[-1].shots or energy["escaped_w"] > 0
    if unknown or glowing or scene.world.brightest > 0 or None in sent or not sum(sent) > 0:
        return None
    return float(energy["emitted_w"] / sum(sent))


def _sent(lamp):
    """Power that a lamp radiates [W], sum of the channels; None for a sun."""
    strength = float(sum(lamp.strength))
    if lamp.kind == "area":
        return np.pi * strength * abs(lamp.size[0] * lamp.size[1]) * (np.pi / 4 if lamp.ellipse else 1.0)
    if lamp.kind == "spot":
        # Over the soft part the smooth step has a mean of 1/2.
        return 2 * np.pi * strength * (1 - float(np.cos(lamp.angle / 2))) * (1 - lamp.blend / 2)
    return 4 * np.pi * strength if lamp.kind == "point" else None


def _count(scene, polygons):
    """(object's name, how many) of polygons (P,) bool, for each object that has any."""
    count = np.bincount(scene.polygon_object[polygons], minlength=len(scene.objects))
    return [(scene.objects[o], int(count[o])) for o in np.flatnonzero(count)]


def _faces(count):
    return "1 face" if count == 1 else f"{count} faces"


def _without_broken(scene, findings):
    """The scene with every vertex finite and in reach: the triangles of polygons that have others get no area."""
    with np.errstate(invalid="ignore"):
        finite = np.isfinite(scene.vertices).all(axis=1)
        near = finite & (np.abs(scene.vertices) <= FARTHEST).all(axis=1)
    used = np.zeros(len(near), bool)
    used[scene.corner_vertex] = True
    middle = np.median(scene.vertices[near & used], axis=0) if (near & used).any() else np.zeros(3)
    apart = np.abs(np.where(near[:, None], scene.vertices, middle) - middle).max(axis=1, initial=0.0)
    reach = np.median(apart[near & used]) if (near & used).any() else 0.0
    if reach > 0:
        near &= apart <= FAR * reach
    if near.all():
        return scene
    polygon = np.repeat(np.arange(len(scene.polygon_object)), np.diff(scene.polygon_start))
    broken, far = np.zeros((2, len(scene.polygon_object)), bool)
    broken[polygon[~finite[scene.corner_vertex]]] = True
    far[polygon[~near[scene.corner_vertex]]] = True
    for name, count in _count(scene, broken):
        findings.append(
            Finding(name, f"{_faces(count)} with vertices that are not finite numbers", "they were left out")
        )
    for name, count in _count(scene, far & ~broken):
        findings.append(Finding(name, f"{_faces(count)} with vertices much too far away", "they were left out"))
    corner = np.where(far[scene.triangle_polygon][:, None], scene.triangle_corner[:, :1], scene.triangle_corner)
    normal = np.where(np.isfinite(scene.corner_normal), scene.corner_normal, 0.0)
    vertices = np.where(near[:, None], scene.vertices, middle)
    return scene.but(vertices=vertices, triangle_corner=corner, corner_normal=normal, left_out=far)


def _flat_parts(scene):
    """Findings about polygons that have triangles without an area."""
    flat = np.zeros(len(scene.polygon_object), bool)
    flat[scene.triangle_polygon[~scene.solid]] = True
    for name, count in _count(scene, flat & ~scene.left_out):
        yield Finding(name, f"{_faces(count)} with a part that has no area", "it was left out")


def _doubles(scene, findings):
    """(P,) bool: polygons that lie exactly on another one, which takes part in their place: the brightest, or the first.

    Rays would meet the one or the other by chance.
    """
    double = np.zeros(len(scene.polygon_object), bool)
    size = np.diff(scene.polygon_start)
    triangle = scene.solid
    area = np.bincount(scene.triangle_polygon[triangle], scene.triangle_normal_area[1][triangle], len(size))
    polygon = np.flatnonzero(area > 0)
    if not len(polygon):
        return double
    # What does not depend on where a polygon's corners begin: its middle, and how far they are from it.
    unit = max(scene.diagonal, 1e-300)
    facts = np.empty((len(size), 5))
    for part in whole_runs(scene.polygon_start):
        own, first = size[part], scene.polygon_start[part.start]
        owner = np.repeat(np.arange(len(own)), own)
        place = (
            by_coordinate(rows_of(scene.vertices, scene.corner_vertex[first : first + len(owner)])) - scene.bounds[0]
        )
        middle = np.stack([np.bincount(owner, place[:, k], len(own)) for k in range(3)], axis=1)
        middle /= np.maximum(own, 1)[:, None]
        facts[part, :3] = middle
        facts[part, 3] = np.bincount(owner, length(place - middle[owner]), len(own)) / np.maximum(own, 1)
    facts[:, 4] = np.sqrt(area)
    facts /= unit
    # Few are like others at all: only these are looked at.
    alike = np.zeros(len(polygon), np.uint64)
    for k in range(6):
        values = size[polygon] if k == 5 else np.round(1e4 * facts[polygon, k])
        alike ^= (scatter(values.astype(np.int64) ^ alike.astype(np.int64), k) * 2.0**53).astype(np.uint64)
    order = np.argsort(alike, kind="stable")
    same = alike[order[1:]] == alike[order[:-1]]
    polygon = np.sort(polygon[order[np.append(same, False) | np.append(False, same)]])
    if not len(polygon):
        return double
    normal, light = scene.polygon_normal, np.array([sum(m.exitance) for m in scene.materials])[scene.polygon_material]
    key = np.column_stack([np.round(1e4 * facts[polygon]), size[polygon]])
    rank = np.lexsort((-np.nan_to_num(light[polygon]), *key.T))
    order, key = polygon[rank], key[rank]
    fresh = np.append(True, (key[1:] != key[:-1]).any(axis=1))
    leader = order[np.flatnonzero(fresh)[np.cumsum(fresh) - 1]]
    same = (np.abs(facts[order] - facts[leader]) < SAME).all(axis=1) & (order != leader)
    same &= np.abs(dot(normal[order], normal[leader])) > 1 - SAME
    same &= _same_corners(scene, order, leader, SAME * unit)
    double[order[same]] = True
    for name, count in _count(scene, double):
        findings.append(Finding(name, f"{_faces(count)} exactly on other faces", "they were taken as one sheet"))
    return double


def _same_corners(scene, first, second, gap):
    """(K,) bool: whether every corner of polygons first (K,) lies at one of polygons second (K,) with as many corners."""
    size = np.diff(scene.polygon_start)
    same = np.ones(len(first), bool)
    for n in np.unique(size[first]):
        part = np.flatnonzero((size[first] == n) & (first != second))
        a, b = (
            scene.vertices[scene.corner_vertex[scene.polygon_start[p[part]][:, None] + np.arange(n)]]
            for p in (first, second)
        )
        for k in range(n):
            same[part] &= (np.abs(a[:, k, None] - b).max(axis=2) <= gap).any(axis=1)
    return same


def _turned(scene):
    """Findings about edges whose two polygons run along them in the same direction: one of them is turned round."""
    vertex = scene.corner_vertex
    following = vertex[following_corners(scene.polygon_start)]
    counts = np.flatnonzero(vertex != following)
    edge = vertex[counts].astype(np.int64) * len(scene.vertices) + following[counts]
    ordered = np.sort(edge)
    if not (ordered[1:] == ordered[:-1]).any():
        return
    order = np.argsort(edge, kind="stable")
    again = np.append(False, ordered[1:] == ordered[:-1])
    polygon = np.searchsorted(scene.polygon_start, counts[order], side="right") - 1
    twice = np.bincount(scene.polygon_object[polygon[again]], minlength=len(scene.objects))
    for o in np.flatnonzero(twice):
        yield Finding(
            scene.objects[o],
            f"{twice[o]} edges between faces that look opposite ways",
            "each face is lit on its own front; --side lit takes the brighter side",
        )


def _tiny(scene):
    """Findings about objects so small in their scene that rays start further off than they are large."""
    triangle = np.flatnonzero(scene.solid)
    if not len(triangle):
        return
    owner = np.zeros(len(scene.vertices), np.int32)
    for column in range(3):
        owner[scene.triangles[triangle, column]] = scene.polygon_object[scene.triangle_polygon[triangle]]
    vertex = scene.used_vertices(triangle)
    vertex = vertex[np.argsort(owner[vertex], kind="stable")]
    seen, first = np.unique(owner[vertex], return_index=True)
    place = scene.vertices[vertex]
    size = length(np.maximum.reduceat(place, first) - np.minimum.reduceat(place, first))
    gap = OFFSET * scene.diagonal
    for o, extent in zip(seen[size < 10 * gap], size[size < 10 * gap]):
        yield Finding(
            scene.objects[o],
            f"it is only {extent:.2g} m large in a scene of {scene.diagonal:.2g} m",
            f"light closer than {gap:.1g} m to it is not resolved; move what is far away nearer",
        )


def _too_white(scene):
    """Findings about surfaces that send back all light, or more, where that leaves light no end."""
    most = np.array([max(_numbers(m.reflectance)) + max(_numbers(m.translucency)) for m in scene.materials])
    white = scene.triangle_polygon[scene.usable]
    white = np.unique(white[most[scene.polygon_material[white]] > LARGEST_REFLECTANCE])
    if not len(white):
        return
    closed = _closed_in_white(scene, most >= 1.0)
    for name, _ in _count(scene, np.isin(np.arange(len(scene.polygon_object)), white)):
        o = scene.objects.index(name)
        top = most[scene.polygon_material[white[scene.polygon_object[white] == o]]].max()
        if top > 1.0:
            yield Finding(name, f"a reflectance of {top:.3g}: more light than arrives", "0.999 was taken")
        elif closed[o]:
            yield Finding(name, "a reflectance of 1 in a closed room: its light has no steady state", "0.999 was taken")


def _numbers(values):
    """Values with what is no number at 0."""
    values = np.asarray(values, float)
    return np.where(np.isnan(values), 0.0, values)


def _closed_in_white(scene, white):
    """(O,) bool: objects from which light walks on among surfaces of `white` materials (M,) and of no others, where a
    lamp or a glowing face is seen on the way."""
    closed = np.zeros(len(scene.objects), bool)
    start = np.flatnonzero(scene.usable & white[scene.polygon_material[scene.triangle_polygon]])
    if not len(start):
        return closed
    # Walks start from triangles of each object, on both sides.
    owner = scene.polygon_object[scene.triangle_polygon[start]]
    order = np.lexsort((scatter(start, 7), owner))
    number = np.arange(len(order)) - np.searchsorted(owner[order], owner[order])
    start = np.repeat(start[order][number < WALKS], 2)
    caster = RayCaster(scene.vertices, scene.triangles, scene.usable)
    lamps = [lamp for lamp in scene.lamps if lamp.kind != "sun" and _works(lamp)]
    glows = np.array([max(_numbers(m.exitance)) > 0 for m in scene.materials])
    u, v = lattice(len(start))
    place = scene.vertices[scene.triangles[start]].mean(axis=1)
    normal = scene.triangle_normal_area[0][start] * np.where(np.arange(len(start)) % 2, -1.0, 1.0)[:, None]
    alive, lit = np.arange(len(start)), np.zeros(len(start), bool)
    lit |= glows[scene.polygon_material[scene.triangle_polygon[start]]]
    for bounce in range(BOUNCES):
        origin = caster.start(place, normal)
        for lamp in lamps:
            position = np.asarray(lamp.position, float)
            facing = dot(position - place, normal) > 0
            if lamp.shadows:
                facing &= ~caster.blocked(origin, np.broadcast_to(caster.place(position), origin.shape))
            lit[alive] |= facing
        shift = scatter(alive * 2 + np.array([[0], [1]]), 31 + bounce)
        local = hemisphere(fraction(u[alive] + shift[0]), fraction(v[alive] + shift[1]))
        t1, t2 = tangents(normal)
        direction = local[:, :1] * t1 + local[:, 1:2] * t2 + local[:, 2:] * normal
        hit, a, b, _, back = caster.hits(origin, direction.astype(np.float32))
        on = (hit >= 0) & white[scene.polygon_material[scene.triangle_polygon[hit]]]
        alive, hit, a, b, back = alive[on], hit[on], a[on, None], b[on, None], back[on]
        if not len(alive):
            break
        lit[alive] |= glows[scene.polygon_material[scene.triangle_polygon[hit]]]
        p, q, r = np.moveaxis(scene.vertices[scene.triangles[hit]], 1, 0)
        place = p + a * (q - p) + b * (r - p)
        normal = scene.triangle_normal_area[0][hit] * np.where(back, -1.0, 1.0)[:, None]
    # An object is closed in if no walk that began at one side of it has ended, and light was seen on one of them.
    owner = scene.polygon_object[scene.triangle_polygon[start]]
    closed[owner[alive[lit[alive]]]] = True
    return closed


def _works(lamp):
    numbers = np.concatenate([np.ravel(x) for x in (lamp.strength, lamp.position, lamp.axes, lamp.size)])
    numbers = np.append(numbers, [lamp.radius, lamp.angle, lamp.blend]).astype(float)
    near = np.abs(lamp.position).max() <= FARTHEST and np.abs(lamp.size).max() <= FARTHEST and lamp.radius <= FARTHEST
    return bool(np.isfinite(numbers).all()) and bool(near) and max(lamp.strength) <= BRIGHTEST


def _shines(lamp, findings):
    """Whether a lamp can be used; if not, that is found."""
    if not _works(lamp):
        findings.append(Finding(lamp.name, "a lamp with values that are no numbers, or beyond all measure", NO_LIGHT))
        return False
    if min(lamp.strength) < 0:
        findings.append(Finding(lamp.name, "a lamp of negative strength", NO_LIGHT))
        return False
    return True


def _bounded(scene, k, findings):
    """Material k of a scene with no share below 0 and all its light finite."""
    material = scene.materials[k]
    fixed = {}
    for name in ("reflectance", "translucency", "exitance", "tint"):
        values = np.asarray(getattr(material, name), float)
        good = np.where(np.isnan(values), 0.0, np.maximum(values, 0.0))
        if name == "exitance":
            good = np.where(good <= BRIGHTEST, good, 0.0)
        good = np.minimum(good, BRIGHTEST)
        if not np.array_equal(good, values):
            fixed[name] = tuple(map(float, good))
    if not 0.0 <= material.alpha <= 1.0:
        fixed["alpha"] = 0.0 if material.alpha < 0.0 else 1.0
    # Reflectances far above 1 are found where they are bounded.
    far = {n for n in fixed if n != "exitance" and (np.asarray(getattr(material, n), float) > BRIGHTEST).all()}
    bad = [n for n in fixed if n != "tint" and n not in far]
    if bad and (scene.polygon_material == k).any():
        what = ", ".join(bad)
        text = f"a material with values that are negative, no numbers, or beyond all measure: {what}"
        findings.append(Finding(material.name, text, "0 was taken"))
    return replace(material, **fixed)


def _even(material, textures):
    """The material with an image of how much of it is there as one share, where that is the same all over: mostly 1, in files
    that have a channel for it."""
    if material.alpha_texture is None:
        return material
    share = textures[material.alpha_texture].pixels[..., 0]
    if not share.size or share.min() != share.max():
        return material
    return replace(material, alpha=material.alpha * min(max(float(share.max()), 0.0), 1.0), alpha_texture=None)


def _clear(world, findings):
    """The world, black in channels that are negative or not finite."""
    radiance = np.asarray(world.radiance if world.map is None else world.map, float)
    good = np.where(radiance <= BRIGHTEST, np.maximum(radiance, 0.0), 0.0)
    if np.array_equal(good, radiance):
        return world
    findings.append(Finding("world", "its light is negative or not a finite number", "0 was taken"))
    return replace(world, radiance=tuple(map(float, good))) if world.map is None else replace(world, map=good)
