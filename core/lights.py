"""Direct light: lamps and flat emitting faces as sources, and test rays toward one of them at a time.

Owns the record `Sources`, the exact irradiance of an unobstructed source, and the test rays that find how much of it is
visible. Lamps never block rays; emitting faces do.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from time import thread_time

import numpy as np

from .flats import emitting_flats
from .polygons import polygon_factor
from .sampling import fraction, lattice, tangents
from .sky import split_sky
from .vectors import (
    TINY,
    by_coordinate,
    cross,
    dot,
    from_coordinates,
    length,
    ratio,
    runs,
    take,
    unit,
)

# Kinds of source: a flat polygon, a point or spot lamp, a sun, a group of bright directions of the sky.
FLAT, BALL, SUN, SKY = 0, 1, 2, 3
SLANT = 0.05  # least cosine that a flat source is picked with: its middle may be hidden by the horizon, its rim not
NEAR = 0.08  # a patch is near a source if it reaches further than this share of the distance to it
SHORT = 1 - 1e-5  # share of the way to a lamp that must be free: one that lies in a surface lights both of its sides
NARROW_PLACES = 144  # on a lamp of limited spread that its light is summed over
FULL_SPREAD = 1.5697  # half angle beyond which a lamp shines in all directions alike [rad]
LEAST_SPREAD = 1e-3  # half angle of the narrowest beam [rad]
DISK_PLACES = 32  # on a spot's disk that its cone is averaged over
CLOSE = 0.3  # a source that fills more than this share of a hemisphere's unit disk is close: its exact factor is taken
DISK_SIDES = 24  # of the polygon, equal in area, that stands for a disk or ellipse


@dataclass(frozen=True)
class Sources:
    """S sources of direct light.

    kind: (S,) int8. position: (S, 3) center.
    strength: (S, 3) exitance of a FLAT [W/m^2], intensity of a BALL [W/sr], irradiance of a surface that faces a SUN or
        SKY [W/m^2].
    direction: (S, 3) unit, the way it shines (a FLAT's normal). two_sided: (S,) bool, a FLAT shines to both sides.
    radius: (S,) of a BALL [m], or sine of the half angle of a SUN, or of each direction of a SKY.
    soft: (S,) bool, a BALL is a disk that faces the receiver.
    cone: (S, 2) cosine of a spot's half angle (-1: no cone) and its blend; of a FLAT that does not shine in all
        directions alike the tangent of half its spread (-1: it does) and a factor.
    corner_start: (S + 1,) int32 where the corners of each begin in corner: (C, 3), convex polygons of the FLAT ones, and
        unit vectors toward the directions of the SKY ones.
    origin: (S,) int32 number of the lamp, -1 for the sky, -2 - o for faces of object o.
    shadows: (S,) bool, things that stand before it cast some.
    """

    kind: np.ndarray
    strength: np.ndarray
    position: np.ndarray
    direction: np.ndarray
    two_sided: np.ndarray
    radius: np.ndarray
    soft: np.ndarray
    cone: np.ndarray
    corner_start: np.ndarray
    corner: np.ndarray
    origin: np.ndarray
    shadows: np.ndarray

    def __len__(self):
        return len(self.kind)

    def one_channel(self):
        """The Sources of a scene without color: one channel, the mean of all."""
        return replace(self, strength=self.strength.mean(axis=1, keepdims=True))

    def only(self, chosen):
        """The Sources that are chosen, (S,) bool."""
        size, own = np.diff(self.corner_start)[chosen], np.repeat(chosen, np.diff(self.corner_start))
        kept = {f.name: getattr(self, f.name)[chosen] for f in fields(self) if not f.name.startswith("corner")}
        return Sources(**kept, corner_start=_starts(size), corner=self.corner[own])

    @cached_property
    def areas(self):
        """(S,) areas of FLAT sources [m^2]; 0 of others."""
        return np.where(self.kind == FLAT, length(_vector_areas(self.corner_start, self.corner)), 0.0)

    @cached_property
    def reaches(self):
        """(S,) how far FLAT sources reach from their centers [m]; 0 of others."""
        reach = np.zeros(len(self))
        owner = np.repeat(np.arange(len(self)), np.diff(self.corner_start))
        np.maximum.at(reach, owner, length(self.corner - self.position[owner]))
        return np.where(self.kind == FLAT, reach, 0.0)

    def polygon(self, s):
        """(V, 3) corners of FLAT source s."""
        return self.corner[self.corner_start[s] : self.corner_start[s + 1]]


def make_sources(scene, shut=None):
    """The Sources of a scene, and which of its polygons they stand for: (P,) bool. shut: (P,) bool, emitting polygons whose
    backs nothing is seen from that matters; None: none of them.

    An emitting polygon that is not among them is light that rays find by hitting it.
    """
    found = [_from(k, lamp, _of_lamp(lamp)) for k, lamp in enumerate(scene.lamps) if max(lamp.strength) > 0]
    found += [
        _source(SKY, g.irradiance, (0,) * 3, -unit(g.directions.mean(axis=0)), radius=g.spread, corners=g.directions)
        for g in split_sky(scene.world)[1]
    ]
    flats, sampled = emitting_flats(scene)
    faces = flat_sources(flats.corner, flats.sides, flats.exitance, scene.polygon_object[flats.polygon])
    if shut is not None:
        faces = replace(faces, two_sided=~shut[flats.polygon])
    return join_sources([*found, faces]), sampled


def lamp_power(lamp):
    """Power of a lamp [W], in its brightest channel; of a sun what it gives a square meter that faces it."""
    strength = float(max(lamp.strength))
    if lamp.kind == "area":
        return np.pi * strength * lamp.size[0] * lamp.size[1] * (np.pi / 4 if lamp.ellipse else 1.0)
    if lamp.kind == "spot":
        return 2 * np.pi * (1.0 - float(np.cos(lamp.angle / 2))) * strength
    return strength if lamp.kind == "sun" else 4 * np.pi * strength


def lamp_outline(lamp):
    """Corners (V, 3) around a lamp [m], and None; of a sun the sine of its half angle, and the direction (3,) to it."""
    x, y, z = np.asarray(lamp.axes, float)
    if lamp.kind == "sun":
        return float(np.sin(min(lamp.angle, np.pi) / 2)), z
    signs = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], float)
    half = (lamp.size[0] / 2, lamp.size[1] / 2, 0.0) if lamp.kind == "area" else (lamp.radius,) * 3
    return np.asarray(lamp.position, float) + np.einsum("vk,kd->vd", signs * half, np.stack([x, y, z])), None


def unoccluded(sources, s, position, normal):
    """(K,) irradiance per unit of strength that source s would give points with nothing in between."""
    kind, position, normal = sources.kind[s], by_coordinate(position), by_coordinate(normal)
    if kind == SUN:
        return np.maximum(-dot(normal, sources.direction[s]), 0.0)
    if kind == SKY:
        rise = dot(normal[:, None], sources.polygon(s))
        return np.einsum("kj->k", np.ascontiguousarray(np.maximum(rise, 0.0))) / rise.shape[1]
    if kind == FLAT and sources.cone[s, 0] > 0:
        return _narrow_factor(sources, s, position, normal)
    if kind == FLAT:
        factor = polygon_factor(position, normal, sources.polygon(s))
        if not sources.two_sided[s]:
            factor *= dot(position - sources.position[s], sources.direction[s]) > 0
        return factor
    toward = sources.position[s] - position
    square = dot(toward, toward)
    distance = np.sqrt(square)
    radius = sources.radius[s]
    cosine = ratio(dot(toward, normal), distance)
    spread = square + radius * radius if sources.soft[s] else np.maximum(square, radius * radius)
    factor = ratio(np.maximum(cosine, 0.0), spread)
    if radius > 0:
        # A disk that the horizon cuts: Lambert's factor of the part above it.
        cut = np.abs(cosine) * np.sqrt(square + radius * radius) < radius
        if cut.any():
            disk = _facing_disk(sources.position[s], toward[cut], radius)
            factor[cut] = polygon_factor(position[cut], normal[cut], disk) / radius**2
    if sources.cone[s, 0] > -1:
        lit = np.flatnonzero(factor)
        factor[lit] *= _cone_share(sources, s, position[lit], normal[lit])
    return factor


def from_one_test(sources, s, position, normal, seen, a):
    """(K,) irradiance per unit of strength that points get from source s by one test ray each, of weight `seen` (K,), to
    the place a (K,).

    The place that was tested stands for the whole source, so that shadow, distance and cone keep their correlation. Only
    close to a polygon, where one place says little of the others, its exact factor is taken, which costs far more.
    """
    kind, radius = sources.kind[s], sources.radius[s]
    if kind not in (FLAT, BALL) or (kind == BALL and radius == 0):
        return unoccluded(sources, s, position, normal) * (seen > 0)
    toward = sources.position[s] - position
    square = dot(toward, toward)
    if kind == BALL:
        distance, reach = np.sqrt(square), square + radius * radius
        spread = reach if sources.soft[s] else np.maximum(square, radius * radius)
        cut = dot(toward, normal) ** 2 * reach < square * radius * radius  # the horizon cuts the disk
        return np.where(
            cut, distance * ratio(seen, (square + radius * radius * a) ** 2), ratio(seen, distance * spread)
        )
    height, area = -dot(toward, sources.direction[s]), sources.areas[s]
    factor = seen * np.abs(height) * area / np.pi
    if not sources.two_sided[s]:
        factor = np.where(height > 0, factor, 0.0)
    close = np.flatnonzero((area >= CLOSE * np.pi * square) & (seen > 0))
    if len(close):
        factor[close] = unoccluded(sources, s, position[close], normal[close])
    return factor


def unlike(sources, s, position):
    """(K,) bool: whether the parts of source s do not all shine toward points as strongly: where the rim of a spot's cone
    crosses its disk, and everywhere if it is a flat one of limited spread."""
    edge, blend = sources.cone[s]
    if sources.kind[s] != BALL or edge <= -1:
        return np.full(len(position), sources.kind[s] == FLAT and edge > 0)
    toward, radius = sources.position[s] - position, sources.radius[s]
    square = dot(toward, toward)
    along = -dot(toward, sources.direction[s])
    across = radius * np.sqrt(np.maximum(ratio(square - along * along, square), 0.0))
    reach = np.sqrt(square + radius * radius)
    whole = along - across >= (edge + (1.0 - edge) * blend) * reach
    none = (along + across <= edge * reach) & (along * reach < square)  # and the axis does not meet the disk
    return ~(whole | none)


def _cone_share(sources, s, position, normal):
    """(K,) share of a spot's light toward points that its cone lets through."""
    toward, radius = sources.position[s] - position, sources.radius[s]
    share = _in_cone(sources, s, toward)
    if radius == 0:
        return share
    # Each part of the disk shines by its own place in the cone. Most points see the whole disk, or nothing of it, in full
    # light, as they see its center: the others alone have their places looked at, which takes thirty times as long.
    mixed = np.flatnonzero(unlike(sources, s, position))
    place = by_coordinate(position[mixed, None])
    each = _on_disk(sources, s, place, *lattice(DISK_PLACES)) - place
    weight = np.maximum(dot(each, normal[mixed, None]), 0.0)
    inside = weight * _in_cone(sources, s, each)
    share[mixed] = ratio(*(np.einsum("kj->k", np.ascontiguousarray(x)) for x in (inside, weight)))
    return share


def likely_light(sources, s, position, normal):
    """(K,) roughly what source s may give points, to pick sources by; positive unless it can give nothing."""
    strength = sources.strength[s].mean()
    if sources.kind[s] not in (FLAT, BALL):
        return strength * unoccluded(sources, s, position, normal) + TINY
    toward = sources.position[s] - position
    if sources.kind[s] == BALL:  # its cone is left out: what a wide one gives takes long to know
        square = dot(toward, toward)
        least = SLANT if sources.radius[s] > 0 else 0.0
        rise = np.maximum(ratio(dot(toward, normal), np.sqrt(square)), least)
        return strength * ratio(rise, square + sources.radius[s] ** 2) + TINY
    square = dot(toward, toward)
    distance, area = np.sqrt(square), sources.areas[s]
    rise = np.maximum(ratio(dot(toward, normal), distance), SLANT)
    tilt = ratio(-dot(toward, sources.direction[s]), distance)
    tilt = np.abs(tilt) if sources.two_sided[s] else tilt
    reach = np.pi * square + area
    return np.where(tilt > -SLANT, strength * area * rise * np.maximum(tilt, SLANT) / reach, 0.0) + TINY


def patch_irradiance(sources, caster, centroid, position, normal, a, b, shadowed):
    """(K, C) mean direct irradiance [W/m^2] of K patches, from their centroids (K, 3) and places (K, n, 3) on them;
    (K,) bool, patches so near a source, on the rim of its beam, or so curved, that their places do not all get the same;
    and of the brightest source that lights each in part, as the test rays tell: its number (K,) int16, -1 for none, the
    mean irradiance (K,) per unit of its strength, and the irradiance (K,) [W/m^2] that it would give with nothing in
    between.

    From each place one test ray goes to the place a, b (K, n) of every source. normal: (K, 1 or n, 3) at the places; the
    centroids take the first one. A source gives Lambert's
    exact factor times the visible share, sum(weight seen) / sum(weight) over the test rays: with weights left out, or
    a single ray, a source seen at a grazing angle comes out too dark. shadowed: (S,) bool, sources before which something may
    stand; toward others no ray is needed.
    """
    count, places = a.shape
    total = np.zeros((count, sources.strength.shape[1]))
    start = caster.start(position, normal)
    normal = np.broadcast_to(normal, position.shape)
    curved = (normal != normal[:, :1]).any(axis=(1, 2))
    spread = length(position - centroid[:, None]).max(axis=1)
    uneven = np.zeros(count, bool)
    partly, mean, whole = np.full(count, -1, np.int16), np.zeros(count), np.zeros(count)
    for s in range(len(sources)):
        factor = unoccluded(sources, s, centroid, normal[:, 0])
        differs = curved
        if sources.kind[s] not in (SUN, SKY):
            differs = curved | (spread > NEAR * _distance(sources, s, centroid)) | _on_rim(sources, s, centroid, spread)
        near = np.flatnonzero(differs)
        if len(near):
            each = unoccluded(sources, s, position[near].reshape(-1, 3), normal[near].reshape(-1, 3))
            factor[near] = np.einsum("kn->k", each.reshape(-1, places)) / places
            uneven[near] |= factor[near] > 0
        lit = np.flatnonzero(factor > 0)
        if not len(lit):
            continue
        if not shadowed[s]:
            total[lit] += factor[lit, None] * sources.strength[s]
            continue
        tested = thread_time()
        place, each, origin = (x[lit].reshape(-1, 3) for x in (position, normal, start))
        weight, seen = test_rays(sources, s, caster, place, each, each, origin, a[lit].reshape(-1), b[lit].reshape(-1))
        share = ratio(*(np.einsum("kn->k", x.reshape(-1, places)) for x in (seen, weight)))
        caster.note("occlusion", tested)
        total[lit] += (factor[lit] * share)[:, None] * sources.strength[s]
        most = factor[lit] * sources.strength[s].max()
        cut = (share > 0) & (share < 1) & (most > whole[lit])
        partly[lit[cut]], mean[lit[cut]], whole[lit[cut]] = s, (factor[lit] * share)[cut], most[cut]
    return total, uneven, (partly, mean, whole)


def _on_rim(sources, s, center, reach):
    """(K,) bool: whether the rim of the beam of source s, where light falls off, may cross what lies within reach (K,) of
    centers (K, 3): these say little of the mean there."""
    outer, blend = sources.cone[s]
    flat = sources.kind[s] == FLAT
    if outer <= (0 if flat else -1):
        return np.zeros(len(center), bool)
    if flat:  # the tangent of its half angle
        outer, blend = 1.0 / np.sqrt(1.0 + outer * outer), 0.0
    inner = outer + (1.0 - outer) * blend
    away = center - sources.position[s]
    distance = length(away)
    # Cosines of angles to the axis: of the center, and of the nearest and furthest place around it.
    rise = np.clip(ratio(dot(away, np.broadcast_to(sources.direction[s], away.shape)), distance), -1.0, 1.0)
    sine = np.minimum(ratio(reach + sources.radius[s] + sources.reaches[s], distance), 1.0)
    along, across = rise * np.sqrt(1.0 - sine * sine), np.sqrt(1.0 - rise * rise) * sine
    on_axis = (rise > 0) & (rise * rise + sine * sine >= 1.0)
    return (sine >= 1.0) | ((on_axis | (along + across > outer)) & (along - across < inner))


def test_rays(sources, s, caster, position, normal, geometric, start, a, b):
    """Weights (K,) of K test rays toward source s, and the same where the ray gets there, 0 where it is blocked.

    position, normal, geometric: (K, 3) where each ray starts, the axis of its hemisphere and the surface's own normal;
    start: (K, 3) float32, the position as the caster wants it; a, b: (K,) in [0, 1), the place on the source it goes to.
    A weight is proportional to what reaches the position from there; it is 0 below either horizon. Nothing blocks the rays to
    a source that casts no shadows, so none is traced.
    """
    begun, endless = thread_time(), sources.kind[s] in (SUN, SKY)
    level = geometric is normal
    position, normal = by_coordinate(position), by_coordinate(normal)
    if endless:
        toward = (_sun_directions if sources.kind[s] == SUN else _sky_directions)(sources, s, a, b)
        weight = dot(toward, normal)
    else:
        aim = _on_polygon(sources.polygon(s), a, b) if sources.kind[s] == FLAT else _on_disk(sources, s, position, a, b)
        toward = aim - position
        # Equal parts of the source give cos cos' / r^2, with cos' = height / r on a flat one.
        weight = dot(toward, normal)
        if sources.kind[s] == BALL and sources.radius[s] > 0 and sources.cone[s, 0] > -1:
            weight = weight * _in_cone(sources, s, toward)
        if sources.kind[s] == FLAT:
            square = dot(toward, toward)
            weight /= np.maximum(square * square, 1e-300)
            if sources.cone[s, 0] > 0:
                weight = weight * _narrowed(sources, s, ratio(-dot(toward, sources.direction[s]), np.sqrt(square)))
    weight = np.maximum(weight, 0.0)
    if not level:
        weight = np.where(dot(toward, by_coordinate(geometric)) > 0, weight, 0.0)
    if not sources.shadows[s]:
        caster.note(effect_of(sources.origin[s]), begun)
        return weight, weight
    cast = np.flatnonzero(weight)
    if len(cast) < len(weight):
        start, a, toward = np.take(start, cast, axis=0), np.take(a, cast), take(toward, cast)
        aim = None if endless else take(aim, cast)
    if endless:
        blocked = caster.shaded_toward(start, toward.astype(np.float32), a)
    elif sources.kind[s] == FLAT:
        # Aim at a place just above the face, on the side that is seen: the face does not block itself.
        up = np.multiply.outer(sources.direction[s], np.sign(-dot(toward, sources.direction[s]))).T
        blocked = caster.shaded(start, caster.start(aim, up), a)
    else:
        blocked = caster.shaded(start, caster.place(aim), a, reach=SHORT)
    seen = weight.copy()
    seen[cast[blocked]] = 0.0
    caster.note(effect_of(sources.origin[s]), begun)
    return weight, seen


def effect_of(origin):
    """The effect of light that a source of some origin belongs to."""
    return "lamps" if origin >= 0 else "sky" if origin == -1 else "emission"


def _in_cone(sources, s, toward):
    """(K,) share of a spot's light that goes opposite to `toward` (K, 3): a smooth step from the cone's rim inward."""
    edge, blend = sources.cone[s]
    rise = ratio(-dot(toward, sources.direction[s]), length(toward)) - edge
    ramp = np.clip(rise / max((1.0 - edge) * blend, 1e-12), 0.0, 1.0)
    return ramp * ramp * (3.0 - 2.0 * ramp)


def _narrowed(sources, s, cosine):
    """(...) radiance of a FLAT source of limited spread at angles to its axis, as a multiple of its mean (as in Cycles)."""
    edge, factor = sources.cone[s]
    tangent = ratio(np.sqrt(np.maximum(1.0 - cosine * cosine, 0.0)), cosine)
    return np.where(cosine > 0, np.maximum(edge - tangent, 0.0) * factor, 0.0)


def _narrow_factor(sources, s, position, normal):
    """(K,) what `unoccluded` says of a FLAT source of limited spread: the sum over places all over it."""
    aim, area = _on_polygon(sources.polygon(s), *lattice(NARROW_PLACES)), sources.areas[s] / NARROW_PLACES
    result = np.empty(len(position))
    for part in runs(len(position), most=4096):
        toward = aim - position[part, None]
        square = dot(toward, toward)
        distance = np.sqrt(square)
        rise = np.maximum(ratio(dot(toward, np.broadcast_to(normal, position.shape)[part, None]), distance), 0.0)
        tilt = np.maximum(ratio(-dot(toward, sources.direction[s]), distance), 0.0)
        each = rise * tilt * area / (np.pi * square + area) * _narrowed(sources, s, tilt)
        result[part] = np.einsum("kj->k", np.ascontiguousarray(each))
    return result


def _distance(sources, s, position):
    """(K,) lower bound on the distance from points to source s."""
    toward = position - sources.position[s]
    if sources.kind[s] != FLAT:
        return length(toward)
    reach = length(sources.polygon(s) - sources.position[s]).max()
    return np.maximum(length(toward) - reach, np.abs(dot(toward, sources.direction[s])))


def _source(kind, strength, position, direction, two_sided=False, radius=0.0, soft=True, cone=(-1, 0), corners=()):
    """A `Sources` of one."""
    corners = np.asarray(corners, float).reshape(-1, 3)
    return Sources(
        kind=np.array([kind], np.int8),
        strength=np.array([strength], float),
        position=np.array([position], float),
        direction=np.array([direction], float),
        two_sided=np.array([two_sided], bool),
        radius=np.array([radius], float),
        soft=np.array([soft], bool),
        cone=np.array([cone], float),
        corner_start=np.array([0, len(corners)], np.int32),
        corner=corners,
        origin=np.array([-1], np.int32),
        shadows=np.array([True]),
    )


def _from(number, lamp, source):
    """The source of a lamp of some number, that knows it."""
    return replace(source, origin=np.array([number], np.int32), shadows=np.array([lamp.shadows], bool))


def join_sources(found):
    """One `Sources` of many."""
    joined = {f.name: np.concatenate([getattr(s, f.name) for s in found]) for f in fields(Sources)}
    joined["corner_start"] = _starts(np.concatenate([np.diff(s.corner_start) for s in found]))
    return Sources(**joined)


def _starts(size):
    """(S + 1,) int32 where each of S runs of so many corners (S,) begins, and where the last one ends."""
    return np.append(0, np.cumsum(size)).astype(np.int32)


def _of_lamp(lamp):
    """The source of a lamp. Raises ValueError naming a lamp of unknown kind."""
    x, y, z = np.asarray(lamp.axes, float)
    position = np.asarray(lamp.position, float)
    if lamp.kind == "sun":
        return _source(SUN, lamp.strength, position, -z, radius=float(np.sin(min(lamp.angle, np.pi) / 2)))
    if lamp.kind in ("point", "spot"):
        cone = (float(np.cos(lamp.angle / 2)), lamp.blend) if lamp.kind == "spot" else (-1.0, 0.0)
        return _source(BALL, lamp.strength, position, -z, radius=lamp.radius, soft=lamp.soft, cone=cone)
    if lamp.kind == "area":
        if lamp.ellipse:
            turn = 2 * np.pi * np.arange(DISK_SIDES) / DISK_SIDES
            reach = 0.5 * np.sqrt(2 * np.pi / (DISK_SIDES * np.sin(2 * np.pi / DISK_SIDES)))
            outline = reach * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        else:
            outline = 0.5 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        corners = position + outline[:, :1] * lamp.size[0] * x + outline[:, 1:] * lamp.size[1] * y
        narrow = 0 < lamp.spread / 2 < FULL_SPREAD
        half = max(lamp.spread / 2, LEAST_SPREAD)
        edge = float(np.sin(half) / np.cos(half)) if narrow else -1.0
        cone = (edge, 1.0 / (edge - half)) if narrow else (-1.0, 0.0)
        return _source(FLAT, np.pi * np.asarray(lamp.strength), position, -z, corners=corners, cone=cone)
    raise ValueError(f"{lamp.name}: lamps of kind {lamp.kind!r} are not known")


def _facing_disk(center, toward, radius):
    """(K, V, 3) polygons, equal in area to a disk about `center` that faces the points center - toward."""
    t1, t2 = tangents(unit(toward, (0.0, 0.0, 1.0)))
    turn = 2 * np.pi * np.arange(DISK_SIDES) / DISK_SIDES
    reach = radius * np.sqrt(2 * np.pi / (DISK_SIDES * np.sin(2 * np.pi / DISK_SIDES)))
    return center + reach * (np.cos(turn)[:, None] * t1[:, None] + np.sin(turn)[:, None] * t2[:, None])


def _on_polygon(corners, a, b):
    """(..., 3) places spread evenly over a convex polygon by a, b (...) in [0, 1)."""
    e1, e2 = corners[1:-1] - corners[0], corners[2:] - corners[0]
    if len(corners) == 4 and np.abs(e1[0] + corners[3] - corners[2]).max() <= 1e-9 * np.abs(e2[0]).max():
        return from_coordinates(*(c + a * x + b * y for c, x, y in zip(corners[0], e1[0], e2[1])))
    area = length(cross(e1, e2))
    upper = np.cumsum(area)
    target = a * upper[-1]
    triangle = np.minimum(np.searchsorted(upper, target, side="right"), len(area) - 1)
    share = np.clip((target - (upper - area)[triangle]) / np.maximum(area[triangle], 1e-300), 0.0, 1.0)
    root = np.sqrt(1.0 - share)
    return corners[0] + (b * root)[..., None] * e1[triangle] + (1.0 - root)[..., None] * e2[triangle]


def _sun_directions(sources, s, a, b):
    """(K, 3) unit vectors toward places spread evenly over a sun's disk."""
    axis = -sources.direction[s]
    if sources.radius[s] == 0:
        return np.broadcast_to(axis, (len(a), 3))
    x, y = _disk(a, b)
    t1, t2 = (sources.radius[s] * t for t in tangents(axis))
    # How long they are is known; to find it anew would take twice as long as all else.
    scale = 1.0 / np.sqrt(1.0 + sources.radius[s] ** 2 * a)
    return from_coordinates(*(scale * (c + x * p + y * q) for c, p, q in zip(axis, t1, t2)))


def _sky_directions(sources, s, a, b):
    """(K, 3) unit vectors toward places spread evenly over a group of the sky's directions."""
    group = sources.polygon(s)
    number = np.minimum((a * len(group)).astype(np.int64), len(group) - 1)
    x, y = _disk(fraction(a * len(group)), b)
    t1, t2 = tangents(group[number])
    return unit(group[number] + sources.radius[s] * (x[:, None] * t1 + y[:, None] * t2))


def _on_disk(sources, s, position, a, b):
    """(..., 3) places a, b (...) in [0, 1), spread evenly, of a lamp's disk, which faces each of the positions (..., 3)."""
    if sources.radius[s] == 0:
        return np.broadcast_to(sources.position[s], (len(a), 3))
    toward = sources.position[s] - position
    t1, t2 = tangents(toward / np.maximum(length(toward), TINY)[..., None])
    x, y = _disk(a, b)
    return sources.position[s] + sources.radius[s] * (x[..., None] * t1 + y[..., None] * t2)


def _disk(a, b):
    """Places x, y spread evenly over the unit disk."""
    radius, turn = np.sqrt(a), 2 * np.pi * b
    return radius * np.cos(turn), radius * np.sin(turn)


def _vector_areas(start, corner):
    """(S, 3) vectors along the normals of planar polygons, as long as their areas; the corners of each are those from
    start (S + 1,) of corner (C, 3) on."""
    full = np.flatnonzero(np.diff(start))
    owner = np.repeat(np.arange(len(start) - 1), np.diff(start))
    following = np.arange(1, len(owner) + 1)
    following[start[1:][full] - 1] = start[:-1][full]
    arm = corner - corner[start[:-1][owner]]
    twice = cross(arm, arm[following])
    return np.stack([np.bincount(owner, x, len(start) - 1) for x in twice.T], axis=1) / 2


def flat_sources(corner, sides, strength, object):
    """FLAT Sources that shine to both sides. corner: (C, 3) those of one after the other, sides: (S,) how many each has;
    strength: (S, C); object: (S,) whose faces they are."""
    start, owner = _starts(sides), np.repeat(np.arange(len(sides)), sides)
    middle = [np.bincount(owner, x, len(sides)) / np.maximum(sides, 1) for x in corner.T]
    return Sources(
        kind=np.full(len(sides), FLAT, np.int8),
        strength=strength,
        position=np.stack(middle, axis=1),
        direction=unit(_vector_areas(start, corner)),
        two_sided=np.ones(len(sides), bool),
        radius=np.zeros(len(sides)),
        soft=np.ones(len(sides), bool),
        cone=np.tile((-1.0, 0.0), (len(sides), 1)),
        corner_start=start,
        corner=corner,
        origin=(-2 - object).astype(np.int32),
        shadows=np.ones(len(sides), bool),
    )
