"""Guided rays: toward the few patch sides that bring much of the light and that rays spread over a hemisphere seldom meet.

Owns the choice of those sides, and the rays that set out toward them beside the others. A place on such a side is met by
one of n rays over the hemisphere with some density, and by one of m guided rays with another; what it sends counts by both,
whichever ray has met it (the balance heuristic of Veach and Guibas 1995). So nothing is counted twice, nothing is left
out, and a place that is very near brings no more than it should.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .patches import draw_on_patches
from .sampling import GOLDEN, R2, morton_order, scatter
from .scene import normal_and_area
from .vectors import by_coordinate, length, ratio, unit

MOST_SIDES = 4096  # that rays are guided to
MOST_GROUPS = 64  # of sides that lie together, which are picked first
BRIGHT = 3.0  # times what rays bring in the mean: as much light a side has that rays are guided to
SELDOM = 0.1  # of the rays may meet those sides at most: they find well what they meet often
WORTH = 0.4  # of the variance may be left without those sides, or guiding to them does not pay
MOSTLY = 2.0  # times as many bright sides as rays have met are few enough to guide rays to all of them
LOOK_RAYS = 1 << 15  # that tell how much bright sides matter, and as many which of them can be seen
FILTERED = 20.0  # rays that one stands for with the filter's help: so many fewer a point needs of reflected light
SHARP = 1.5  # the same for light that faces emit: the filter keeps away from the edges of its shadows
PAYS = 8.0  # times the rays that guiding costs first must be needed at the points without it, or it does not pay
SLANT = 0.05  # least cosine that a group is picked with: its middle may be hidden by the horizon, its rim not
NEAR = 1e-3  # share of the way by which a ray may miss the place that it was sent to
GUIDED = 0  # salt of the sample sequences
STEPS = (R2[0], R2[1], GOLDEN)  # from point to point of the samples' shifts


@dataclass(frozen=True)
class Guide:
    """Sides (G,) int32 that rays are guided to, sorted, and power (G,) of each, to pick them by."""

    sides: np.ndarray
    power: np.ndarray

    def __len__(self):
        return len(self.sides)


NOTHING = Guide(np.zeros(0, np.int32), np.zeros(0))


def bright_sides(hits, weight, direct, light, found, area, error, points, cost):
    """(2 N,) bool, sides to guide rays to if they can be seen; none if that is not called for at an error.

    hits: (K, n) int32 sides that the rays of rows met, cells of the sky as negative numbers; weight, direct: (K,) of
    each row's side, and irradiance that it has without rays; light: (2 N + M,) of the sides and the sky's cells; found:
    (2 N,) the part of it that sides emit; area: (2 N,). points: number of points that will be gathered at; cost: rays
    that it takes to find first what bright sides bring. What a ray brings has a second moment, of which the bright
    sides have their part; what remains without them must be little beside the variance, and that so much that fewer
    rays at the points make good for the cost.
    """
    rays, none = hits.shape[1], np.zeros(len(area), bool)
    wanted = np.flatnonzero(weight > 0)
    if rays < 2 or not len(wanted):
        return none
    wanted = wanted[:: max(len(wanted) * rays // LOOK_RAYS, 1)]
    hits, direct, share = hits[wanted], direct[wanted], weight[wanted] / weight[wanted].sum()
    met = np.take(light, hits, mode="wrap")
    each, sums = np.einsum("kn->k", met * met), np.einsum("kn->k", met)
    second = float((share * each).sum()) / rays
    mean = max(float((share * (sums * sums - each)).sum()) / (rays * (rays - 1)), 0.0)  # of its square
    whole = float((share * (direct * direct + 2 * direct * sums / rays)).sum()) + mean
    bright = (light[: len(area)] > BRIGHT * np.sqrt(mean)) & (area > 0)
    there = (hits >= 0) & np.take(bright, hits, mode="clip")
    if float((share * there.sum(axis=1)).sum()) / rays > SELDOM:
        return none
    rest = np.where(there, 0.0, met)
    if not second > mean or float((share * np.einsum("kn->k", rest * rest)).sum()) / rays > WORTH * (second - mean):
        return none
    emitted = np.where(hits >= 0, np.take(found, hits, mode="clip"), 0.0)
    sharp = float((share * np.einsum("kn->k", emitted * emitted)).sum()) / rays / second
    needed = (second - mean) * (sharp / SHARP + (1 - sharp) / FILTERED) / max(error * error * whole, 1e-300)
    return bright if points * needed > PAYS * (cost + LOOK_RAYS) else none


def make_guide(bright, hits, light, area):
    """The Guide to those of bright sides (2 N,) bool that rays met: hits (K, n), which have nothing to do with those of any
    row, or it would lack just what its row has missed. light: (2 N,) of sides, at least."""
    seen = np.zeros(len(area), bool)
    seen[hits[hits >= 0]] = True
    seen &= bright
    # Of most of them seen, the others may be seen too, now and then.
    sides = np.flatnonzero(bright if np.count_nonzero(bright) <= MOSTLY * np.count_nonzero(seen) else seen)
    sides = np.sort(sides[np.argsort(-light[sides], kind="stable")[:MOST_SIDES]]).astype(np.int32)
    return Guide(sides, light[sides] * area[sides])


class Aim:
    """Rays from K places toward the sides of a guide."""

    def __init__(self, guide, position, normal):
        """guide: the GuideGeometry of a kernel. position, normal: (K, 3) of the places, or near them."""
        self._guide = guide
        self._likely = guide.likely(position, normal)
        self._upto = np.cumsum(self._likely, axis=1, dtype=float)

    def rays(self, position, u, a, b):
        """Directions (3, K, m) float32 from places (K, 1 or m, 3), by samples u, a, b (K, m) in [0, 1). Where nothing
        can be seen of the guide's sides they go anywhere, and count for nothing."""
        guide, row = self._guide, np.arange(len(u))[:, None]
        target = u * self._upto[:, -1:]
        group = np.minimum((self._upto[:, None] <= target[:, :, None]).sum(axis=2), guide.groups - 1)
        # What is left of the sample picks a side of the group.
        left = ratio(target - self._upto[row, group], self._likely[row, group]) + 1.0
        self._pick, place = guide.sides_of(group, left, a, b)
        toward = place - position
        distance = length(toward)
        self._distance = distance * guide.scale
        direction = np.empty((3, *group.shape), np.float32)
        direction[:] = np.moveaxis(toward / np.maximum(distance, 1e-300)[..., None], -1, 0)
        return direction

    def weights(self, hit, directions, normal, hemisphere_rays):
        """(K, n + m) what each ray counts: hit: Hits of K * (n + m) rays, n over the hemisphere first, then m guided ones;
        directions: (3, K, n + m); normal: (K, 1 or n + m, 3) of the places."""
        guide, n = self._guide, hemisphere_rays
        m = directions.shape[2] - n
        number = guide.numbers(hit.side).reshape(-1, n + m)
        weight = np.zeros(number.shape)
        weight[:, :n] = 1.0 / n
        distance = hit.distance.reshape(number.shape).astype(float)
        lost = (number[:, n:] != self._pick) | (np.abs(distance[:, n:] - self._distance) > NEAR * self._distance)
        lost |= self._upto[:, -1:] == 0
        number[:, n:][lost] = -1
        row, ray = np.nonzero(number >= 0)
        chosen, way = number[row, ray], directions[:, row, ray].astype(float)
        up = np.broadcast_to(normal, (*number.shape, 3))[row, ray]
        facing = guide.normals(hit.triangle.reshape(number.shape)[row, ray])
        cosine = way[0] * up[:, 0] + way[1] * up[:, 1] + way[2] * up[:, 2]
        there = np.abs(way[0] * facing[:, 0] + way[1] * facing[:, 1] + way[2] * facing[:, 2])
        picked = self._likely[row, guide.group[chosen]] * guide.share[chosen] / np.maximum(self._upto[row, -1], 1e-300)
        square = distance[row, ray] ** 2
        # Densities over the side's area of rays over the hemisphere, and of guided ones.
        p = np.maximum(cosine, 0.0) * there * guide.area[chosen]
        q = np.pi * square * picked
        weight[row, ray] = ratio(p, n * p + m * q)
        return weight


class GuideGeometry:
    """The sides of a Guide as rays need them, in groups of those that lie together and face the same way. Lengths are those
    of the space that is traced."""

    def __init__(self, kernel):
        patches, caster = kernel.patches, kernel.caster
        sides, power = kernel.arrays["guide.sides"], kernel.arrays["guide.power"]
        normal = patches.normal[sides >> 1] * np.where(sides & 1, -1.0, 1.0)[:, None]
        middle = (patches.centroid[sides >> 1] - caster.frame[0]) * caster.frame[1]
        axis = np.argmax(np.abs(normal), axis=1)
        way = 2 * axis + (np.take_along_axis(normal, axis[:, None], axis=1)[:, 0] < 0)
        place = morton_order(middle)
        order = place[np.argsort(way[place], kind="stable")]
        self.order = order  # of the guide's sides, group by group
        self.sides, self.scale, self._patches, self._place = sides[order], caster.frame[1], patches, caster.place
        self.area = patches.area[self.sides >> 1] * self.scale**2
        power, normal, middle = power[order], normal[order], middle[order]
        self.groups = min(len(sides), MOST_GROUPS)
        self.group = np.arange(len(sides)) * self.groups // len(sides)
        self._upto = np.append(0.0, np.cumsum(power))
        self._first = np.searchsorted(self.group, np.arange(self.groups))
        strength = np.bincount(self.group, power, self.groups)
        self.share = power / strength[self.group]
        self._number = np.full(2 * len(patches), -1, np.int32)
        self._number[self.sides] = np.arange(len(sides))
        self._vertices, self._triangles = kernel.vertices, kernel.triangles

        def mean(values):
            return np.stack([np.bincount(self.group, self.share * x, self.groups) for x in values.T], axis=1)

        center = mean(middle)
        reach = np.zeros(self.groups)
        np.maximum.at(reach, self.group, length(middle - center[self.group]) + np.sqrt(self.area))
        self.center, self.normal = center.astype(np.float32), unit(mean(normal)).astype(np.float32)
        self.reach, self.strength = reach.astype(np.float32), (strength / strength.max()).astype(np.float32)

    def sides_of(self, group, left, a, b):
        """Numbers (K, m) of sides that are picked from groups (K, m) by samples `left` (K, m), and places (K, m, 3) on
        them, by a, b (K, m)."""
        first = self._first[group]
        last = np.append(self._first[1:], len(self.sides))[group]
        target = self._upto[first] + left * (self._upto[last] - self._upto[first])
        pick = np.clip(np.searchsorted(self._upto, target, side="right") - 1, first, last - 1)
        place = draw_on_patches(self._patches, self.sides[pick.reshape(-1)] >> 1, a.reshape(-1, 1), b.reshape(-1, 1))[0]
        return pick, place.reshape(*pick.shape, 3)

    def numbers(self, side):
        """(K,) number of sides (K,) that rays met among the guide's, group by group; -1 of all others and the sky."""
        return np.where(side >= 0, np.take(self._number, side, mode="clip"), -1)

    def normals(self, triangle):
        """(K, 3) unit normals of triangles (K,)."""
        corners = np.take(self._triangles, triangle, axis=0).T
        return normal_and_area(*(by_coordinate(np.take(self._vertices, corner, axis=0)) for corner in corners))[0]

    def likely(self, position, normal):
        """(K, groups) float32 roughly what each group may give places (K, 3), if nothing stands between."""
        x, n = self._place(position), normal.astype(np.float32)
        square = np.zeros((len(x), self.groups), np.float32)
        rise, tilt = np.zeros_like(square), np.zeros_like(square)
        for k in range(3):
            toward = self.center[:, k] - x[:, k, None]
            square += toward * toward
            rise += toward * n[:, k, None]
            tilt -= toward * self.normal[:, k]
        away = (rise < -self.reach) | (tilt < -self.reach)
        slant = np.float32(SLANT) * np.sqrt(square)
        np.maximum(rise, slant, out=rise)
        rise *= np.maximum(tilt, slant, out=tilt)
        square += self.reach * self.reach
        rise *= self.strength / (square * square)
        rise[away] = 0.0
        return rise


def guide_samples(ids, count, seed):
    """Samples u, a, b (K, count) in [0, 1) of the guided rays of points ids (K,)."""
    place, number = np.asarray(ids, np.int64)[:, None], np.arange(count)
    shift = scatter(np.arange(3), GUIDED + 8 * seed)
    u = (number + (place * STEPS[2] + shift[0]) % 1.0) / count
    a, b = ((place * STEPS[k] + number * R2[k] + shift[k + 1]) % 1.0 for k in range(2))
    return u, a, b
