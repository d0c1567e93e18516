"""Accuracy: how far a bake is from the truth, and what it takes to come closer.

Owns the record `Estimate`, the choice of how many more rays to gather. The error of a bake is
sqrt(sum A (I - I*)^2 / sum A I*^2), I the irradiance at the points, A their areas, I* the truth.

Two sources feed the estimate. How replicates scatter shows their noise at every point. What replicates share (light
that patches average away, rows that miss it, the filter) shows at the control points, whose light was traced anew:
(B - C1)(B - C2) less the noise of B, with any two truths C1 and C2, whose own noises cancel in the product.

Choices depend on counts and variances alone, never on seconds, so that the same bake always makes the same ones.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass

import numpy as np

from .vectors import ratio

AIM = 0.72  # of the error asked for: where a bake steers to
ENOUGH = 0.88  # of the error asked for: where it stops
AIM_EACH, ENOUGH_EACH = 0.5, 0.7  # the same for objects one by one, of which less is known
CROWDED = 1e-3  # of the scene's diagonal: a point so near another surface lies in a corner
DOUBT = 0.25  # standard errors of what replicates share that are taken as chance
CERTAIN = 2.0  # and those that must be, before rays are spent against it
SMALL = 0.4  # noise of this share of what replicates share is as good as none
MOST_RAYS = 4096  # of one replicate
WORTH = 0.3  # of the rays so far: fewer in another replicate would not be worth another look
MANY_RAYS = 1024  # of a point: whoever has so many, and wants more, is asked whether they are of use
THIRD = 1 / 3  # of the rays, after which noise must have fallen since
STEPS_OF_RAYS = (8, 16, 32, 64, 128, 256, 512, 1024)  # of a replicate at some objects
TESTED = 0.05  # of the square of the noise that is allowed may be that of direct light
FEWEST_TESTED = 8  # rays of a replicate go with test rays, if any do
RARE = 1e-3  # objects darker than this share of the scene's mean are not looked at one by one


@dataclass(frozen=True)
class Estimate:
    """The error of a bake, as shares of its light (root mean square).

    total: of all points but those that lie in a corner, which were moved out of it. interior: without those on a crease
    or an open edge too. Of what is further off of both, sampling, patches and solve: its parts, whose squares add up to
    its own; noise: the part that more rays take away, the filter's blur with it; shared: the rest, as
    far as it is certain; doubt: standard error of its square; averaged: what patches average away. objects: (O,) error
    of each object, NaN where it is too dark or was not baked, and object_noise (O,) the noise of it.
    """

    total: float = 0.0
    interior: float = 0.0
    sampling: float = 0.0
    patches: float = 0.0
    solve: float = 0.0
    noise: float = 0.0
    shared: float = 0.0
    doubt: float = 0.0
    averaged: float = 0.0
    objects: np.ndarray = None
    object_noise: np.ndarray = None

    @property
    def furthest(self):
        """The error of all points, or of the interior if that is larger: narrow things that get most of the light have
        hardly a point that is on no edge, and what they are off by says nothing of the rest."""
        return max(self.total, self.interior)

    def worst(self):
        """(object, error) of the object that is furthest off, or None."""
        if self.objects is None or np.isnan(self.objects).all():
            return None
        worst = int(np.nanargmax(self.objects))
        return worst, float(self.objects[worst])


def estimate_error(points, light, control, free, bound, more=0.0):
    """The Estimate of a Light, from a traced Control. free: (P,) bool, points that do not lie in a corner; bound:
    certified, of the solve. more: (P,) variance of what points get instead of what light says of them."""
    power = points.area * (light.total * light.total).sum(axis=0)
    scatter = points.area * (light.variance.sum(axis=0) + more)
    count = int(points.object.max(initial=-1)) + 1
    if not power.sum() > 0:
        return Estimate(objects=np.full(count, np.nan), object_noise=np.zeros(count))
    ids, weight = control.ids, control.weight
    blurred, shared = points.area * light.blurred, shared_by_replicates(light, control)
    averaged = weight * mean_product(control.patches, control.each)

    def parts(chosen):
        """Shares of the light's power: all that it is off by, noise, what replicates share for certain, the standard error
        of what they share, and what patches average away."""
        whole, mine = max(power[chosen].sum(), 1e-300), shared * chosen[ids]
        spread = len(ids) * (mine * mine).sum() - mine.sum() ** 2
        doubt = np.sqrt(max(spread, 0.0) / max(len(ids) - 1, 1)) / whole
        noise, blur = scatter[chosen].sum() / whole, max(blurred[chosen].sum() / whole, 0.0)
        common = max(mine.sum() / whole - DOUBT * doubt, blur)
        certain = max(mine.sum() / whole - CERTAIN * doubt - blur, 0.0)
        return noise + common, noise + blur, certain, doubt, max((averaged * chosen[ids]).sum() / whole, 0.0)

    inside = free & points.smooth
    whole = parts(free)
    within = parts(inside) if power[inside].sum() > 0 else whole
    furthest = max(whole, within)  # by their totals
    far, common = furthest[0], furthest[0] - furthest[1]
    solve = min(bound * bound, common)
    patches = min(furthest[4], common - solve)
    return Estimate(
        *(
            float(np.sqrt(x))
            for x in (whole[0], within[0], max(far - patches - solve, 0.0), patches, solve, *furthest[1:3])
        ),
        float(furthest[3]),
        float(np.sqrt(max(min(furthest[4], common), 0.0))),
        *_of_objects(points, power, scatter, blurred, shared - weight * light.blurred[ids], ids, whole[0] - whole[1]),
    )


def shared_by_replicates(light, control):
    """(K,) square of what a Light is off by, less its noise, at the points of a traced Control, times their weights."""
    off = mean_product(light.total[:, control.ids] - control.truth, control.each)
    return control.weight * (off - light.variance[:, control.ids].sum(axis=0))


def share_of_light(variance, points, light, free):
    """What a variance (P,) [W^2/m^4] is of the power of a Light, as the error is counted: of the free points, (P,) bool, or
    of the interior ones if that is more."""
    noise, power = points.area * variance, points.area * (light.total * light.total).sum(axis=0)
    parts = (part for part in (free, free & points.smooth) if power[part].sum() > 0)
    return float(max((noise[part].sum() / max(power[part].sum(), 1e-300) for part in parts), default=0.0))


def mean_product(values, rays):
    """(K,) mean of the products, summed over channels, of any two of values (M, C, K), by their rays (M,): the noise of
    one never meets itself. Of many values there are more pairs than of two halves of them, so that what is left of the
    noise is as small with up to 30 % fewer rays."""
    rays = rays.astype(float)
    weighted = rays[:, None, None] * values
    square, own = weighted.sum(axis=0) ** 2, (weighted * weighted).sum(axis=0)
    return (square - own).sum(axis=0) / (rays.sum() ** 2 - (rays * rays).sum())


def _of_objects(points, power, scatter, blurred, shared, ids, common):
    """Error (O,) of each object, and the noise (O,) of it. A few control points lie on each: what they show of it is mixed
    with what is known of the whole, by their number."""
    count = int(points.object.max()) + 1
    own, area = np.bincount(points.object, power, count), np.bincount(points.object, points.area, count)
    scatter, blurred = (np.bincount(points.object, part, count) for part in (scatter, blurred))
    noise = ratio(scatter + np.maximum(blurred, 0.0), own)
    number = np.bincount(points.object[ids], minlength=count)
    seen, squares = (np.bincount(points.object[ids], part, count) for part in (shared, shared * shared))
    doubt = np.sqrt(np.maximum(number * squares - seen * seen, 0.0) / np.maximum(number - 1, 1))
    seen = ratio(seen - DOUBT * doubt, own)
    trust = number / (number + 16.0)
    error = np.sqrt(noise + np.maximum(trust * seen + (1 - trust) * common, 0.0))
    mean = np.sqrt(ratio(own, area))
    return np.where(mean > RARE * np.sqrt(power.sum() / points.area.sum()), error, np.nan), np.sqrt(noise)


def rays_wanted(estimate, rays, error):
    """How many rays another replicate should have to come to an error, 0 if it would be of no use. rays: of a point so
    far."""
    goal = noise_wanted(estimate, error)
    if estimate.noise**2 <= goal:
        return 0
    wanted = range(max(8, int(WORTH * rays)), MOST_RAYS)
    return min(
        wanted.start + bisect_left(wanted, -goal, key=lambda n: -noise_after(estimate.noise, rays, n)), MOST_RAYS
    )


def stalls(rays, noise):
    """Whether more rays are of no use: with three times as many the noise is about what it was, and so it was before. Once it may be
    that rare bright light was met for the first time; that falls. rays: (K,) of a point after each replicate; noise: function
    that returns the noise after the first so many of them."""
    count = len(rays)
    if not count or rays[-1] < MANY_RAYS:
        return False
    for _ in range(2):
        before = int(np.searchsorted(rays, THIRD * rays[count - 1], side="right"))
        if before < 2:  # of one alone nothing is known
            return False
        # By chance it falls with the power 0.5 of the rays, and with lattice and filter with 0.69: half of that is too little.
        if noise(count) <= noise(before) * np.sqrt(np.sqrt(rays[before - 1] / rays[count - 1])):
            return False
        count = before
    return True


def noise_wanted(estimate, error):
    """Square of the noise that an error allows, infinite where it is reached.

    If what replicates share is for certain so much that the error cannot be reached, the noise is made small beside it.
    """
    if estimate.furthest <= ENOUGH * error:
        return np.inf
    return max((AIM * error) ** 2 - estimate.shared**2, (SMALL * max(estimate.shared, error)) ** 2)


def rays_tested(noise, rays, goal, most):
    """With how many of `most` rays of another replicate test rays toward sources are to go: as many as make the noise of
    direct light, of square `noise` after `rays` so far, TESTED of what is allowed, of square goal. Where many small sources
    light a room, those of all rays took half of the time, for less than 5 % of the noise (measured)."""
    if noise <= TESTED * goal or not most:
        return 0
    wanted = rays * (noise / max(TESTED * goal, 1e-300) - 1)
    return int(min(max(wanted, FEWEST_TESTED), most))


def rays_by_object(estimate, rays, error):
    """(O,) how many rays another replicate should have at the points of each object to bring it to an error; 0 where it
    has enough, or where they would be of no use. rays: (O,) of its points so far. Few different numbers, so that few
    replicates do.
    """
    total, noise = np.nan_to_num(estimate.objects), estimate.object_noise
    shared = np.maximum(total * total - noise * noise, 0.0)
    goal = np.maximum((AIM_EACH * error) ** 2 - shared, SMALL * SMALL * np.maximum(shared, error**2))
    wanted = np.zeros(len(total), np.int64)
    short = (total > ENOUGH_EACH * error) & (noise * noise > goal) & (rays > 0)
    for more in STEPS_OF_RAYS:
        wanted[short] = more
        short &= noise_after(noise, rays, more) > goal
    return wanted


def noise_after(noise, rays, more):
    """Square of the noise after `more` rays a point, when it was `noise` after `rays`: lattice and filter together let the
    variance fall with about the power -1.375 of their number (measured on nine scenes)."""
    x = rays / (rays + more)
    return noise * noise * x * np.sqrt(np.sqrt(x)) * np.sqrt(np.sqrt(np.sqrt(x)))
