"""Control points: a few points of a bake gathered afresh, with far more rays and a bounce or more deeper, to see its error.

Owns the drawing of control points, which of them further rays go from, and the cells' part of their truth. At a control
point every ray goes on: where it meets a patch, the patch's own light is not read but sampled anew, by a test ray to a source
and one more ray, whose hit then reads the patches. So the error that is found holds what the patches have averaged away and
what their rows have missed, beside the noise and the filter of the bake. Truths are independent, and their noises cancel in
the products of two.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .anew import read_light, read_reflected, reflect_anew
from .gather import SEEDS, Shooter, weighted_sum
from .lights import test_rays
from .points import Block, block_arrays
from .sampling import R2, fraction, ray_samples, scatter
from .vectors import ratio, runs

CONTROL = 6  # salt of the sample sequences
APART = 1 << 20  # seeds of control points are so far from those of the gather, in replicates
CROWD_TESTS = 1  # times as many toward a crowd of sources: their noise is a hundredth of that of reflected light
TASK_RAYS = 1 << 15  # of one task, some 10 ms: however many cells there are, as test rays go by the points of a task
# Parts of the control points: by area, evenly over the objects, by light, reflected light, noise, and reflected light in
# tight places. What light straight from lamps has no doubt of needs few: sunlit outer walls are most of the light that there
# is, and next to none of the error; behind pictures on a wall is most of it where there are any, and hardly a point by chance.
EVERYWHERE, EACH = (0.25, 0.25, 0.1, 0.2, 0.2, 0.15), (0.1, 0.65, 0.05, 0.1, 0.1, 0.0)
TIGHT = 0.5  # of the length of the side that a point lies on: where its rays go less far in the (harmonic) mean
# Control points that further rays go from, once all have had the first. Their own noise is most of what is in doubt, and so many
# rays more of a third of the points take twice as much of it away. With 60 an estimate was 1.4 times the measured error.
FEW = 100
DIRECT_TESTS, FEWEST_TESTS = 64, 8  # test rays to a source that gives all light, and to one that gives next to none


@dataclass(frozen=True)
class Traced:
    """What a Control has traced: two truths in each of `rounds` rounds; of those that count, rays (M,), truth and patches
    (M, C, K), see Control; and of a round of `asked` rays that is under way, truth and patches (C, N) at the first N of
    its places."""

    rounds: int = 0
    rays: np.ndarray | None = None
    truth: np.ndarray | None = None
    patches: np.ndarray | None = None
    asked: int = 0
    next_truth: np.ndarray | None = None
    next_patches: np.ndarray | None = None


class Control:
    """K control points, and truths of their light, as many as have been traced.

    ids: (K,) points, sorted. weight: (K,) [m^2], so that sums of weight times a value estimate sums of area times it over
    all points. truth: (M, C, K) independent means of the light [W/m^2]; patches: (M, C, K) how much more the same rays
    bring if they read the patches that they meet; each: (M,) rays of every one of them. rays: half of all, for every round
    has two. traced: all that, as Traced.
    """

    def __init__(self, points, ids, weight, cells, settings, groups=1, traced=None, further=0):
        """points: of all of which ids are some. groups: number of light groups, whose light is put together. traced: to
        go on from. further: how many times more than once its rays go on."""
        self._points, self.ids, self.weight, self._cells = points, ids, weight, cells
        self._settings, self._groups, self._further = settings, groups, further
        self.traced = traced or Traced()

    def trace(self, rays):
        """Trace two more truths of `rays` rays at every point: a generator that yields before and after every task."""
        self.traced = replace(self.traced, asked=rays)
        return self.complete()

    def narrow(self, shared):
        """Go on with about FEW of the points. shared: (K,) what was seen at each of what the error is made of, noise with it, of
        either sign. Where that is much, points are likely to stay; what does stands for others too, so that sums stay right,
        and for the more of them the less was seen there, but never for many."""
        seen = np.abs(shared)
        chosen, times = _draw(seen + max(seen.mean(), 1e-300), self._points.object[self.ids], FEW)
        self.ids, self.weight = self.ids[chosen], self.weight[chosen] * times
        self.traced = replace(self.traced, truth=self.truth[..., chosen], patches=self.patches[..., chosen])

    def complete(self):
        """Trace the rest of a round that was broken off: a generator like that of `trace`."""
        rays, rounds, count = self.traced.asked, self.traced.rounds, len(self.ids)
        done = 0 if self.traced.next_truth is None else self.traced.next_truth.shape[1]
        size = max(TASK_RAYS // (3 * rays + min(rays, DIRECT_TESTS)), 1)
        tasks = [
            self._cells.submit(
                "control",
                rays=rays,
                further=self._further,
                seed=self._settings.seed + SEEDS * (APART + seed),
                **block_arrays(self._points, self.ids[k : k + size], joined=False),
            )
            for number, seed in enumerate((2 * rounds, 2 * rounds + 1))
            for k in range(min(max(done - number * count, 0), count), count, size)
        ]
        yield 0.0  # cells are at work: there is time for something else
        for k, task in enumerate(tasks):
            (result,) = self._cells.take([task])
            before = self.traced
            truth, patches = (
                result[name] if old is None else np.concatenate([old, result[name]], axis=1)
                for name, old in (("truth", before.next_truth), ("patches", before.next_patches))
            )
            self.traced = replace(before, next_truth=truth, next_patches=patches)
            yield (k + 1) / len(tasks)
        before = self.traced
        both = (self._both(values, count) for values in (before.next_truth, before.next_patches))
        more = np.full(2, rays), *both
        if before.rays is not None:
            more = map(np.concatenate, zip((before.rays, before.truth, before.patches), more))
        self.traced = Traced(rounds + 1, *more)

    def _both(self, values, count):
        """(2, C, K) of all groups together, of values (G C, 2 K), those of one truth after those of the other."""
        return np.moveaxis(values.reshape(self._groups, -1, 2, count).sum(axis=0), 1, 0)

    rays = property(lambda self: 0 if self.each is None else int(self.each.sum()) // 2)
    each = property(lambda self: self.traced.rays)
    under_way = property(lambda self: self.traced.asked > 0)
    truth = property(lambda self: self.traced.truth)
    patches = property(lambda self: self.traced.patches)


def tight_places(nearness, length):
    """(P,) bool, whether points lie where there is little room before them. nearness: (P,) mean inverse distance that their
    rays went [1/m]; length: (P,) of the patches that they lie on [m]."""
    return nearness * length > 1.0 / TIGHT


def draw_control(points, light, tight, count, per_object):
    """Ids (K,) of control points, sorted, and their weights (K,) [m^2].

    Drawn from a mixture, see EVERYWHERE: by area, evenly over the objects, so that a dark room is seen too, and by what the
    error is made of: light, light that was reflected, also that of tight places by itself, (P,) bool, and noise, that of
    neighbors with it, for by chance it looks small at some points. light: the Light so far. per_object: most of them evenly
    over the objects.
    """
    by_object = np.bincount(points.object, points.area)
    share = ratio(points.area, by_object[points.object]) / max(np.count_nonzero(by_object), 1)
    power, reflected, noise = (x.sum(axis=0) for x in (light.total**2, light.indirect**2, light.variance))
    sums = np.append(0.0, np.cumsum(noise[points.neighbor]))
    noise = np.maximum(noise + np.diff(sums[points.neighbor_start]), 0.0)
    squares = power, reflected, noise, reflected * tight
    parts = points.area, share, *(points.area * square for square in squares)
    density = np.zeros(len(points.area))
    for weight, values in zip(EACH if per_object else EVERYWHERE, parts):
        density += weight * values / max(values.sum(), 1e-300)
    ids, times = _draw(density, points.object, count)
    return ids.astype(np.int32), points.area[ids] * times


def _draw(density, object, count):
    """About `count` of P items as numbers (K,), sorted, evenly spread over a density (P,) along the objects (P,) that they are
    of; and how many items each stands for (K,)."""
    order = np.argsort(object, kind="stable")
    upto = np.cumsum(density[order])
    drawn = order[np.searchsorted(upto, (np.arange(count) + 0.5) / count * upto[-1])]
    chosen, times = np.unique(drawn, return_counts=True)
    return chosen, ratio(times * max(density.sum(), 1e-300), count * density[chosen])


def control_points(kernel, rays, seed, further, **points):
    """{"truth", "patches": (C, K)} the light of the K points of a Block by rays that go on, `further` times more than once, and
    how much more the same rays bring when they read the patches that they meet [W/m^2]."""
    points = Block(**points)
    found = kernel.arrays["gather.found"]
    place = points.ids, points.position, points.normal
    truth = direct_light(kernel, points, kernel.factors_at(*place), min(rays, DIRECT_TESTS), FEWEST_TESTS, seed)
    patches = np.zeros_like(truth)
    if not (kernel.arrays["gather.reflectance"].any() or kernel.arrays["gather.through"].size or found.size):
        return {"truth": truth, "patches": patches}  # rays bring nothing
    shooter = Shooter(kernel, points, rays, seed)
    for part in runs(len(points), shooter.each):
        hit, weight = shooter.shoot(part)
        counts = (hit.side >= 0) & (weight.reshape(-1) > 0)
        emitted = read_light(found, hit.side)
        deeper = np.zeros((len(truth), len(counts)))
        samples = ray_samples(points.ids[part], shooter.each, np.flatnonzero(counts), CONTROL + 8 * seed)
        deeper[:, counts] = reflect_anew(kernel, hit, np.flatnonzero(counts), samples, deeper=further)
        place = points.ids[part], points.geometric[part], points.size[part]
        flat = np.where(counts, read_reflected(kernel, hit, *place, seed, deeper), 0.0)
        truth[:, part] += weighted_sum(emitted + deeper, weight)
        patches[:, part] = weighted_sum(flat - deeper, weight)
    return {"truth": truth, "patches": patches}


def direct_light(kernel, points, factor, tests, fewest, seed):
    """(C, K) light of the sampled sources at the points of a Block [W/m^2], from many test rays: `tests` to one that
    gives all, and fewer to those that give less. factor: (K, S) what they give with nothing in between, per unit of
    strength."""
    sources, ids = kernel.sources, points.ids
    light = np.zeros((sources.strength.shape[1], len(ids)))
    position, normal, geometric = points.position, points.normal, points.geometric
    if kernel.crowd is not None:
        count = lambda given: np.full(len(given), CROWD_TESTS * tests)
        light += kernel.crowd.at_points(kernel.caster, ids, position, normal, geometric, count, seed, kernel.occluded)
    if not len(sources):
        return light
    start = kernel.caster.start(position, geometric)
    factor = factor.T
    given = np.array([f.sum() * sources.strength[s].max() for s, f in enumerate(factor)])
    share = np.sqrt(given / max(given.sum(), 1e-300))
    for s in range(len(sources)):
        if points.level and not kernel.shadowed[s]:
            light += sources.strength[s][:, None] * factor[s]
            continue
        lit = np.flatnonzero(factor[s])
        if not len(lit):
            continue
        count = max(int(np.ceil(tests * share[s])), fewest)
        owner, number = np.repeat(lit, count), np.arange(count)
        shift = scatter(ids[lit].astype(np.int64)[:, None] * 2 + np.arange(2) + (s << 40), CONTROL + 8 * seed)
        a, b = (fraction(number * R2[k] + shift[:, k, None]) for k in range(2))
        each = (np.take(x, owner, axis=0) for x in (position, normal, geometric, start))
        weight, seen = test_rays(sources, s, kernel.caster, *each, a.reshape(-1), b.reshape(-1))
        visible = ratio(*(np.einsum("kn->k", x.reshape(-1, count)) for x in (seen, weight)))
        light[:, lit] += sources.strength[s][:, None] * (factor[s, lit] * visible)
    return light
