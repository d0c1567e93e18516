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
from typing import NamedTuple

import numpy as np

from .flats import MOST_SOURCES
from .lights import BALL, FLAT, SHORT
from .members import LARGE, Members, make_members
from .sampling import GOLDEN, R2, fraction, scatter
from .vectors import by_coordinate, counted, dot, length, ratio, runs

NEARBY = 0.2  # a flat member that reaches further than this share of the distance is near: its exact factor is taken
SLIM = 4.0  # square of its reach, as a multiple of its area, from which on a source is much longer than wide
PART = 0.25  # of its reach: what is cut by the horizon is thought to rise above it, at least
RIM = 0.05  # share of a lamp's light that it is thought to give where only a part of it may shine
GROUP, GROWTH = 8, 22.0  # members of a group, at least; the square of more is this share of the crowd
FAR = 0.4  # a group that reaches further than this share of the distance is looked at member by member
ALIKE = 1e-3  # difference of normals that are one
FLOOR = 0.02  # of a group's power that it is thought to send any way, at least
SPACING = 0.25  # of members of a group, as a share of its reach: none is thought nearer
AT_ONCE = 1 << 16  # pairs of a place and a member, or group, at a time: they stay in the processor's cache
KEPT = 1 << 20  # pairs that are kept for the picks
FARTHEST = 1e15  # units: so far away are members at most, and so large, or float32 has no squares of that
SMALLEST = np.float32(1e-15)  # square of a distance in units, at least
LEAST, MOST = np.float32(1e-37), np.float32(1e37)  # that any member may give: sums of it are still float32
RIM_DOUBT = np.float32(1e-3)  # of an angle: so narrow are beams whose rims float32 does not know
PICK = 7  # salt of the sample sequences
# cos, where it is positive, and |cos|, as a + b cos + c cos^2: the best that there is over the sphere.
ONE_WAY, BOTH_WAYS = (3 / 32, 1 / 2, 15 / 32), (3 / 16, 0.0, 15 / 16)


class Given(NamedTuple):
    """What groups of a crowd may give K places: rows (K,) of each (N, G) float32, and of upto (N, G), the sums up to each
    group."""

    each: np.ndarray
    upto: np.ndarray
    row: np.ndarray

    def of(self, chosen):
        """The same of chosen places."""
        return self._replace(row=self.row[chosen])

    @property
    def total(self):
        """(K,) what all groups may give."""
        return self.upto[self.row, -1]


@dataclass(frozen=True)
class Crowd:
    """Members, and where they are compared: lengths count from `middle` (3,), in units [m] of the scene's, or float32 would
    not hold them, nor tell places apart."""

    members: Members
    middle: np.ndarray
    unit: float

    @cached_property
    def _relative(self):
        """What members (M,) give a place that faces them, at a distance of one unit; their strength (M,), of lamps at that
        distance; both in units of what [W/m^2] the strongest of all gives the middle of the scene, which comes last."""
        m, strength = self.members, self.members.power.copy()
        strength[m.flats :] /= self.unit * self.unit
        given = strength.copy()
        given[: m.flats] *= m.area / (np.pi * self.unit**2)
        top = float((given / np.maximum(dot(self._away, self._away), 0.25)).max())
        return ratio(given, top), ratio(strength, top), top

    @cached_property
    def _first(self):
        """First member (G,) of each group, and how many of the groups are flat: those come first."""
        m = self.members
        size = max(GROUP, int(np.sqrt(len(m) / GROWTH)))
        # No group has members of both kinds, nor some that are near and some that are far out.
        kind = np.append(m.remote[: m.flats], m.remote[m.flats :] + m.remote.max() + 1)
        _, begin, count = np.unique(kind, return_index=True, return_counts=True)
        run, number = counted(-(-count // size))
        first = begin[run] + size * number
        return first, np.searchsorted(first, m.flats), size

    @cached_property
    def _table(self):
        """(G, 12, N) float32 what is to be known of the members of each group: center (3), normal (3), reach, what it gives
        (see `_relative`), cone (2), area or radius, and whether it is two-sided or soft; a group that has fewer is filled up
        with members that give nothing."""
        m, (first, _, size) = self.members, self._first
        last = np.append(first[1:], len(m))
        parts = [
            *self._away.T, *m.normal.T, self._reach, self._relative[0], *m.cone.T,
            np.append(np.minimum(m.area / self.unit**2, FARTHEST**2), np.minimum(m.radius / self.unit, FARTHEST)),
            np.append(m.two_sided, m.soft),
        ]  # fmt: skip
        number = first[:, None] + np.arange(size)
        missing = np.array([-1.0 if k in (8, 9) else 0.0 for k in range(len(parts))])[:, None]
        table = np.stack(parts)[:, np.minimum(number, len(m) - 1)].swapaxes(0, 1)
        return np.where((number < last[:, None])[:, None], table, missing).astype(np.float32)

    @property
    def groups(self):
        """Number of groups."""
        return len(self._first[0])

    @property
    def _away(self):
        """(M, 3) centers of the members."""
        return np.clip((self.members.center - self.middle) / self.unit, -FARTHEST, FARTHEST)

    @property
    def _reach(self):
        """(M,) reaches of the members."""
        return np.minimum(self.members.reach / self.unit, FARTHEST)

    @cached_property
    def _groups(self):
        """Of groups, float32: center (3, G) of their power, reach (G,) and power (G,); how much they
        send which way, u: a + b u + u Q u, with a (G,), b (3, G) and Q (6, G), its diagonal and twice the rest; and the
        ends of the box around their members (3, G). And (G,) bool, groups whose members are all turned the same way, of
        which u is clipped at 0, and its sign does not count where they shine to both sides, as the next (G,) bool say; and
        those whose members are narrow."""
        m, (first, *_) = self.members, self._first
        away, own, power = self._away, self._reach, self._relative[0]

        def total(values):
            return np.add.reduceat(values, first)

        strength = total(power)
        group = np.repeat(np.arange(len(first)), np.diff(np.append(first, len(m))))
        center = np.stack([ratio(total(power * x), strength) for x in away.T])
        center = np.where(strength > 0, center, away[first].T)
        reach = np.maximum.reduceat(length(away - center.T[group]) + own, first)
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
        low, high = np.minimum.reduceat(away - own[:, None], first), np.maximum.reduceat(away + own[:, None], first)
        narrow = np.append(m.cone[: m.flats, 0] > 0, m.cone[m.flats :, 0] > -1)
        parts = center, reach, strength, total(a), np.stack([total(b * n) for n in m.normal.T]), quad, low.T, high.T
        parts = (np.ascontiguousarray(p, np.float32) for p in parts)
        return (*parts, alike, both, np.logical_or.reduceat(narrow, first))

    def _place(self, position, normal, extent=None):
        """Places, normals (K, 3) and extents (K, 1) as `_far` and `_near` want them, float32."""
        around = np.zeros((len(position), 1), np.float32)
        if extent is not None:
            around[:, 0] = extent / self.unit
        return ((position - self.middle) / self.unit).astype(np.float32), normal.astype(np.float32), around

    def _far(self, place, alone=False):
        """(K, G) float32 what groups may give places from afar, (K, G) bool, whether they are too near for that, and (K, G)
        squares of the distances. alone: no group is looked at member by member; so that none that is long and near is
        thought too little of, what it gives falls off with the distance of both its nearest and its middle."""
        center, reach, strength, a, b, quad, low, high, alike, both, narrow = self._groups
        shape = len(place[0]), len(strength)
        result, near, squares = np.empty(shape, np.float32), np.empty(shape, bool), np.empty(shape, np.float32)
        inside = np.maximum((np.float32(SPACING) * reach) ** 2, SMALLEST)
        for part in runs(*shape, AT_ONCE):
            x, n, around = (p[part] for p in place)
            toward = [center[d] - x[:, d, None] for d in range(3)]
            square = toward[0] * toward[0] + toward[1] * toward[1] + toward[2] * toward[2]
            np.maximum(square, SMALLEST, out=square)
            distance = np.sqrt(square)
            for along in toward:
                along /= distance
            # Products of cosines have no end that is beyond float32, those of lengths do.
            wide = np.minimum((reach + around) / distance, np.float32(1 / PART))
            rise = toward[0] * n[:, :1] + toward[1] * n[:, 1:2] + toward[2] * n[:, 2:]
            sent = np.broadcast_to(a, square.shape).copy()
            for q, (i, j) in zip(quad, ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))):
                if q.any():
                    sent += q * toward[i] * toward[j]
            above = rise > -wide
            if b.any():
                facing = -(b[0] * toward[0] + b[1] * toward[1] + b[2] * toward[2])
                if alike.any():
                    above &= ~alike | both | (facing > -strength * wide)
                    one = np.where(both, np.abs(facing), np.maximum(facing, np.float32(0)))
                    facing = np.where(alike, one, facing)
                sent += facing
            np.maximum(sent, strength * (np.float32(FLOOR) + np.float32(PART) * wide), out=sent)
            np.maximum(rise, np.float32(PART) * wide, out=rise)
            rise *= sent
            if alone:
                nearest = np.float32(0)
                for d in range(3):
                    own = x[:, d, None]
                    gap = np.minimum(np.maximum(own, low[d]), high[d]) - own
                    nearest = gap * gap + nearest
                rise *= distance / np.sqrt(np.maximum(nearest, inside))
            rise /= np.maximum(square, inside)
            result[part], squares[part] = _within(rise, above & (strength > 0)), square
            near[part] = (wide > np.float32(FAR)) | narrow
            near[part] &= above
        return result, near, squares

    def _near(self, place, row, group):
        """(E, N) float32 roughly what the members of groups (E,) may give places row (E,), mean of the channels (see
        `_relative`), positive unless it can give nothing; and (E, N) squares of the distances."""
        shape = len(row), self._table.shape[2]
        result, squares = np.empty(shape, np.float32), np.empty(shape, np.float32)
        for part in runs(*shape, AT_ONCE):
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
        """What groups of members may give places (K, 3), to pick a single one by, as Given."""
        given = self._far(self._place(position, normal), alone=True)[0]
        return Given(given, _upto(given), np.arange(len(given)))

    def given_patches(self, center, extent, normal):
        """The same of patches with their centers, normals (K, 3) and extents (K,) [m], wherever on them a place is: each is
        asked for many times, so near members are looked at one by one."""
        given = np.empty((len(center), self.groups), np.float32)
        for part in self._parts(center):
            given[part] = self._sums(self._place(center[part], normal[part], extent[part]))
        return Given(given, _upto(given), np.arange(len(given)))

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
        reach, given, edge = (self._table[:, k][group] for k in (6, 7, 8))
        near = squares < (reach / np.float32(NEARBY)) ** 2
        near &= (edge <= 0) & (given > 0) & (group < flat_groups)[:, None]
        pair, number = np.nonzero(near)
        if len(pair):
            own, member = row[pair], first[group[pair]] + number
            exact = self.members.exact(position[own], normal[own], member) * self._relative[1][member]
            likely[pair, number] = np.minimum(exact, MOST)
        return near

    def _chosen(self, place, given, upto, row, target, exact=None, table=None):
        """The members (R,) that targets (R,), as shares of what groups are given (K, G) by the places row (R,) in all, stand
        for, and the density (R,) that they are picked with, in units of that. upto: (K, G) sums of what is given up to each
        group. exact: see `_set_exact`; then also (R,) what near members give unhindered, -1 for others. table: (R,) rows of
        given and upto, where they are not those of the places."""
        table = row if table is None else table
        most = upto[table, -1]
        target = target * most
        group = search_rows(upto, table, target)
        own = given[table, group].astype(float)
        left = np.clip(ratio(target - upto[table, group] + own, own), 0.0, SHORT)
        new = np.append(True, (row[1:] != row[:-1]) | (group[1:] != group[:-1]))[: len(row)]
        pair, places, groups = np.cumsum(new) - 1, row[new], group[new]
        likely, squares = self._near(place, places, groups)
        near = self._set_exact(likely, squares, places, groups, *exact) if exact else None
        within = np.cumsum(likely, axis=1, dtype=float)
        number = search_rows(within, pair, left * within[pair, -1])
        value = likely[pair, number].astype(float)
        density = ratio(own * value, within[pair, -1] * most)
        member = self._first[0][group] + np.where(density > 0, number, 0)
        if not exact:
            return member, density
        return member, density, np.where(near[pair, number], ratio(value, self._relative[1][member]), -1.0)

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
        return slope * (self._relative[2] / self.unit)

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
            number = np.where(total > 0, count(total * self._relative[2]), 0)
            owner, u, x = _picks(number, ids[part], seed)
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
        for part in (members.effect, *(("occlusion",) if occluded and members.shadows.any() else ())):
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
        for part in (members.effect, *(("occlusion",) if occluded and members.shadows.any() else ())):
            caster.note(part, begun)
        return light

    def one(self, caster, position, normal, start, given, pick, a, b, occluded=True):
        """(C, K) light of places (K, 3) [W/m^2] from one member each, over the chance that it is picked with: first of
        a group, by what is Given. pick, a, b: (K,) in [0, 1)."""
        members, row = self.members, np.arange(len(pick))
        place = self._place(position, normal)
        member, density = self._chosen(place, given.each, given.upto, row, pick, table=given.row)
        factor, seen = members.from_one(caster, member, position, normal, start, a, b, occluded)
        return ratio(factor * seen * members.power[member], density) * members.color[member].T

    def _parts(self, places):
        """Slices of places, so few at a time that all that is found of them can be kept."""
        every = self._groups[-1].any()
        return runs(len(places), len(self.members) if every else 4 * len(self._first[0]), KEPT)


def _sum(values):
    """(K,) sums of rows (K, N), float64."""
    return _upto(values)[:, -1]


def _upto(values):
    """(K, N) sums of the items of rows (K, N) of float32 up to each, float64: in their order, whatever the build of numpy."""
    return np.cumsum(values, axis=1, dtype=float)


def _picks(count, ids, seed):
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


def _of_flats(x, n, around, center, axis, reach, given, edge, factor, area, two_sided):
    """What flat members may give, (E, N), and squares of the distances."""
    square, rise, tilt, above, wide, share = _toward(x, n, around, center, axis, reach)
    height = np.where(two_sided > 0, np.abs(tilt), tilt)
    above &= (height > -share) & (given > 0)
    rise *= np.maximum(height, np.float32(PART) * share)
    rise *= given
    small = area * np.float32(1 / np.pi)
    if (edge > 0).any():  # a beam is at most as strong as where it begins
        begin = np.maximum(small + around * around, SMALLEST)
        rise *= np.minimum(_rough_spread(height, edge, factor, wide) / (square + small), 1 / begin)
    else:
        rise /= square + small
    return _within(rise, above), square


def _of_balls(x, n, around, center, axis, reach, given, edge, blend, radius, soft):
    """The same of those that are not flat."""
    square, rise, tilt, above, wide, _ = _toward(x, n, around, center, axis, reach)
    rise *= given
    rise /= np.where(soft > 0, square + radius * radius, np.maximum(square, radius * radius))
    if (edge > -1).any():
        rise *= _rough_cone(tilt, edge, blend, wide)
    return _within(rise, above & (given > 0)), square


def _toward(x, n, around, center, axis, reach):
    """Squares of the distances (E, N) from places to members, at least their extents'; cosines there of the ways to them,
    above the places, a part of how wide they look at least, and above the members; whether they are above the horizon at
    all; and how wide they look, both ends together, and how wide the places look."""
    toward = [center[d] - x[:, d, None] for d in range(3)]
    square = toward[0] * toward[0] + toward[1] * toward[1] + toward[2] * toward[2]
    np.maximum(square, np.maximum(around * around, SMALLEST), out=square)
    distance = np.sqrt(square)
    rise = tilt = np.float32(0)
    for d, along in enumerate(toward):
        along /= distance
        rise = along * n[:, d, None] + rise
        tilt = tilt - along * axis[d]
    most = np.float32(1 / PART)
    wide, around = np.minimum((reach + around) / distance, most), np.minimum(around / distance, most)
    above = rise > -wide
    np.maximum(rise, np.float32(PART) * wide, out=rise)
    return square, rise, tilt, above, wide, around


def _within(given, above):
    """What may be given, within what float32 can add up: 0 only where there is nothing, `above` false."""
    np.clip(given, LEAST, MOST, out=given)
    given *= above
    return given


def _rough_cone(cosine, edge, blend, wide):
    """Share of a spot's light toward the cosine of an angle to its axis, float32; wide: how far that is in doubt."""
    ramp = np.clip((cosine - edge) / np.maximum((1 - edge) * blend, np.float32(1e-6)), 0, 1)
    share = ramp * ramp * (3 - 2 * ramp)
    share = np.where(cosine > edge - wide - RIM_DOUBT * RIM_DOUBT, np.maximum(share, np.float32(RIM)), share)
    return np.where(edge > -1, share, np.float32(1))


def _rough_spread(cosine, edge, factor, wide):
    """The same for a flat lamp of limited spread."""
    tangent = np.sqrt(np.maximum(1 - cosine * cosine, 0)) / np.maximum(cosine, np.float32(1e-6))
    share = np.maximum(edge - tangent, 0) * factor
    rim = np.float32(RIM) * edge * factor
    turned = tangent - edge < 2 * (wide + RIM_DOUBT) * (1 + tangent * tangent)
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


def make_crowd(sources, chosen, middle, diagonal):
    """The Crowd of chosen Sources, (S,) bool; None if there are none. middle: (3,) of the scene, and its diagonal [m]."""
    if not chosen.any():
        return None
    diagonal = float(diagonal) or 1.0
    return Crowd(make_members(sources, chosen, middle, diagonal), middle, diagonal)
