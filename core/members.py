"""Members of a crowd of sources: lamps without much extent, and small flat pieces of emitting faces and area lamps.

Owns the record `Members`, its making from sources, and what one of them gives a place: with nothing in between, and by
a test ray.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .lights import BALL, FLAT, SHORT, effect_of
from .polygons import polygon_factor
from .sampling import morton_order, tangents
from .vectors import by_coordinate, counted, cross, dot, length, ratio

LARGE = 0.03  # of the scene's diagonal: a source that reaches further is cut, or tested alone
MOST_PIECES = 64  # of a larger one
CLOSE = 0.3  # a flat member that reaches further than this share of the distance is close: its exact factor is taken
LONG = 2.0  # times as long as wide a piece may be
REMOTE = (
    2.0  # diagonals from the middle of the scene: what is farther out is no neighbor of what is there, but twice as far
)


@dataclass(frozen=True)
class Members:
    """M members, F flat ones first, then lamps without extent or like balls; each kind in an order that keeps neighbors
    together.

    source: (M,) number of the source that each is (a piece) of. center: (M, 3); normal: (M, 3) unit, the way that it
    shines; reach: (M,) [m]. power: (M,) mean strength of its channels, color: (M, C) in units of that. cone: (M, 2),
    see Sources. Of the flat ones frame: (F, 3, 3) a corner and two edges from there, square: (F,) bool, a
    parallelogram, else a triangle; area: (F,) [m^2]; two_sided: (F,) bool. Of the others radius: (M - F,), soft: (M -
    F,) bool. remote: (M,) int, 0 in the scene and around it, and more the farther out; of each kind, these come first.
    shadows: (M,) bool, things that stand before it cast some. effect: that most belong to.
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
    remote: np.ndarray
    shadows: np.ndarray
    effect: str

    def __len__(self):
        return len(self.source)

    @property
    def flats(self):
        """Number of the flat ones."""
        return len(self.area)

    @cached_property
    def corners(self):
        """(F, 4, 3) of the flat members, a triangle's last one twice."""
        p, a, b = np.moveaxis(self.frame, 1, 0)
        return np.stack([p, p + a, np.where(self.square[:, None], p + a + b, p + b), p + b], axis=1)

    def flux(self):
        """Power that all members send out [W], mean of the channels."""
        ball = np.full(len(self) - self.flats, 4 * np.pi)
        return float((self.power * np.append(self.area * np.where(self.two_sided, 2.0, 1.0), ball)).sum())

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
            cast = np.flatnonzero(self.shadows[m] & (light > 0))
            if not occluded or not len(cast):
                continue
            own = chosen[cast]
            if lift is None:
                blocked = caster.shaded(start[own], caster.place(aim[cast]), a[own], reach=SHORT)
            else:
                blocked = caster.shaded(start[own], caster.start(aim[cast], lift[cast]), a[own])
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


def make_members(sources, chosen, middle, diagonal):
    """The Members that chosen Sources, (S,) bool, make up. middle: (3,) of the scene, and its diagonal [m]."""
    flat = np.flatnonzero(chosen & (sources.kind == FLAT))
    ball = np.flatnonzero(chosen & (sources.kind == BALL))
    owner, frame, square = _pieces(sources, flat, LARGE * diagonal)
    p, a, b = np.moveaxis(frame, 1, 0)
    center = np.where(square[:, None], p + (a + b) / 2, p + (a + b) / 3)
    order, remote = _in_order((center - middle) / diagonal)
    owner, frame, square, center, a, b = (x[order] for x in (owner, frame, square, center, a, b))
    order, further = _in_order((sources.position[ball] - middle) / diagonal)
    ball = ball[order]
    source = np.concatenate([owner, ball])
    half = np.maximum(length(a + b), length(a - b)) / 2
    reach = np.where(square, half, np.maximum(length(a), np.maximum(length(b), length(a - b))) / 1.5)
    power = sources.strength[source].mean(axis=1)
    return Members(
        source=source,
        center=np.concatenate([center, sources.position[ball]]),
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
        remote=np.append(remote, further),
        shadows=sources.shadows[source],
        effect=effect_of(int(np.median(sources.origin[source]))),
    )


def _in_order(away):
    """An order of places (K, 3), in diagonals from the scene's middle, that keeps neighbors together and those farther out
    apart, and how remote (K,) they are in that order."""
    order = morton_order(np.clip(away, -REMOTE, REMOTE))
    square = dot(away, away)[order]
    remote = np.frexp(np.maximum(square / REMOTE**2, 1.0))[1] // 2
    outward = np.argsort(remote, kind="stable")
    return order[outward], remote[outward]


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
