"""Replicates of the light at points, and the light that they tell together.

Owns the records `Light` and `Replicate`, and how far the filter of what rays found is trusted. Many points are gone
through in blocks, each with as many of its surroundings as the filter reads, so that what is worked on is as small for any
number of points; cells can do that, and the bits do not depend on who does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from dataclasses import fields as fields_of
from math import sqrt

import numpy as np

from .filter import SPREAD, Filter
from .points import pairs
from .vectors import counted, ratio, rows_of, runs

PARTS = ("direct", "found", "reflected")  # of a point's light
REACH = 0.4  # of the filter, in harmonic mean free distances, at 64 gather rays
CHANCE = 2.0  # times the noise: a change by the filter up to that is taken as noise (undoing less would not pay)
WHOLE = 1 << 17  # points up to which they are one block,
BLOCK = 1 << 16  # and of a block, where they are more


@dataclass(frozen=True)
class Light:
    """Irradiance at P points [W/m^2], a row per color channel: direct (C, P) straight from sources, indirect (C, P)
    reflected at least once; with light groups a row for each group's channels. variance: (C, P) of their sum over all
    groups, as the scatter between replicates shows it; 0 where nothing is known. blurred: (P,) square of what the
    filter does to the light itself, all channels together, so that its mean over many points is right (it may be
    negative at some). done: (P,) bool, the points that were gathered; the others have their patches' light.
    """

    direct: np.ndarray
    indirect: np.ndarray
    variance: np.ndarray
    blurred: np.ndarray
    done: np.ndarray

    @property
    def total(self):
        """(C, P) all light that arrives."""
        return self.direct + self.indirect


@dataclass(frozen=True)
class Replicate:
    """One independent sample of the light, by so many rays at each of the points that are asked, (P,) bool, and the test
    rays toward sources that go with test_rays of them, none at all if that is 0; taken: (P,) bool, where that is done.
    (C, P) float32 each, direct light of sampled sources, light found by rays, and light reflected at least once [W/m^2];
    nearness: (P,) float32 mean inverse distance that the rays went, in scene diagonals."""

    rays: int
    test_rays: int
    asked: np.ndarray
    taken: np.ndarray
    direct: np.ndarray
    found: np.ndarray
    reflected: np.ndarray
    nearness: np.ndarray

    @property
    def weight(self):
        """(P,) how much what its rays bring counts at each point, 0 where it was not taken (yet)."""
        return self.taken * weight_of(self.rays)

    @property
    def test_weight(self):
        """(P,) the same of its direct light."""
        return self.taken * weight_of(self.test_rays)

    def part(self, part):
        """The same at part of the points, a slice."""
        fields = ((f.name, getattr(self, f.name)) for f in fields_of(self))
        return replace(self, **{name: x[..., part] for name, x in fields if isinstance(x, np.ndarray)})

    @property
    def left(self):
        """(K,) int32 points where it is still to be taken."""
        return np.flatnonzero(self.asked & ~self.taken).astype(np.int32)


def weight_of(rays):
    """How much a replicate of so many rays counts: their variance falls by 1.0 to 1.6 in the exponent, and what is said of
    it must not be too low."""
    return rays * np.sqrt(np.sqrt(rays))


@dataclass(frozen=True)
class Near:
    """N points that lie together, as the filter reads them: position, normal (N, 3), neighbor_start (N + 1,) and neighbor
    (E,), see Points."""

    position: np.ndarray
    normal: np.ndarray
    neighbor_start: np.ndarray
    neighbor: np.ndarray

    def __len__(self):
        return len(self.position)


def light_blocks(count, many):
    """Slices that cut P points into the blocks whose light is found in one go; one if they are not `many`."""
    return runs(count, most=BLOCK if many else count)


def around(points, part):
    """(N,) bool of all points: those of a part, a slice, and all that are so near that the filter reads them for it."""
    near = np.zeros(len(points), bool)
    near[part] = True
    fresh = np.arange(part.start, part.stop)
    for _ in range(SPREAD):
        _, there = pairs(points, fresh)
        fresh = np.unique(there[~near[there]])
        near[fresh] = True
    return near


def block_of_light(points, links, replicates, part):
    """{name: array} of what `light_of_block` needs to find the light of a part of the points, a slice."""
    ids = np.flatnonzero(around(points, part)).astype(np.int32)
    here, number = counted(np.diff(points.neighbor_start)[ids].astype(np.int64))
    edge = points.neighbor_start[ids][here] + number
    there = np.searchsorted(ids, points.neighbor[edge])
    kept = np.append(ids, -1)[there] == points.neighbor[edge]
    start = np.append(0, np.cumsum(np.bincount(here[kept], minlength=len(ids)))).astype(np.int32)
    first, last = np.searchsorted(ids, (part.start, part.stop))
    return dict(
        first=int(first), last=int(last),
        rays=np.array([r.rays for r in replicates]), test_rays=np.array([r.test_rays for r in replicates]),
        position=rows_of(points.position, ids), normal=rows_of(points.normal, ids), neighbor_start=start, neighbor=there[kept].astype(np.int32),
        links=links[edge[kept]],
        taken=_stacked(replicates, "taken", ids), nearness=_stacked(replicates, "nearness", ids),
        **{name: _stacked(replicates, name, ids) for name in PARTS},
    )  # fmt: skip


def _stacked(replicates, name, ids):
    """(R, ..., N) what replicates have at points ids (N,); nothing where that is no light at all."""
    parts = [np.take(getattr(r, name), ids, axis=-1) for r in replicates]
    return np.stack(parts) if name not in PARTS or any(p.any() for p in parts) else np.zeros(0, np.float32)


def light_of_block(
    kernel,
    first,
    last,
    rays,
    test_rays,
    taken,
    nearness,
    links,
    rows,
    groups,
    diagonal,
    direct,
    found,
    reflected,
    **near,
):
    """The light of rows first to last of a block, see `block_of_light` and `mean_light`. rows: of light."""
    none = np.broadcast_to(np.float32(0.0), (len(rays), rows, len(taken[0])))
    parts = (part if part.size else none for part in (direct, found, reflected))
    replicates = [
        Replicate(int(n), int(m), own, own, *light, far)
        for n, m, own, far, *light in zip(rays, test_rays, taken, nearness, *parts)
    ]
    light = mean_light(Near(**near), links, replicates, groups, diagonal)
    return {name: array[..., first:last] for name, array in light.items()}


def mean_light(points, links, replicates, groups, diagonal):
    """The light of all Replicates at N points, filtered, as arrays of a Light: {"direct", "indirect", "variance",
    "blurred"}; 0 where nothing was taken. links: (E,) bool, which neighbors see one another. diagonal: of the scene
    [m].

    The filter is linear, so it can be applied to each replicate: how their results scatter shows the noise that is
    left in the mean, filtered as it is.
    """
    rays = sum(r.rays * r.taken for r in replicates).astype(float)
    done = rays > 0
    links = links & np.repeat(done, np.diff(points.neighbor_start)) & done[points.neighbor]
    nearness = sum(r.rays * r.nearness.astype(float) for r in replicates)
    # Where no ray meets anything nothing is near: as if one had gone across the scene, and not as if all had ended at once.
    reach = REACH * np.sqrt(np.sqrt(ratio(64.0, rays))) * diagonal * ratio(rays, np.maximum(nearness, 1.0))
    filter = Filter(points, reach, links)
    direct, found, reflected = (mean_of(replicates, name) for name in PARTS)
    changes = [_change(filter, light) for light in (found, reflected)]
    trust, variance, blurred = _trust(filter, replicates, found + reflected, changes[0] + changes[1], groups)
    variance += direct_variance(replicates, direct, groups)
    for light, change in zip((found, reflected), changes):
        change *= trust
        light += change
        # Beside a steep edge what is smoothed can fall below 0.
        np.maximum(light, 0.0, out=light)
    found += direct
    return dict(direct=found, indirect=reflected, variance=variance, blurred=blurred)


def _change(filter, light):
    """What the filter does to light (K, N)."""
    if not light.any():
        return np.zeros(light.shape)
    change = filter.smooth(light)
    change -= light
    return change


def direct_variance(replicates, direct, groups):
    """(C, N) variance of direct (G C, N), the mean of all replicates, by how they scatter; 0 where fewer than two tell."""
    others = sum((r.taken & (r.test_rays > 0)).astype(np.int32) for r in replicates) - 1
    off = np.zeros((len(direct) // groups, direct.shape[1]))
    for r in replicates:
        if r.test_rays:
            off += r.test_weight * _together(r.direct - direct, groups) ** 2
    return off * ratio(1.0, np.maximum(others, 0) * sum(r.test_weight for r in replicates))


def _trust(filter, replicates, indirect, moved, groups):
    """How far the filter is to be trusted at each point, (N,) 0..1: so that the error of what is filtered so far is
    least; with it the variance (C, N) of what rays bring, and (N,) the square of what the filter does to the light itself.
    indirect: (G C, N) mean of all replicates; moved: what the filter does to it.

    With V the variance of the mean of all replicates, V' of what is filtered of it and K what they have in common, and
    b what the filter does to the light itself, the error of a filtered share a is (1 - a)^2 V + 2 a (1 - a) K +
    a^2 (V' + b^2): it is least where a is V - K over V - 2 K + V' + b^2. How much more the filter changes than the
    noise explains, V - 2 K + V', shows b^2. All of them are means over neighbors; V' is what remains in the end, V - K and
    V - 2 K + V' are of the fine noise that the filter takes away.

    The replicates are gone through one by one, so that only sums are held: of the squares of how far each is off the
    mean, of what the filter changes of that, and of their products. They tell the variance whatever the trust is.
    """
    count = indirect.shape[1]
    shape = indirect.shape[0] // groups, count
    others = sum(r.taken.astype(np.int32) for r in replicates) - 1
    if not others.max(initial=0) > 0:  # one replicate alone shows no noise
        return np.ones(count), np.zeros(shape), np.zeros(count)
    off, both, change, sums = (np.zeros(shape) for _ in range(4))
    gain, everywhere = np.zeros(count), all(r.taken.all() for r in replicates)
    for r in replicates:
        weight = r.weight
        raw = _together((r.found - indirect + r.reflected) * r.taken, groups)
        if (
            everywhere and r is replicates[-1]
        ):  # together they are off by nothing, so the others tell what becomes of it
            own = sums
            own /= -weight
        else:
            own = _change(filter, raw)
            sums += weight * own
        gain -= weight * np.einsum("cp,cp->p", raw, own)
        both += weight * raw * own
        off += weight * raw * raw
        change += weight * own * own
    whole = sum(r.weight for r in replicates)
    scale = ratio(1.0, others * whole)
    finer = scale * _finer(replicates, others, whole)

    moved = _together(moved, groups)
    noise = np.einsum("cp->p", change)
    parts = np.stack([gain * finer, noise * finer, np.einsum("cp,cp->p", moved, moved)])
    gain, noise, blurred = filter.local_mean(parts)
    blurred -= noise
    trust = np.clip(ratio(gain, noise + np.maximum(blurred - (CHANCE - 1) * noise, 0.0)), 0.0, 1.0)
    # What is left of the light when all of the change is made, and the part of the change that is not made.
    both += change
    off -= change
    off += 2 * both
    off *= scale
    finer *= 1 - trust
    both *= 2 * finer
    off -= both
    finer *= 1 - trust
    change *= finer
    off += change
    blurred *= trust * trust
    return trust, np.maximum(off, 0.0, out=off), blurred


def _finer(replicates, others, whole):
    """(N,) what is to be made of the variance of the mean that replicates of weight `whole` (N,), one more than others
    (N,), show by their scatter, if it falls with the power 3/2 of their rays, and not with that of their weights.

    What the filter takes away falls so; judged by the weights, pilots of few rays would have it far too large, and what
    the filter does to the light itself would be lost in it.
    """
    variance = [1.0 / (r.rays * sqrt(r.rays)) for r in replicates]
    mean = ratio(sum(v * r.weight * r.weight for v, r in zip(variance, replicates)), whole)
    return ratio(others * mean, sum(v * r.weight for v, r in zip(variance, replicates)) - mean)


def mean_of(replicates, name):
    """(G C, N) a part of the light, the mean of all replicates."""
    total, whole = np.zeros(getattr(replicates[0], name).shape), 0.0
    for r in replicates:
        weight = r.test_weight if name == "direct" else r.weight
        total += weight * getattr(r, name)
        whole = whole + weight
    return np.divide(total, whole, out=total, where=whole > 0)


def _together(light, groups):
    """(C, N) light of all groups, of light (G C, N)."""
    return light.reshape(groups, -1, light.shape[1]).sum(axis=0)
