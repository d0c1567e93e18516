"""A crowd of sources: too many to be tested one by one, so every place picks some of them by what they may give it.

Owns the record `Crowd`, what its members may give places, and the picks. Members that lie together are a group. What a
group may give from afar is known well from its middle and from the ways that its members are turned; where it is near,
its members are looked at one by one. A place picks groups, and then a member of each, spread evenly over the sum of all
that they may give: so each part of the crowd gets its share of the test rays, and what the members would give
unhindered has next to no noise. Only shadows are left to chance. A place looks at some members of some groups: with
groups as large as the root of the crowd, what it costs grows with that root.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from time import thread_time

import numpy as np

from .lights import BALL, FLAT, MOST_SOURCES, SHORT
from .members import LARGE, Members, make_members
from .sampling import GOLDEN, R2, fraction, scatter
from .vectors import by_coordinate, counted, length, ratio

NEARBY = 0.2  # a flat member that reaches further than this share of the distance is near: its exact factor is taken
SLIM = 4.0  # square of its reach, as a multiple of its area, from which on a source is much longer than wide
PART = 0.25  # of its reach: what is cut by the horizon is thought to rise above it, at least
RIM = 0.05  # share of a lamp's light that it is thought to give where only a part of it may shine
GROUP, GROWTH = 8, 22.0  # members of a group, at least; the square of more is this share of the crowd
FAR = 0.4  # a group that reaches further than this share of the distance is looked at member by member
ALIKE = 1e-3  # difference of normals that are one
FLOOR = 0.02  # of a group's power that it is thought to send any way, at least
SPACING = 0.25  # of members of a group, as a share of its reach: none is thought nearer
BLOCK = 1 << 16  # pairs of a place and a member, or group, at a time: they stay in the processor's cache
AT_ONCE = 1 << 20  # pairs that are kept for the picks
FARTHEST = 1e15  # units: so far away are members at most, or the square of a distance is no number
SMALLEST = np.float32(1e-15)  # square of a distance in units: its own square is still a number
PICK = 7  # salt of the sample sequences
# cos, where it is positive, and |cos|, as a + b cos + c cos^2: the best that there is over the sphere.
ONE_WAY, BOTH_WAYS = (3 / 32, 1 / 2, 15 / 32), (3 / 16, 0.0, 15 / 16)


@dataclass(frozen=True)
class Crowd:
    """Members, and a length, unit [m], that lengths are counted in where members are compared: float32 holds no squares of
    squares of any length."""

    members: Members
    unit: float

    @cached_property
    def _relative(self):
        """The power of members (M,), in units of the strongest's, and what that is [W/m^2]: of lamps at a distance of
        one unit."""
        power = self.members.power.copy()
        power[self.members.flats :] /= self.unit * self.unit
        top = float(power.max())
        return ratio(power, top), top

    @cached_property
    def _first(self):
        """First member (G,) of each group, and how many of the groups are flat: those come first."""
        m = self.members
        size = max(GROUP, int(np.sqrt(len(m) / GROWTH)))
        flat, other = np.arange(0, m.flats, size), np.arange(m.flats, len(m), size)
        return np.concatenate([flat, other]), len(flat), size

    @cached_property
    def _table(self):
        """(G, 12, N) float32 what is to be known of the members of each group: center (3), relative to `_middle`, normal (3),
        reach, power, cone (2), area or radius, and whether it is two-sided or soft; no power where a group has fewer."""
        m, (first, _, size) = self.members, self._first
        last = np.append(first[1:], len(m))
        parts = [
            *self._away.T, *m.normal.T, m.reach / self.unit, self._relative[0], *m.cone.T,
            np.append(m.area / self.unit**2, m.radius / self.unit), np.append(m.two_sided, m.soft),
        ]  # fmt: skip
        number = first[:, None] + np.arange(size)
        missing = np.array([-1.0 if k in (8, 9) else 0.0 for k in range(len(parts))])[:, None]
        table = np.stack(parts)[:, np.minimum(number, len(m) - 1)].swapaxes(0, 1)
        return np.where((number < last[:, None])[:, None], table, missing).astype(np.float32)

    @cached_property
    def _middle(self):
        return self.members.center.mean(axis=0)

    @property
    def _away(self):
        """(M, 3) centers of the members, from the middle of them, in units."""
        return np.clip((self.members.center - self._middle) / self.unit, -FARTHEST, FARTHEST)

    @cached_property
    def _groups(self):
        """Of groups, float32: center (3, G) of their power, relative to `_middle`, reach (G,) and power (G,); how much they
        send which way, u: a + b u + u Q u, with a (G,), b (3, G) and Q (6, G), its diagonal and twice the rest; and the
        ends of the box around their members (3, G). And (G,) bool, groups whose members are all turned the same way, of
        which u is clipped at 0, and its sign does not count where they shine to both sides, as the next (G,) bool say; and
        those whose members are narrow."""
        m, (first, *_) = self.members, self._first
        away, power = self._away, self._relative[0].copy()
        power[: m.flats] *= m.area / (np.pi * self.unit**2)

        def total(values):
            return np.add.reduceat(values, first)

        strength = total(power)
        group = np.repeat(np.arange(len(first)), np.diff(np.append(first, len(m))))
        center = np.stack([ratio(total(power * x), strength) for x in away.T])
        center = np.where(strength > 0, center, away[first].T)
        reach = np.maximum.reduceat(length(away - center.T[group]) + m.reach / self.unit, first)
        law = np.zeros((len(m), 3))
        law[:, 0] = 1.0
        law[: m.flats] = np.where(m.two_sided[:, None], BOTH_WAYS, ONE_WAY)
        # Members that are all turned the same way send just what one does.
        ends = (f.reduceat(m.normal, first) for f in (np.maximum, np.minimum))
        alike = (np.subtract(*ends).max(axis=1) < ALIKE) & (first < m.flats)
        both = np.logical_and.reduceat(np.append(m.two_sided, np.zeros(len(m) - m.flats, bool)), first)
        law[alike[group]] = 0.0, 1.0, 0.0
        a, b, c = power * law.T
        x, y, z = m.normal.T
        quad = [total(c * q) for q in (x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z)]
        low = np.minimum.reduceat(away - m.reach[:, None] / self.unit, first)
        high = np.maximum.reduceat(away + m.reach[:, None] / self.unit, first)
        narrow = np.append(m.cone[: m.flats, 0] > 0, m.cone[m.flats :, 0] > -1)
        parts = center, reach, strength, total(a), np.stack([total(b * n) for n in m.normal.T]), quad, low.T, high.T
        parts = (np.ascontiguousarray(p, np.float32) for p in parts)
        return (*parts, alike, both, np.logical_or.reduceat(narrow, first))

    def _place(self, position, normal, extent=None):
        """Places, normals (K, 3) and extents (K, 1) as `_far` and `_near` want them, float32."""
        around = np.zeros((len(position), 1), np.float32)
        if extent is not None:
            around[:, 0] = extent / self.unit
        return ((position - self._middle) / self.unit).astype(np.float32), normal.astype(np.float32), around

    def _far(self, place, alone=False):
        """(K, G) float32 what groups may give places from afar, (K, G) bool, whether they are too near for that, and (K, G)
        squares of the distances. alone: no group is looked at member by member; so that none that is long and near is
        thought too little of, what it gives falls off with the distance of both its nearest and its middle."""
        center, reach, strength, a, b, quad, low, high, alike, both, narrow = self._groups
        shape = len(place[0]), len(strength)
        result, near, squares = np.empty(shape, np.float32), np.empty(shape, bool), np.empty(shape, np.float32)
        inside = np.maximum((np.float32(SPACING) * reach) ** 2, SMALLEST)
        for part in _runs(*shape):
            x, n, around = (p[part] for p in place)
            square = rise = np.float32(0)
            toward = [center[d] - x[:, d, None] for d in range(3)]
            for d in range(3):
                rise = toward[d] * n[:, d, None] + rise
                square = toward[d] * toward[d] + square
            np.maximum(square, SMALLEST, out=square)
            distance, wide = np.sqrt(square), reach + around
            sent = a * square
            for q, (i, j) in zip(quad, ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))):
                if q.any():
                    sent += q * toward[i] * toward[j]
            behind = np.False_
            if b.any():
                facing = -(b[0] * toward[0] + b[1] * toward[1] + b[2] * toward[2])
                if alike.any():
                    behind = alike & ~both & (facing <= -strength * wide)
                    one = np.where(both, np.abs(facing), np.maximum(facing, np.float32(0)))
                    facing = np.where(alike, one, facing)
                sent += distance * facing
            np.maximum(sent, strength * (np.float32(FLOOR) * square + np.float32(PART) * wide * distance), out=sent)
            above = (rise > -wide) & ~behind
            np.maximum(rise, np.float32(PART) * wide, out=rise)
            rise *= above
            if alone:
                nearest = np.float32(0)
                for d in range(3):
                    own = x[:, d, None]
                    gap = np.minimum(np.maximum(own, low[d]), high[d]) - own
                    nearest = gap * gap + nearest
                distance = np.sqrt(np.maximum(nearest, inside))
            sent /= square  # of lamps far away, products of more lengths would be beyond float32
            rise /= distance
            rise *= sent
            rise /= square
            result[part], squares[part] = rise, square
            near[part] = (wide * wide > np.float32(FAR * FAR) * square) | narrow
            near[part] &= above
        return result, near, squares

    def _near(self, place, row, group):
        """(E, N) float32 roughly what the members of groups (E,) may give places row (E,), mean of the channels, in units of
        what the strongest is (see `_relative`), positive unless it can give nothing; and (E, N) squares of the
        distances."""
        shape = len(row), self._table.shape[2]
        result, squares = np.empty(shape, np.float32), np.empty(shape, np.float32)
        for part in _runs(*shape):
            own = tuple(p[row[part]] for p in place)
            flat = group[part] < self._first[1]
            for mine, kind in ((np.flatnonzero(flat), _of_flats), (np.flatnonzero(~flat), _of_balls)):
                if len(mine):
                    table = self._table[group[part][mine]].swapaxes(0, 1)
                    x, n, around = (p[mine] for p in own)
                    found = kind(x, n, around, table[:3], table[3:6], *table[6:])
                    result[part.start + mine], squares[part.start + mine] = found
        return result, squares

    def given(self, position, normal):
        """(K, G) float32 roughly what groups of members may give places (K, 3), to pick a single one by."""
        return self._far(self._place(position, normal), alone=True)[0]

    def _sums(self, place, exact=None):
        """(K, G) float32 what groups may give places; exact: see `_set_exact`."""
        given, near, _ = self._far(place)
        row, group = np.nonzero(near)
        if len(row):
            members, squares = self._near(place, row, group)
            if exact:
                self._set_exact(members, squares, row, group, *exact)
            given[row, group] = _sum(members)
        return given

    def _set_exact(self, likely, squares, row, group, position, normal):
        """Set what near flat members give to what it is, and tell which they are, (E, N) bool. position, normal: (K, 3) of
        the places row (E,)."""
        first, flat_groups, _ = self._first
        reach, power, edge = (self._table[:, k][group] for k in (6, 7, 8))
        near = squares < (reach / np.float32(NEARBY)) ** 2
        near &= (edge <= 0) & (power > 0) & (group < flat_groups)[:, None]
        pair, number = np.nonzero(near)
        if len(pair):
            own, member = row[pair], first[group[pair]] + number
            likely[pair, number] = self.members.exact(position[own], normal[own], member) * self._relative[0][member]
        return near

    def _chosen(self, place, given, upto, row, target, exact=None):
        """The members (R,) that targets (R,), as shares of what groups are given (K, G) by the places row (R,) in all, stand
        for, and the density (R,) that they are picked with, in units of that. upto: (K, G) sums of what is given up to each
        group. exact: see `_set_exact`; then also (R,) what near members give unhindered, -1 for others."""
        target = target * upto[row, -1]
        group = search_rows(upto, row, target)
        own = given[row, group].astype(float)
        left = np.clip(ratio(target - upto[row, group] + own, own), 0.0, SHORT)
        new = np.append(True, (row[1:] != row[:-1]) | (group[1:] != group[:-1]))[: len(row)]
        pair, places, groups = np.cumsum(new) - 1, row[new], group[new]
        likely, squares = self._near(place, places, groups)
        near = self._set_exact(likely, squares, places, groups, *exact) if exact else None
        within = np.cumsum(likely, axis=1, dtype=float)
        number = search_rows(within, pair, left * within[pair, -1])
        value = likely[pair, number].astype(float)
        density = ratio(own * value, within[pair, -1] * upto[row, -1])
        member = self._first[0][group] + np.where(density > 0, number, 0)
        if not exact:
            return member, density
        return member, density, np.where(near[pair, number], ratio(value, self._relative[0][member]), -1.0)

    def slope(self, position, normal, extent):
        """(K,) how much what the members give patches with their centers (K, 3) and extents (K,) [m] changes there,
        about: the sum of what each gives over its distance [W/m^3]."""
        slope = np.zeros(len(position))
        for part in self._parts(position):
            place = self._place(position[part], normal[part], extent[part] / 2)
            given, near, squares = self._far(place)
            given /= np.sqrt(squares)
            row, group = np.nonzero(near)
            if len(row):
                likely, squares = self._near(place, row, group)
                reach = self._table[:, 6][group]
                given[row, group] = _sum(likely / np.sqrt(squares + reach * reach + SMALLEST))
            slope[part] = _sum(given)
        return slope * (self._relative[1] / self.unit)

    def at_points(self, caster, ids, position, normal, geometric, count, seed, occluded=True):
        """(C, K) light that points (K, 3) get [W/m^2], by so many test rays as count(light), (K,) of what they may get,
        says. ids: (K,) numbers of them, which tell their samples apart."""
        members = self.members
        light = np.zeros((members.color.shape[1], len(ids)))
        start, begun = caster.start(position, geometric), thread_time()
        for part in self._parts(ids):
            exact = position[part], normal[part]
            place = self._place(*exact)
            given = self._sums(place, exact)
            upto = _upto(given)
            total = upto[:, -1]
            number = np.where(total > 0, count(total * self._relative[1]), 0)
            owner, u, x = _spread(number, ids[part], seed)
            member, density, whole = self._chosen(place, given, upto, owner, u, exact)
            own = (exact[0][owner], exact[1][owner])
            facing = own[1] if geometric is normal else geometric[part][owner]
            factor, seen = members.test(caster, member, *own, facing, start[part][owner], *x, occluded)
            # A near member is worth its exact factor, whatever the places tell on the whole.
            close = whole >= 0
            if close.any():
                begin = np.flatnonzero(np.append(True, (owner[1:] != owner[:-1]) | (member[1:] != member[:-1])))
                size = np.diff(np.append(begin, len(owner)))
                mean = np.repeat(np.add.reduceat(factor, begin) / size, size)
                factor = np.where(close, ratio(factor, mean) * whole, factor)
            worth = ratio(factor * seen * members.power[member], number[owner] * density)
            for channel, color in zip(light[:, part], members.color.T):
                channel[:] = np.bincount(owner, worth * color[member], len(total))
        for part in (members.effect, *(("occlusion",) if occluded else ())):
            caster.note(part, begun)
        return light

    def on_patches(self, caster, center, extent, position, normal, a, b, occluded=True):
        """(C, K) mean irradiance [W/m^2] of patches with their centers (K, 3) and extents (K,) [m], of one member for
        each of the places (K, n, 3) on them. normal: (K, n, 3) at the places; a, b: (K, n) in [0, 1)."""
        members, places = self.members, a.shape[1]
        light, begun = np.zeros((members.color.shape[1], len(center))), thread_time()
        for part in self._parts(center):
            patch = self._place(center[part], normal[part, 0], extent[part])
            given = self._sums(patch)
            upto = _upto(given)
            lit = np.flatnonzero(upto[:, -1] > 0)
            owner, number = np.repeat(lit, places), np.tile(np.arange(places), len(lit))
            u = (number + fraction(a[part][lit, :1] * places).repeat(places)) / places
            member, density = self._chosen(patch, given, upto, owner, u)
            place, up = (by_coordinate(x[part][lit].reshape(-1, 3)) for x in (position, normal))
            start = caster.start(place, up)
            x = (y[part][lit].reshape(-1) for y in (a, b))
            factor, seen = members.from_one(caster, member, place, up, start, *x, occluded)
            worth = ratio(factor * seen * members.power[member], places * density)
            for channel, color in zip(light[:, part], members.color.T):
                channel[:] = np.bincount(owner, worth * color[member], len(given))
        for part in (members.effect, *(("occlusion",) if occluded else ())):
            caster.note(part, begun)
        return light

    def one(self, caster, position, normal, start, given, pick, a, b, occluded=True):
        """(C, K) light of places (K, 3) [W/m^2] from one member each, over the chance that it is picked with: first of
        a group, by what is `given`. pick, a, b: (K,) in [0, 1)."""
        members, row = self.members, np.arange(len(pick))
        member, density = self._chosen(self._place(position, normal), given, _upto(given), row, pick)
        factor, seen = members.from_one(caster, member, position, normal, start, a, b, occluded)
        return ratio(factor * seen * members.power[member], density) * members.color[member].T

    def _parts(self, places):
        """Slices of places, so few at a time that all that is found of them can be kept."""
        every = self._groups[-1].any()
        size = max(AT_ONCE // (len(self.members) if every else 4 * len(self._first[0])), 1)
        return [slice(k, k + size) for k in range(0, len(places), size)]


def _runs(count, each):
    """Slices that cut `count` rows of `each` pairs into blocks."""
    size = max(BLOCK // max(each, 1), 1)
    return [slice(k, min(k + size, count)) for k in range(0, count, size)]


def _sum(values):
    """(K,) sums of rows (K, N), float64."""
    return _upto(values)[:, -1]


def _upto(values):
    """(K, N) sums of the items of rows (K, N) of float32 up to each, float64: in their order, whatever the build of numpy."""
    return np.cumsum(values, axis=1, dtype=float)


def _spread(count, ids, seed):
    """The place (R,) of count (K,) picks of each of K places, and samples of them in [0, 1): one (R,) that is spread evenly
    over each place's, rising, and two more (R,)."""
    owner, number = counted(count)
    shift = scatter(np.arange(3), PICK + 8 * seed)
    ids = np.asarray(ids, np.int64)[owner]
    u = (number + fraction(ids * GOLDEN + shift[0])) / count[owner]
    return owner, u, [fraction(ids * R2[1 - k] + number * R2[k] + shift[k + 1]) for k in range(2)]


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


def _of_flats(x, n, around, center, axis, reach, power, edge, factor, area, two_sided):
    """What flat members may give, (E, N), and squares of the distances."""
    wide = reach + around
    square, rise, tilt = _toward(x, n, around, center, axis, wide)
    height = np.where(two_sided > 0, np.abs(tilt), tilt)
    rise *= height > -around
    np.maximum(height, np.float32(PART) * around, out=height)
    rise *= height
    rise *= area * power
    rise /= square * (np.float32(np.pi) * square + area)
    if (edge > 0).any():
        distance = np.sqrt(square)
        rise *= _rough_spread(_over(height, distance), edge, factor, wide / distance)
    return rise, square


def _of_balls(x, n, around, center, axis, reach, power, edge, blend, radius, soft):
    """The same of those that are not flat."""
    wide = reach + around
    square, rise, tilt = _toward(x, n, around, center, axis, wide)
    distance = np.sqrt(square)
    rise *= power
    rise /= distance * np.where(soft > 0, square + radius * radius, np.maximum(square, radius * radius))
    if (edge > -1).any():
        rise *= _rough_cone(tilt / distance, edge, blend, wide / distance)
    return rise, square


def _toward(x, n, around, center, axis, wide):
    """Squares of the distances (E, N) from places to members, at least their extents', how far the members rise above the
    places, a part of how wide they are at least and 0 below the horizon, and these above the members."""
    square = rise = tilt = np.float32(0)
    for d in range(3):
        toward = center[d] - x[:, d, None]
        rise = toward * n[:, d, None] + rise
        tilt = tilt - toward * axis[d]
        square = toward * toward + square
    np.maximum(square, around * around, out=square)
    above = rise > -wide
    np.maximum(rise, np.float32(PART) * wide, out=rise)
    rise *= above
    return np.maximum(square, SMALLEST), rise, tilt


def _over(a, b):
    """a / b of float32 arrays, where b is not 0."""
    return a / np.maximum(b, np.float32(1e-30))


def _rough_cone(cosine, edge, blend, wide):
    """Share of a spot's light toward the cosine of an angle to its axis, float32; wide: how far that is in doubt."""
    ramp = np.clip((cosine - edge) / np.maximum((1 - edge) * blend, np.float32(1e-6)), 0, 1)
    share = ramp * ramp * (3 - 2 * ramp)
    share = np.where((wide > 0) & (cosine > edge - wide), np.maximum(share, np.float32(RIM)), share)
    return np.where(edge > -1, share, np.float32(1))


def _rough_spread(cosine, edge, factor, wide):
    """The same for a flat lamp of limited spread."""
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
    return Crowd(make_members(sources, chosen, diagonal), float(diagonal) or 1.0) if chosen.any() else None
