"""Light that a hit reflects, sampled anew: not as its patch has it, but as it is at that very place.

A patch has one radiosity; where shadows and contacts are finer than it, rays go on: with a test ray to one source, and one
more ray, and a guided one if there are any, whose hits then read the patches. All do that which ask for the truth, those
of fine meshes that meet a coarse patch nearby, and, again and again, those that cross a gap narrower than a patch. All that
meet a side across which the shadow of a bright source ends ask anew for the light of that one source.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .guide import Aim
from .lights import from_one_test, likely_light, test_rays
from .sampling import R2, fraction, hemisphere, ray_samples, scatter, tangents
from .scene import normal_and_area
from .vectors import TINY, by_coordinate, dot, take

EDGE, GO_ON, ONCE_MORE = 12, 11, 13  # salts of the samples
# Hits of rays of fine meshes that are nearer than a side is long, times this, go on: a ball on a table gets what the table
# reflects beside it and below it, not its mean. In the hall, balls were up to 4.6 % off at 2 % per object, now 1.3 %.
CLOSE = 1.0
# Times as long: a mesh whose points are nearer to one another is fine. With half of that, feet of benches and columns in the
# hall were off by up to 30 % of all light (at 0.5 % 133 vertices by more than 5 %, now 62; in the Cornell box 77, now 12);
# where all do it takes up to three times as long.
FINE = 1.0
# Of any mesh those go on that are so near across a gap, and so do those of the rays that they send on, so many times at most:
# there light falls off within the gap's width from its mouth, and what lies deeper would read the mean of patches that have
# all of that. A wall 1 cm behind a cupboard was off by 6 % at 2 % per object, now by 1.5 %.
ONWARD = 6
# Elsewhere only rays that go on for another reason cross gaps, those of the truth above all: once, and gaps narrower than this
# times a side. So the estimate sees what is wrong in them (pictures 3 cm before lit walls: 2 % where 1 % was asked for and 0.8 %
# was said), for 3 to 7 % of the time.
NARROW, ONCE = 0.5, 1
ACROSS = 0.7  # least cosine between the two sides of a gap, one of them turned about: a crease is none
BRIGHT = 1.0  # times what points get in the mean: as much a source must add to what a side reflects, or its edge is no matter
NEAR = 4.0  # times as long as a side is: hits from further away read its mean
APART = (0.41421356237309503, 0.7320508075688772)  # steps from point to point of the samples' shifts


@dataclass(frozen=True)
class Edges:
    """Patch sides (E,) that a source lights in part, its number (E,), the mean irradiance (E,) that it gives each, per
    unit of its strength, and the irradiance (E,) that it would give the whole side [W/m^2]: of several sources, the
    brightest."""

    sides: np.ndarray
    source: np.ndarray
    mean: np.ndarray
    whole: np.ndarray


def edge_arrays(edges, reflectance, level):
    """The arrays that cells need to read light at bright edges, as {name: array}: of (2 N,) sides the source, -1 for none,
    and the mean irradiance by it; both are empty if there are none. edges: Edges or None. reflectance: (C, 2 N) of sides;
    level: irradiance of points in the mean [W/m^2]."""
    source = mean = np.zeros(0)
    if edges is not None:
        bright = edges.whole * reflectance[:, edges.sides].max(axis=0) > BRIGHT * level
        if bright.any():
            source, mean = np.full(reflectance.shape[1], -1, np.int16), np.zeros(reflectance.shape[1])
            source[edges.sides[bright]], mean[edges.sides[bright]] = edges.source[bright], edges.mean[bright]
    return {"edges.source": source, "edges.mean": mean}


def read_reflected(kernel, hit, ids, normal, size, seed, anew=None):
    """(C, K * n) light [W/m^2] that sides reflect toward rays that met them: Hits of n rays from each of places ids (K,).

    On edges the light of the source is that of the very place, seen by one test ray: near them, and there are few, a mean
    over the side is what is most wrong with the light of the points. Where rays from a fine mesh meet a side nearby, or any
    the other side of a gap, all light is that of the very place. normal: (K, 3) of the surfaces that the places lie on; size:
    (K,) square root of the area that each stands for [m]. anew: (C, K * n) light of all hits that go on, if it is known.
    """
    each = len(hit.side) // max(len(ids), 1)
    light, source = read_light(kernel.arrays["gather.reflected"], hit.side), kernel.arrays["edges.source"]
    chosen = _going_on(kernel, hit, normal, size)
    if len(chosen):
        samples = None if anew is not None else ray_samples(ids, each, chosen, GO_ON + 8 * seed)
        light[:, chosen] = anew[:, chosen] if anew is not None else reflect_anew(kernel, hit, chosen, samples)
    if not len(source):
        return light
    edge = source[np.maximum(hit.side, 0)] >= 0
    edge[chosen] = False
    there = np.flatnonzero(edge & (hit.side >= 0))
    there = there[hit.distance[there] < NEAR * kernel.sizes[hit.side[there] >> 1]]
    picked = source[hit.side[there]]
    for s in np.unique(picked):
        chosen = there[picked == s]
        point, ray = np.divmod(chosen, each)
        shift = scatter(np.arange(2) + 2 * s, EDGE + 8 * seed)
        a, b = (fraction(ids[point] * APART[k] + ray * R2[k] + shift[k]) for k in range(2))
        position, normal, start = _places(kernel, hit, chosen)
        own = hit.side[chosen]
        change = (
            _from_source(kernel, kernel.sources, s, position, normal, start, a, b) - kernel.arrays["edges.mean"][own]
        )
        light[:, chosen] += kernel.arrays["gather.reflectance"][:, own] * (kernel.sources.strength[s][:, None] * change)
    return light


def _going_on(kernel, hit, normal, size=None):
    """(K,) numbers of the Hits of n rays each, from places with normals (P, 3), whose rays go on: those across a gap, and, if
    the places are of a mesh, of so fine a one; size: (P,) square root of the area that each stands for [m]. See CLOSE."""
    # Python's own numbers: beside those of numpy float32 is float64 in numpy 2, and other bits.
    close, fine = (kernel.arrays["gather.close"] * (CLOSE, FINE)).tolist() if size is not None else (0.0, 0.0)
    gap = CLOSE if kernel.arrays["gather.gaps"] else NARROW if size is None else 0.0
    if not ((close or gap) and kernel.occluded and len(normal)):
        return np.zeros(0, np.int64)
    # Whatever a ray that escapes reads here, it has no end.
    near = np.flatnonzero(hit.distance < max(gap, close) * np.take(kernel.sizes, hit.side >> 1, mode="wrap"))
    side, place = hit.side[near], near // (len(hit.side) // len(normal))
    own, length = np.zeros(len(near), bool), kernel.sizes[side >> 1]
    if gap:
        facing = dot(kernel.patches.normal[side >> 1], normal[place])
        own = (np.where(side & 1, facing, -facing) > ACROSS) & (hit.distance[near] < gap * length)
    if close:
        own |= (hit.distance[near] < close * length) & (size[place] * kernel.caster.frame[1] < fine * length)
    return near[own]


def reflect_anew(kernel, hit, chosen, x, deeper=0, gone=0):
    """(C, K) light [W/m^2] that the chosen hits (K,) of Hits reflect: of a source picked for each, and of one more ray,
    with a guided one beside it.

    x: (5, K) samples in [0, 1): which source, or side that rays are guided to, a place on it, and the direction of the ray.
    deeper: how many times such rays go on whatever they meet; gone: how many times they have gone on.
    """
    position, normal, start = _places(kernel, hit, chosen)
    arriving = _one_source(kernel, position, normal, start, x[0], x[1], x[2], hit.side[chosen])
    local = hemisphere(x[3], x[4])
    t1, t2 = tangents(normal)
    direction = (local[:, :1] * t1 + local[:, 1:2] * t2 + local[:, 2:] * normal).astype(np.float32)
    if kernel.guide and not gone:  # one way alone goes on, or there would be twice as many at each hit
        aim = Aim(kernel.guide, position, normal)
        more = aim.rays(position[:, None], *x[:3, :, None])
        direction = np.concatenate([direction.T[:, :, None], more], axis=2)
        far = kernel.hits(np.repeat(start, 2, axis=0), direction.reshape(3, -1).T)
        weight = aim.weights(far, direction, normal[:, None], 1)
    else:
        far, weight = kernel.hits(start, direction), np.ones((len(start), 1))
    light = read_light(kernel.arrays["gather.reflected"], far.side)
    most = ONWARD if kernel.arrays["gather.gaps"] else ONCE
    again = np.flatnonzero(far.side >= 0) if deeper else _going_on(kernel, far, normal) if gone < most else ()
    if len(again):
        place, number = np.divmod(again, weight.shape[1])
        keys = (x[:, place] * 2.0**52).astype(np.int64) + number
        light[:, again] = reflect_anew(kernel, far, again, scatter(keys, ONCE_MORE), max(deeper - 1, 0), gone + 1)
    light += read_light(kernel.arrays["gather.found"], far.side)
    arriving += np.einsum("ckn,kn->ck", light.reshape(len(arriving), *weight.shape), weight)
    own = hit.side[chosen]
    reflected = kernel.arrays["gather.reflectance"][:, own] * arriving
    through = kernel.arrays["gather.through"]
    return reflected + through[:, own] if through.size else reflected


def first_light(kernel, position, normal, samples):
    """{"light": (K,)} irradiance [W/m^2], the mean of the channels, at places on surfaces with normals (K, 3) from one
    source each; samples: (3, K) in [0, 1)."""
    start = kernel.caster.start(position, normal)
    return {"light": _one_source(kernel, position, normal, start, *samples).mean(axis=0)}


def _places(kernel, hit, chosen):
    """Positions and normals (K, 3) of the chosen hits (K,) of Hits, and where rays start from there, (K, 3) float32."""
    corners = np.take(kernel.triangles, hit.triangle[chosen], axis=0).T
    a, b, c = (by_coordinate(np.take(kernel.vertices, corner, axis=0)) for corner in corners)
    u, v = hit.u[chosen, None].astype(float), hit.v[chosen, None].astype(float)
    position = a + u * (b - a) + v * (c - a)
    normal = normal_and_area(a, b, c)[0] * np.where(hit.back[chosen], -1.0, 1.0)[:, None]
    return position, normal, kernel.caster.start(position, normal)


def _from_source(kernel, sources, s, position, normal, start, a, b):
    """(K,) irradiance per unit of strength that places (K, 3) get from one of Sources, by one test ray each."""
    _weight, seen = test_rays(sources, s, kernel.caster, position, normal, normal, start, a, b)
    return from_one_test(sources, s, position, normal, seen, a)


def _one_source(kernel, position, normal, start, pick, a, b, side=None):
    """(C, K) direct irradiance at points (K, 3) [W/m^2] from one source each, picked by what it may give, over the
    probability of the pick. pick, a, b: (K,) in [0, 1). side: (K,) patch sides that the points lie on, if that is known."""
    sources, crowd = kernel.picked
    light = np.zeros((sources.strength.shape[1], len(position)))
    if not len(sources) and crowd is None:
        return light
    if len(sources) == 1 and crowd is None:
        return sources.strength[0][:, None] * _from_source(kernel, sources, 0, position, normal, start, a, b)
    likely, given = [likely_light(sources, s, position, normal) for s in range(len(sources))], None
    if crowd is not None:  # it counts as one more
        given = kernel.given_on(side, position, normal)
        if not len(sources):
            return crowd.one(kernel.caster, position, normal, start, given, pick, a, b)
        likely.append(given.total + TINY)
    likely = np.stack(likely)
    upto = likely.copy()
    for before, row in pairwise(upto):  # a sixth of the time that cumsum takes down the columns
        row += before
    picked = (upto <= pick * upto[-1]).sum(axis=0)
    order = np.argsort(picked, kind="stable")
    ends = np.searchsorted(picked[order], np.arange(len(likely) + 1))
    position, normal, start = take(position, order), take(normal, order), take(start, order)
    picked, pick, a, b = picked[order], pick[order], a[order], b[order]
    over = upto[-1, order] / likely[picked, order]
    for s in np.flatnonzero(np.diff(ends)):
        mine = slice(*ends[s : s + 2])
        place, up = position[mine], normal[mine]
        if s == len(sources):
            left = np.clip(1.0 - (1.0 - pick[mine]) * over[mine], 0.0, 1.0)  # of the sample
            each = place, up, start[mine], given.of(order[mine]), left, a[mine], b[mine]
            light[:, order[mine]] = crowd.one(kernel.caster, *each) * over[mine]
            continue
        factor = _from_source(kernel, sources, s, place, up, start[mine], a[mine], b[mine])
        light[:, order[mine]] = sources.strength[s][:, None] * (factor * over[mine])
    return light


def read_light(light, side):
    """(C, K) light (C, 2 N + 1) of the sides (K,) that rays met; 0 where there is no such light at all."""
    if not light.size:
        return np.zeros((len(light), len(side)))
    read = np.empty((len(light), len(side)))
    for channel, result in zip(light, read):
        np.take(channel, side, mode="wrap", out=result)
    return read
