"""A crowd of sources: too many to be tested one by one, so every place picks some of them by what they may give it.

Owns the record `Crowd`, what its members may give places, and the picks. Members are small: lamps, and flat pieces of
faces and area lamps. What one may give, with nothing in between, is known well from its center, and exactly where it is
near. Members lie in an order that keeps neighbors together, and the picks of a place are spread evenly over the sum of
all that they may give: so each part of the crowd gets its share of the test rays, and what the members would give
unhindered has next to no noise. Only shadows are left to chance.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from time import thread_time

import numpy as np

from .lights import BALL, FLAT, MOST_SOURCES, SHORT, effect_of
from .polygons import polygon_factor
from .sampling import GOLDEN, R2, fraction, morton_order, scatter, tangents
from .vectors import by_coordinate, counted, cross, dot, length, ratio

LARGE = 0.03  # of the scene's diagonal: a source that reaches further is tested alone, if there are not many such
MOST_PIECES = 64  # of a larger one
NEARBY = 0.2  # a flat member that reaches further than this share of the distance is near: its exact factor is taken
CLOSE = 0.3  # the same where one place must stand for the whole member
LONG = 2.0  # times as long as wide a piece may be
SLIM = 4.0  # square of its reach, as a multiple of its area, from which on a source is much longer than wide
PART = 0.25  # of its reach: what a member that the horizon cuts is thought to rise above it, at least
RIM = 0.05  # share of a lamp's light that it is thought to give where only a part of it may shine
GROUP, MOST_GROUPS = 8, 256  # members of a group, of which a single place picks one; and how many groups, about
ALIKE = 1e-3  # difference of normals that are one
SPACING = 0.25  # of members of a group, as a share of its reach: none is thought nearer
BLOCK = 1 << 16  # pairs of a place and a member at a time: they stay in the processor's cache
AT_ONCE = 1 << 20  # pairs that are kept for the picks
SMALLEST = np.float32(1e-15)  # square of a distance in units: its own square is still a number
PICK = 7  # salt of the sample sequences


@dataclass(frozen=True)
class Crowd:
    """M members, F flat ones first, then lamps without extent or like balls.

    source: (M,) number of the source that each is (a piece) of. center: (M, 3); normal: (M, 3) unit, the way that it
    shines; reach: (M,) [m]. power: (M,) mean strength of its channels, color: (M, C) in units of that. cone: (M, 2),
    see Sources. Of the flat ones frame: (F, 3, 3) a corner and two edges from there, square: (F,) bool, a
    parallelogram, else a triangle; area: (F,) [m^2]; two_sided: (F,) bool. Of the others radius: (M - F,), soft: (M -
    F,) bool. effect: that most belong to. unit: [m] lengths are counted in it where members are compared: float32 holds
    no squares of squares of any length.
    """

    source: np.ndarray
    center: np.ndarray
    normal: np.ndarray
    reach: np.ndarray
    power: np.ndarray
    color: np.ndarray
    cone: np.ndarray
    frame: np.ndarray
    square: np.ndarray
    area: np.ndarray
    two_sided: np.ndarray
    radius: np.ndarray
    soft: np.ndarray
    effect: str
    unit: float

    def __len__(self):
        return len(self.source)

    @property
    def flats(self):
        """Number of the flat members."""
        return len(self.area)

    @cached_property
    def corners(self):
        """(F, 4, 3) of the flat members, a triangle's last one twice."""
        p, a, b = np.moveaxis(self.frame, 1, 0)
        return np.stack([p, p + a, np.where(self.square[:, None], p + a + b, p + b), p + b], axis=1)

    @cached_property
    def _relative(self):
        """The power of members (M,), in units of the strongest's, and what that is [W/m^2]: of lamps at a distance of
        one unit."""
        power = self.power.copy()
        power[self.flats :] /= self.unit * self.unit
        top = float(power.max())
        return ratio(power, top), top

    @cached_property
    def _rough(self):
        """What `likely` works on, float32 in its units: the middle of the crowd [m], and center, normal (3, M), reach,
        power, cone; and of the flat ones area, of the others radius."""
        middle, unit = self.center.mean(axis=0), self.unit
        parts = (self.center - middle).T / unit, self.normal.T, self.reach / unit, self._relative[0], self.cone.T
        return middle, *(np.ascontiguousarray(x, np.float32) for x in (*parts, self.area / unit**2, self.radius / unit))

    def likely(self, position, normal, extent=None):
        """(K, M) float32 roughly what each member may give places (K, 3), mean of the channels, in units of what the
        strongest is (see `_relative`); positive unless it can give nothing. extent: (K,) how far what a place stands
        for reaches around it [m]."""
        result = np.empty((len(position), len(self)), np.float32)
        size = max(BLOCK // max(len(self), 1), 1)
        for k in range(0, len(position), size):
            part = slice(k, k + size)
            place = self._place(position[part], normal[part], None if extent is None else extent[part])
            for flat, members in ((True, slice(0, self.flats)), (False, slice(self.flats, len(self)))):
                if members.start < members.stop:
                    result[part, members] = self._likely(*place, flat, members)
        return result

    def _place(self, position, normal, extent=None):
        """Places, normals and extents (K, 1) as `_likely` wants them."""
        around = np.zeros((len(position), 1), np.float32)
        if extent is not None:
            around[:, 0] = extent / self.unit
        return ((position - self._rough[0]) / self.unit).astype(np.float32), normal.astype(np.float32), around

    def _likely(self, x, n, around, flat, members):
        """(K, N) `likely` of members that are all flat, or all not: a slice of N, or (K, N) of each place."""
        _, center, axis, reach, power, cone, area, radius = self._rough
        reach, power, cone = reach[members], power[members], cone[:, members]
        directed = flat or (cone[0] > -1).any()
        square = rise = tilt = np.float32(0)
        for k in range(3):
            toward = center[k, members] - x[:, k, None]
            rise = toward * n[:, k, None] + rise
            if directed:
                tilt = tilt - toward * axis[k, members]
            toward *= toward
            square = square + toward
        wide = reach + around
        above = rise > -wide
        np.maximum(rise, np.float32(PART) * wide, out=rise)
        rise *= above
        np.maximum(square, around * around, out=square)
        np.maximum(square, SMALLEST, out=square)
        if flat:
            area, two_sided = area[members], self.two_sided[members]
            height = np.abs(tilt) if two_sided.all() else np.where(two_sided, np.abs(tilt), tilt)
            rise *= height > -around
            np.maximum(height, np.float32(PART) * around, out=height)
            rise *= height
            rise *= area * power
            rise /= square * (np.float32(np.pi) * square + area)
            if (cone[0] > 0).any():
                rise *= _rough_spread(_over(height, np.sqrt(square)), cone, wide / np.sqrt(square))
            return rise
        distance = np.sqrt(square)
        own = members - self.flats if isinstance(members, np.ndarray) else slice(members.start - self.flats, None)
        radius = radius[own]
        rise *= power
        rise /= distance * np.where(self.soft[own], square + radius * radius, np.maximum(square, radius * radius))
        if directed:
            rise *= _rough_cone(tilt / distance, cone, wide / distance)
        return rise

    def flux(self):
        """Power that all members send out [W], mean of the channels."""
        ball = np.full(len(self) - self.flats, 4 * np.pi)
        return float((self.power * np.append(self.area * np.where(self.two_sided, 2.0, 1.0), ball)).sum())

    def slope(self, position, normal, extent):
        """(K,) how much what the members give patches with their centers (K, 3) and extents (K,) [m] changes there,
        about: the sum of what each gives over its distance [W/m^3]."""
        slope, size = np.zeros(len(position)), max(BLOCK // len(self), 1)
        middle, center, _, reach, *_ = self._rough
        for k in range(0, len(position), size):
            part = slice(k, k + size)
            given = self.likely(position[part], normal[part], extent[part] / 2)
            x, square = ((position[part] - middle) / self.unit).astype(np.float32), reach * reach
            for d in range(3):
                toward = center[d] - x[:, d, None]
                square = toward * toward + square
            slope[part] = np.cumsum(given / np.sqrt(square + SMALLEST), axis=1, dtype=float)[:, -1]
        return slope * (self._relative[1] / self.unit)

    def exact(self, position, normal, member):
        """(K,) irradiance per unit of strength that flat members (K,) would give places (K, 3) with nothing in between."""
        factor = polygon_factor(position, normal, self.corners[member])
        front = dot(position - self.center[member], self.normal[member]) > 0
        return np.where(self.two_sided[member] | front, factor, 0.0)

    def from_one(self, caster, member, position, normal, start, a, b, occluded=True):
        """What `test` says of places where one on the member stands for all of it: where that is so close that one says
        little of the others, its exact factor is taken."""
        factor, seen = self.test(caster, member, position, normal, normal, start, a, b, occluded)
        away = position - self.center[member]
        flat = (member < self.flats) & (self.cone[member, 0] <= 0)
        close = np.flatnonzero(flat & (self.reach[member] > CLOSE * length(away)) & (factor > 0))
        if len(close):
            factor[close] = self.exact(position[close], normal[close], member[close])
        return factor, seen

    def test(self, caster, member, position, normal, geometric, start, a, b, occluded=True):
        """Irradiance (K,) per unit of strength that places get from members (K,), as the places a, b (K,) on them tell, and
        (K,) bool whether they are seen from there. position, normal, geometric, start: see `lights.test_rays`."""
        factor, seen = np.zeros(len(member)), np.ones(len(member), bool)
        flat = member < self.flats
        for chosen, one in ((np.flatnonzero(flat), self._flat_place), (np.flatnonzero(~flat), self._ball_place)):
            if not len(chosen):
                continue
            m, place, up = member[chosen], position[chosen], normal[chosen]
            aim, toward, light, lift = one(m, place, up, a[chosen], b[chosen])
            if geometric is not normal:
                light = np.where(dot(toward, geometric[chosen]) > 0, light, 0.0)
            factor[chosen] = light
            cast = np.flatnonzero(light)
            if not occluded or not len(cast):
                continue
            own = chosen[cast]
            if lift is None:
                blocked = caster.blocked(start[own], caster.place(aim[cast]), a[own], reach=SHORT)
            else:
                blocked = caster.blocked(start[own], caster.start(aim[cast], lift[cast]), a[own])
            seen[own] = ~blocked
        return factor, seen

    def _flat_place(self, m, position, normal, a, b):
        """Places on flat members (K,), the ways there (K, 3), what the places tell of the light, and normals above
        which they lie."""
        fold = ~self.square[m] & (a + b > 1.0)
        u, v = np.where(fold, 1.0 - a, a)[:, None], np.where(fold, 1.0 - b, b)[:, None]
        frame = self.frame[m]
        aim = frame[:, 0] + u * frame[:, 1] + v * frame[:, 2]
        toward = by_coordinate(aim - position)
        square, axis, area = dot(toward, toward), self.normal[m], self.area[m]
        height = -dot(toward, axis)
        light = np.maximum(dot(toward, normal), 0.0) * np.where(
            self.two_sided[m], np.abs(height), np.maximum(height, 0)
        )
        light *= ratio(area, np.pi * square * square)
        edge, factor = self.cone[m].T
        narrow = np.flatnonzero((edge > 0) & (light > 0))
        if len(narrow):
            cosine = height[narrow] / np.sqrt(square[narrow])
            tangent = np.sqrt(np.maximum(1.0 - cosine * cosine, 0.0)) / cosine
            light[narrow] *= np.maximum(edge[narrow] - tangent, 0.0) * factor[narrow]
        return aim, toward, light, axis * np.where(height < 0, -1.0, 1.0)[:, None]

    def _ball_place(self, m, position, normal, a, b):
        """The same for members that are not flat; of no normals."""
        own = m - self.flats
        radius, center = self.radius[own], self.center[m]
        straight = by_coordinate(center - position)
        square = dot(straight, straight)
        distance = np.sqrt(square)
        aim = center
        if radius.any():
            t1, t2 = tangents(straight / np.maximum(distance, 1e-300)[:, None])
            out, turn = radius * np.sqrt(a), 2 * np.pi * b
            aim = center + (out * np.cos(turn))[:, None] * t1 + (out * np.sin(turn))[:, None] * t2
        toward = by_coordinate(aim - position)
        weight = np.maximum(dot(toward, normal), 0.0)
        edge, blend = self.cone[m].T
        spot = np.flatnonzero(edge > -1)
        if len(spot):
            rise = -ratio(dot(toward[spot], self.normal[m[spot]]), length(toward[spot])) - edge[spot]
            ramp = np.clip(rise / np.maximum((1.0 - edge[spot]) * blend[spot], 1e-12), 0.0, 1.0)
            weight[spot] *= ramp * ramp * (3.0 - 2.0 * ramp)
        wide = square + radius * radius
        light = ratio(weight, distance * np.where(self.soft[own], wide, np.maximum(square, radius * radius)))
        cut = (dot(straight, normal) ** 2 * wide < square * radius * radius) & (radius > 0)  # the horizon cuts the disk
        light = np.where(cut, distance * ratio(weight, (square + radius * radius * a) ** 2), light)
        return aim, toward, light, None

    def at_points(self, caster, ids, position, normal, geometric, count, seed, occluded=True):
        """(C, K) light that points (K, 3) get [W/m^2], by so many test rays as count(light), (K,) of what they may get,
        says. ids: (K,) numbers of them, which tell their samples apart."""
        light = np.zeros((self.color.shape[1], len(ids)))
        start, begun = caster.start(position, geometric), thread_time()
        for part in self._parts(ids):
            place, up = position[part], normal[part]
            likely = self.likely(place, up)
            near = self._set_near(likely, place, up)
            upto = np.cumsum(likely, axis=1, dtype=float)
            total = upto[:, -1]
            number = np.where(total > 0, count(total * self._relative[1]), 0)
            owner, member, x = self._picks(upto, number, ids[part], seed)
            own = (place[owner], up[owner])
            facing = own[1] if geometric is normal else geometric[part][owner]
            factor, seen = self.test(caster, member, *own, facing, start[part][owner], *x, occluded)
            # A near member is worth its exact factor, whatever the places tell on the whole.
            close = near[owner, member]
            begin = np.flatnonzero(np.append(True, (owner[1:] != owner[:-1]) | (member[1:] != member[:-1])))
            if len(owner) and close.any():
                size_ = np.diff(np.append(begin, len(owner)))
                mean = np.repeat(np.add.reduceat(factor, begin) / size_, size_)
                exact = ratio(likely[owner, member], self._relative[0][member])
                factor = np.where(close, ratio(factor, mean) * exact, factor)
            worth = ratio(factor * seen * self.power[member] * total[owner], number[owner] * likely[owner, member])
            for channel, color in zip(light[:, part], self.color.T):
                channel[:] = np.bincount(owner, worth * color[member], len(total))
        for part in (self.effect, *(("occlusion",) if occluded else ())):
            caster.note(part, begun)
        return light

    def _set_near(self, likely, position, normal):
        """Set what near members give places to what it is, and tell which they are, (K, M) bool."""
        near = np.zeros(likely.shape, bool)
        middle, center, _, reach, *_ = self._rough
        limit = (reach[: self.flats] / np.float32(NEARBY)) ** 2
        limit[self.cone[: self.flats, 0] > 0] = 0.0
        size = max(BLOCK // max(self.flats, 1), 1)
        for k in range(0, len(likely), size):
            x = ((position[k : k + size] - middle) / self.unit).astype(np.float32)
            square = np.zeros((len(x), self.flats), np.float32)
            for d in range(3):
                toward = center[d, : self.flats] - x[:, d, None]
                square += toward * toward
            near[k : k + size, : self.flats] = square < limit
        row, member = np.nonzero(near)
        if len(row):
            likely[row, member] = self.exact(position[row], normal[row], member) * self._relative[0][member]
        return near

    def _picks(self, upto, count, ids, seed):
        """The place (R,) and member (R,) of count (K,) picks of each of K places, and two samples (R,) each; upto: (K,
        M) sums of what the members may give. Picks of one place are in the order of the members."""
        owner, number = counted(count)
        shift = scatter(np.arange(3), PICK + 8 * seed)
        ids = np.asarray(ids, np.int64)[owner]
        target = (number + fraction(ids * GOLDEN + shift[0])) / count[owner] * upto[owner, -1]
        return owner, search_rows(upto, owner, target), [
            fraction(ids * R2[1 - k] + number * R2[k] + shift[k + 1]) for k in range(2)
        ]  # fmt: skip

    def on_patches(self, caster, center, extent, position, normal, a, b, occluded=True):
        """(C, K) mean irradiance [W/m^2] of patches with their centers (K, 3) and extents (K,) [m], of one member for
        each of the places (K, n, 3) on them. normal: (K, n, 3) at the places; a, b: (K, n) in [0, 1)."""
        light, places = np.zeros((self.color.shape[1], len(center))), a.shape[1]
        begun = thread_time()
        for part in self._parts(center):
            likely = self.likely(center[part], normal[part, 0], extent[part])
            upto = np.cumsum(likely, axis=1, dtype=float)
            lit = np.flatnonzero(upto[:, -1] > 0)
            owner, number = np.repeat(lit, places), np.tile(np.arange(places), len(lit))
            u = (number + fraction(a[part][lit, :1] * places).repeat(places)) / places
            member = search_rows(upto, owner, u * upto[owner, -1])
            place, up = (by_coordinate(x[part][lit].reshape(-1, 3)) for x in (position, normal))
            start = caster.start(place, up)
            x = (y[part][lit].reshape(-1) for y in (a, b))
            factor, seen = self.from_one(caster, member, place, up, start, *x, occluded)
            worth = ratio(factor * seen * self.power[member] * upto[owner, -1], places * likely[owner, member])
            for channel, color in zip(light[:, part], self.color.T):
                channel[:] = np.bincount(owner, worth * color[member], len(upto))
        for part in (self.effect, *(("occlusion",) if occluded else ())):
            caster.note(part, begun)
        return light

    @cached_property
    def _groups(self):
        """First (G,) and last (G,) member of groups that lie together, and of each, float32: the ends of the box around
        its members (3, G), the middle (3, G) of that, its reach and its power (G,); the normal (3, G) that all its
        members have, 0 if they have not, and (G,) whether they shine to both sides of it."""
        size, first = max(GROUP, len(self) // MOST_GROUPS), np.arange(0)
        for low, high in ((0, self.flats), (self.flats, len(self))):
            first = np.append(first, np.arange(low, high, size))
        last = np.append(first[1:], len(self))
        reach, away = self.reach[:, None] / self.unit, (self.center - self._rough[0]) / self.unit
        low, high = np.minimum.reduceat(away - reach, first), np.maximum.reduceat(away + reach, first)
        size = np.append(self.area / (np.pi * self.unit**2), np.ones(len(self) - self.flats))
        strength = np.add.reduceat(self._relative[0] * size, first)
        ends = np.minimum.reduceat(self.normal, first), np.maximum.reduceat(self.normal, first)
        alike = ((ends[1] - ends[0]).max(axis=1) < ALIKE) & (first < self.flats)
        axis = np.where(alike[:, None], ends[0], 0.0)
        both = np.minimum.reduceat(np.append(self.two_sided, np.ones(len(self) - self.flats, bool)), first)
        parts = low.T, high.T, (low + high).T / 2, length(high - low) / 2, strength, axis.T, both
        return first, last, *(np.ascontiguousarray(x, np.float32) for x in parts)

    def given(self, position, normal):
        """(K, G) float32 roughly what groups of members may give places (K, 3), to pick them by. As it falls off with the
        distance of both the nearest and the middle of the group, none that is long and near is thought too little of."""
        low, high, middle, reach, strength, axis, both = self._groups[2:]
        result = np.empty((len(position), len(strength)), np.float32)
        inside = np.maximum((np.float32(SPACING) * reach) ** 2, SMALLEST)
        size = max(BLOCK // len(strength), 1)
        for k in range(0, len(position), size):
            x, n, _ = self._place(position[k : k + size], normal[k : k + size])
            square = nearest = rise = tilt = np.float32(0)
            for d in range(3):
                own = x[:, d, None]
                toward = middle[d] - own
                rise = toward * n[:, d, None] + rise
                tilt = tilt - toward * axis[d]
                square = toward * toward + square
                toward = np.minimum(np.maximum(own, low[d]), high[d]) - own
                nearest = toward * toward + nearest
            np.maximum(square, SMALLEST, out=square)
            np.maximum(nearest, inside, out=nearest)
            above = rise > -reach
            np.maximum(rise, np.float32(PART) * reach, out=rise)
            rise *= above
            rise *= strength
            rise /= square * np.sqrt(nearest)
            if (axis != 0).any():
                tilt = np.where(both > 0, np.abs(tilt), tilt)
                shine = np.maximum(tilt, np.float32(PART) * reach) * (tilt > -reach)
                shine /= np.sqrt(square)
                rise *= np.where((axis != 0).any(axis=0), shine, np.float32(1))
            result[k : k + size] = rise
        return result

    def one(self, caster, position, normal, start, given, pick, a, b, occluded=True):
        """(C, K) light of places (K, 3) [W/m^2] from one member each, over the chance that it is picked with: first of
        a group, by what is `given`. pick, a, b: (K,) in [0, 1)."""
        first, last = self._groups[:2]
        row, upto = np.arange(len(pick)), np.cumsum(given, axis=1, dtype=float)
        target = pick * upto[:, -1]
        group = search_rows(upto, row, target)
        own = given[row, group].astype(float)
        left = np.clip(ratio(target - upto[row, group] + own, own), 0.0, SHORT)
        chance = ratio(own, upto[:, -1])
        begin, size = first[group], (last - first)[group]
        number = np.arange(size.max(initial=1))
        members = np.minimum(begin[:, None] + number, last[group][:, None] - 1)
        place, likely = self._place(position, normal), np.zeros(members.shape, np.float32)
        for flat in (True, False):
            rows = np.flatnonzero((begin < self.flats) == flat)
            if len(rows):
                likely[rows] = self._likely(*(x[rows] for x in place), flat, members[rows])
        upto = np.cumsum(likely * (number < size[:, None]), axis=1, dtype=float)
        chosen = search_rows(upto, row, left * upto[:, -1])
        chance *= ratio(likely[row, chosen], upto[:, -1])
        member = members[row, chosen]
        factor, seen = self.from_one(caster, member, position, normal, start, a, b, occluded)
        return ratio(factor * seen * self.power[member], chance) * self.color[member].T

    def _parts(self, places):
        """Slices of places, so few at a time that all that members give them can be kept."""
        size = max(AT_ONCE // len(self), 1)
        return [slice(k, k + size) for k in range(0, len(places), size)]


def search_rows(upto, row, target):
    """(R,) where target (R,) lies among the rising numbers of a row (R,) of upto (K, M): the first one that is above it."""
    count = upto.shape[1]
    flat, begin = upto.reshape(-1), row * count
    place, step = begin - 1, 1 << (int(count - 1).bit_length())
    while step:
        further = place + step
        inside = further < begin + count - 1  # the last one is above any target
        inside &= np.take(flat, np.where(inside, further, 0)) <= target
        place = np.where(inside, further, place)
        step >>= 1
    return place + 1 - begin


def _over(a, b):
    """a / b of float32 arrays, where b is not 0."""
    return a / np.maximum(b, np.float32(1e-30))


def _rough_cone(cosine, cone, wide):
    """Share of a spot's light toward the cosine of an angle to its axis, float32; wide: how far that is in doubt."""
    edge, blend = cone
    ramp = np.clip((cosine - edge) / np.maximum((1 - edge) * blend, np.float32(1e-6)), 0, 1)
    share = ramp * ramp * (3 - 2 * ramp)
    share = np.where((wide > 0) & (cosine > edge - wide), np.maximum(share, np.float32(RIM)), share)
    return np.where(edge > -1, share, np.float32(1))


def _rough_spread(cosine, cone, wide):
    """The same for a flat lamp of limited spread."""
    edge, factor = cone
    tangent = _over(np.sqrt(np.maximum(1 - cosine * cosine, 0)), cosine)
    share = np.maximum(edge - tangent, 0) * factor
    rim = np.float32(RIM) * edge * factor
    tangent = np.minimum(tangent, np.float32(1e6))
    turned = tangent - edge < 2 * wide * (1 + tangent * tangent)
    share = np.where(turned, np.maximum(share, rim), share)
    return np.where(edge > 0, share, np.float32(1))


def members_of(sources, diagonal):
    """(S,) bool: the Sources that are too many to be tested one by one. diagonal: of the scene [m]."""
    endless = sources.kind > BALL
    few = np.zeros(len(sources), bool)
    if np.count_nonzero(~endless) <= MOST_SOURCES:
        return few
    large = np.flatnonzero(sources.reaches > LARGE * diagonal)
    given = sources.strength[large].mean(axis=1) * sources.areas[large]
    strongest = np.argsort(-given, kind="stable")[:MOST_SOURCES]
    alone = endless.copy()
    alone[large[strongest]] = True
    return ~alone


def any_long(sources):
    """Whether any flat one of Sources is much longer than wide: one place on it says little of the others."""
    return bool((sources.reaches**2 > SLIM * sources.areas)[sources.kind == FLAT].any())


def make_crowd(sources, chosen, diagonal):
    """The Crowd of chosen Sources, (S,) bool; None if there are none. diagonal: of the scene [m]."""
    if not chosen.any():
        return None
    flat = np.flatnonzero(chosen & (sources.kind == FLAT))
    ball = np.flatnonzero(chosen & (sources.kind == BALL))
    owner, frame, square = _pieces(sources, flat, LARGE * diagonal)
    p, a, b = np.moveaxis(frame, 1, 0)
    middle = np.where(square[:, None], p + (a + b) / 2, p + (a + b) / 3)
    order = morton_order(middle)
    owner, frame, square, middle, a, b = (x[order] for x in (owner, frame, square, middle, a, b))
    ball = ball[morton_order(sources.position[ball])]
    source = np.concatenate([owner, ball])
    half = np.maximum(length(a + b), length(a - b)) / 2
    reach = np.where(square, half, np.maximum(length(a), np.maximum(length(b), length(a - b))) / 1.5)
    power = sources.strength[source].mean(axis=1)
    return Crowd(
        source=source,
        center=np.concatenate([middle, sources.position[ball]]),
        normal=sources.direction[source],
        reach=np.concatenate([reach, sources.radius[ball]]),
        power=power,
        color=ratio(sources.strength[source], power[:, None]),
        cone=sources.cone[source],
        frame=frame,
        square=square,
        area=length(cross(a, b)) * np.where(square, 1.0, 0.5),
        two_sided=sources.two_sided[owner],
        radius=sources.radius[ball],
        soft=sources.soft[ball],
        effect=effect_of(int(np.median(sources.origin[source]))),
        unit=float(diagonal) or 1.0,
    )


def _pieces(sources, flat, longest):
    """Parallelograms and triangles that flat sources (K,) are cut into: the source (F,) of each, its frame (F, 3, 3), and
    whether it is a parallelogram (F,). Their edges are at most `longest` [m] if a few cuts do for that."""
    start, corner = sources.corner_start[:-1][flat], sources.corner
    sides = np.diff(sources.corner_start)[flat]
    p, a, b = corner[start], corner[start + 1] - corner[start], corner[start + sides - 1] - corner[start]
    far = np.abs(p + a + b - corner[start + 2]).max(axis=1)
    whole = (sides == 4) & (far <= 1e-9 * np.abs(a + b).max(axis=1))
    square = _cut_squares(np.stack([p, a, b], axis=1)[whole], longest)
    cut, number = counted(np.where(whole, 0, sides - 2))
    p, c, d = (corner[start[cut] + n] for n in (0, number + 1, number + 2))
    triangle = _cut_triangles(np.stack([p, c - p, d - p], axis=1), longest)
    owner = np.concatenate([flat[whole][square[0]], flat[cut][triangle[0]]])
    return owner, np.concatenate([square[1], triangle[1]]), np.arange(len(owner)) < len(square[0])


def _cuts(extent, longest, most):
    """How many parts of extents (K,) are no longer than `longest`, or `most`; one where there is no telling."""
    return np.clip(np.ceil(ratio(extent, longest)), 1, most).astype(np.int64)


def _cut_squares(frame, longest):
    """The parallelogram (N,) that each part is of, and the frames (N, 3, 3) of the parts that they are cut into."""
    p, a, b = np.moveaxis(frame, 1, 0)
    sides = np.stack([length(a), length(b)])
    long, wide = sides.max(axis=0), sides.min(axis=0)
    m = _cuts(wide, longest, int(np.sqrt(MOST_PIECES)))
    n = _cuts(long, np.minimum(longest, LONG * wide / m), MOST_PIECES // m)
    n, m = np.where(long == sides[0], (n, m), (m, n))
    owner, number = counted(n * m)
    n, m = n[owner, None], m[owner, None]
    i, j = np.divmod(number[:, None], m)
    a, b = a[owner] / n, b[owner] / m
    return owner, np.stack([p[owner] + i * a + j * b, a, b], axis=1)


def _cut_triangles(frame, longest):
    """The same of triangles."""
    p, a, b = np.moveaxis(frame, 1, 0)
    # Of a fan of slivers, as a disk is cut into, each is long, but there are many of them.
    edge = np.minimum(np.maximum(np.maximum(length(a), length(b)), length(a - b)), 2 * np.sqrt(length(cross(a, b))))
    n = _cuts(edge, longest, int(np.sqrt(MOST_PIECES)))
    owner, number = counted(n * n)
    n = n[owner, None]
    i, j = np.divmod(number[:, None], n)
    # Half of a grid of parallelograms, and those parts of it that are turned round.
    turned = i + j >= n
    a, b = a[owner] / n, b[owner] / n
    i, j, way = np.where(turned, n - i, i), np.where(turned, n - j, j), np.where(turned, -1.0, 1.0)
    return owner, np.stack([p[owner] + i * a + j * b, way * a, way * b], axis=1)
