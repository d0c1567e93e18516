"""Direct light at points: the test rays toward sources that show how much of each is visible from there.

Owns how many test rays go where: a few at first, more where a source is partly hidden, or hidden for one point and not
for the next, the more the brighter it may be there; narrow suns are tested at their rims.
"""

from __future__ import annotations

from time import thread_time

import numpy as np

from .lights import FLAT, SUN, test_rays, unlike
from .sampling import R2, fraction, scatter
from .vectors import counted, ratio, whole_runs

APART = (0.41421356237309503, 0.7320508075688772)  # steps from point to point of the test rays' shifts
TEST = 4  # salt of the sample sequences

TESTS = 4  # test rays toward a source, before it is known whether it is partly hidden
NARROW = 0.02  # sine of the half angle up to which a sun is narrow: most points see all of it or nothing
RIM_SHARE = 0.98  # of the sun's disk lies within that rim
RIM = 4  # test rays to a narrow sun's rim: an edge that hides 0.1 to 0.9 of the sun lets some through and not all
MAIN = 0.25  # share of a point's light from which on a source gets all of them
UNLIKE = 6  # times as many where the parts of the source do not shine alike
PENUMBRA = 1.5  # more test rays where it is, as a multiple of the gather rays
MOST_TESTS = 16.0  # times as many test rays toward a source that gives so many times what points get in the mean
UNSEEN = 32  # gather rays to a test ray toward a source that the first few find wholly lit, or wholly hidden
DIM = 0.02  # a point that gets less than this share of its unoccluded light is tested DIM_TESTS times more
DIM_TESTS = 16

CROWD_TESTS = 1.0  # rays toward a crowd for each gather ray, where it may give what points get in the mean
LEAST_BRIGHT, MOST_BRIGHT = 0.25, 4.0  # times as many where it may give less, and more
FEWEST = 4  # of them


def light_of_sources(kernel, points, rays, tests, seed):
    """(C, K) light of the sampled sources at the points of a Block [W/m^2].

    All are tested a few times, with their neighbors; where a source is partly hidden, or hidden for one point and not
    for the next, more test rays follow. tests: times as many as usual. Sources before which nothing can stand are tested only
    where normals are bent, for parts of them may lie below the surface itself.
    """
    sources, own = kernel.sources, len(points)
    if not len(sources):
        return np.zeros((sources.strength.shape[1], own))
    ids, position, normal, geometric = points.ids, points.position, points.normal, points.geometric
    free, flat = ~kernel.shadowed, (normal == geometric).all(axis=1)
    if free.all() and flat[:own].all():
        factor = kernel.factors_at(ids[:own], position[:own], normal[:own])
        return np.einsum("ks,sc->ck", factor, sources.strength)
    here, there = points.edges
    origin = kernel.caster.start(position, geometric)

    def test(s, who, after, count, rim=False):
        """Sums of the weights (K,) of `count` (K,) test rays of each of `who` (K,), from number `after` (K,) on, and of
        those that get through. rim: they are to go to the rim of a sun, evenly spaced."""
        start, sums = np.append(0, np.cumsum(count)), np.empty((2, len(who)))
        for part in whole_runs(start):
            owner, number = counted(count[part])
            rows = who[part][owner]
            if rim:
                a, b = _rim_places(ids[rows], number, s, seed)
            else:
                a, b = _test_places(ids[rows], after[part][owner] + number, s, seed)
            # A seventh of the time of x[rows].
            each = (np.take(x, rows, axis=0) for x in (position, normal, geometric, origin))
            for total, weight in zip(sums, test_rays(sources, s, kernel.caster, *each, a, b)):
                total[part] = np.add.reduceat(weight, start[:-1][part] - start[part.start])
        return sums

    factor = kernel.factors_at(ids, position, normal)
    possible = factor * sources.strength.max(axis=1)
    share = ratio(possible, possible.sum(axis=1, keepdims=True))
    first = np.stack([_tests(kernel, s, position, share[:, s], tests) for s in range(len(sources))], axis=1)
    # What few tests take for lit whole may be hidden by a hundredth: with more rays, or in the sun of a dim room, that would be
    # most of the error.
    sharp, narrow = (np.array([f(kernel, s) for s in range(len(sources))]) for f in (_sharp, _narrow))
    bright, level = np.full(possible.shape, float(MOST_TESTS)), float(kernel.arrays["gather.level"])
    np.divide(possible, level, out=bright, where=possible < MOST_TESTS * level)
    np.maximum(bright, 1.0, out=bright)
    often = np.maximum(first * bright, rays * tests / UNSEEN * np.sqrt(share)).astype(np.int64)
    first = np.where(sharp, first, often)
    whole = flat[:, None] & free
    weight, seen, tested = whole.astype(float), whole.astype(float), thread_time()
    for s in range(len(sources)):
        lit = np.flatnonzero((factor[:, s] > 0) & ~whole[:, s])
        if len(lit):
            count = np.full(len(lit), RIM) if narrow[s] else first[lit, s]
            weight[lit, s], seen[lit, s] = test(s, lit, np.zeros(len(lit), np.int64), count, narrow[s])

    # Where the light is partly hidden: more rays, by the source's share of what the point could get.
    most = 2 * PENUMBRA * rays * tests
    dim = (possible * ratio(seen, weight)).sum(axis=1) < DIM * possible.sum(axis=1)
    for s in range(len(sources)):
        if sharp[s] or free[s]:
            continue
        state = np.where(weight[:, s] > 0, np.sign(seen[:, s]) + (seen[:, s] < weight[:, s]), -1)
        differs = (state[here] != state[there]) & (state[here] >= 0) & (state[there] >= 0)
        mixed = (state == 2) | (np.bincount(here, differs, len(ids)) > 0)
        count = np.where(mixed, np.clip(most / 2 * np.sqrt(share[:, s]), 4, most), 0)
        if narrow[s]:  # its rim has shown where it must be tested, and nothing else
            count = np.where(mixed, count + first[:, s], 0)
            weight[mixed, s] = seen[mixed, s] = 0.0
        else:
            count = np.where(dim & (state >= 0), np.maximum(count, DIM_TESTS), count)
        count = count.astype(np.int64)
        more = np.flatnonzero(count[:own])
        if len(more):
            extra = test(s, more, first[more, s], count[more])
            weight[more, s] += extra[0]
            seen[more, s] += extra[1]
    arriving = (factor * ratio(seen, weight))[:own]
    kernel.caster.note("occlusion", tested)
    return np.einsum("ks,sc->ck", arriving, sources.strength)


def light_of_crowd(kernel, points, rays, tests, seed):
    """(C, K) light of the crowd at the points of a Block [W/m^2]: the brighter it may be there, the more test rays."""
    own, level = slice(len(points)), max(float(kernel.arrays["gather.level"]), 1e-300)

    def count(light):
        bright = np.clip(light / level, LEAST_BRIGHT, MOST_BRIGHT)
        return np.maximum(CROWD_TESTS * rays * tests * bright, FEWEST).astype(np.int64)

    place = points.ids[own], points.position[own], points.normal[own], points.geometric[own]
    return kernel.crowd.at_points(kernel.caster, *place, count, seed, kernel.occluded)


def _tests(kernel, s, position, share, tests):
    """(K,) test rays from points toward a source before anything is known, `tests` times as many as usual: fewer the
    less of their light is its, and more where its parts do not shine alike: the share that is visible is a ratio of
    sums of weights, which few very unlike weights bias."""
    if _sharp(kernel, s):
        return np.ones(len(position), np.int64)
    usual = np.where(unlike(kernel.sources, s, position), UNLIKE * TESTS, TESTS)
    return np.maximum(np.ceil(tests * usual * np.sqrt(np.minimum(share / MAIN, 1.0))), 1.0).astype(np.int64)


def _sharp(kernel, s):
    """Whether a source is a mere point, which is seen or not."""
    return kernel.sources.kind[s] != FLAT and kernel.sources.radius[s] == 0 and not kernel.caster.veiled


def _narrow(kernel, s):
    """Whether a source is a sun as narrow as the real one, or not much wider."""
    narrow = kernel.sources.kind[s] == SUN and 0 < kernel.sources.radius[s] <= NARROW
    return narrow and not kernel.caster.veiled


def _rim_places(ids, number, s, seed):
    """Places a, b (K,) on the rim of a sun s for its RIM test rays, `number` (K,) each, of points ids (K,)."""
    turn = fraction(ids * APART[1] + scatter(np.arange(1) + 2 * s, TEST + 8 * seed))
    return np.full(len(ids), RIM_SHARE), fraction((turn + number) / RIM)


def _test_places(ids, number, s, seed):
    """Places a, b (K,) on source s for test rays `number` (K,) of points ids (K,): the R2 sequence, shifted by point."""
    shift = scatter(np.arange(2) + 2 * s, TEST + 8 * seed)
    return tuple(fraction(ids * APART[k] + number * R2[k] + shift[k]) for k in range(2))
