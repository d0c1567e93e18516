"""Phase 2: the light that arrives at points.

Owns the gathering of light at points and the filter of its indirect part. Every source counts exactly once: sampled
sources by test rays (`direct`), light of faces that are not sampled and of the sky by the gather rays that meet them
(also `direct`), reflected light by the gather rays that meet lit patches (`indirect`).
"""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass
from time import thread_time

import numpy as np

from .anew import read_light
from .kernel import blocks
from .lights import FLAT, test_rays, unoccluded
from .records import to_arrays
from .sampling import R2, hemisphere, lattice, scatter, tangents
from .vectors import counted, dot, length, ratio

TASK_RAYS = 1 << 15  # of one task: some 10 ms
TABLES = 64  # direction tables, each turned by a step of its own; a point's shift picks one
APART = (0.41421356237309503, 0.7320508075688772)  # steps from point to point of the test rays' shifts
GATHER, TEST = 3, 4  # salts of the sample sequences
REPLICATES = 12  # with steps of their own
SEEDS = 1 << 20  # between the seeds of replicates

TESTS = 4  # test rays toward a source, before it is known whether it is partly hidden
UNLIKE = 6  # times as many where the source does not shine in all directions alike
PENUMBRA = 1.5  # more test rays where it is, as a multiple of the gather rays
DIM = 0.02  # a point that gets less than this share of its unoccluded light is tested DIM_TESTS times more
DIM_TESTS = 16

PARTS = ("direct", "found", "reflected")  # of a point's light

STEPS = 6  # diffusion steps of the filter
COLUMNS = 8  # neighbors of a point that are summed with those of all others
REACH = 0.4  # of the filter, in harmonic mean free distances, at 64 gather rays
NEARBY = 8  # steps along edges over which noise is compared
CHANCE = 2.0  # times the noise: a change by the filter up to that is taken as noise (undoing less would not pay)
SMOOTH = 0.9510565162951535  # cosine of 18 degrees: the largest turn between points that the filter mixes


@dataclass(frozen=True)
class Light:
    """Irradiance at P points [W/m^2], a row per color channel: direct (C, P) straight from sources, indirect (C, P)
    reflected at least once; with light groups a row for each group's channels. variance: (C, P) of their sum over all groups, as the scatter between replicates shows it; 0 where nothing
    is known. blurred: (P,) square of what the filter does to the light itself, all channels together, so that
    its mean over many points is right (it may be negative at some). done: (P,) bool, the points that were gathered; the others have their patches' light.
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
    """One independent sample of the light, by so many rays at each of the points that are asked, (P,) bool: weight (P,), 0
    where it was not taken (yet), and (C, P) float32 each, direct light of sampled sources, light found by rays, and light
    reflected at least once [W/m^2]; nearness: (P,) float32 mean inverse distance that the rays went, in scene diagonals."""

    rays: int
    asked: np.ndarray
    weight: np.ndarray
    direct: np.ndarray
    found: np.ndarray
    reflected: np.ndarray
    nearness: np.ndarray

    @property
    def left(self):
        """(K,) int32 points where it is still to be taken."""
        return np.flatnonzero(self.asked & (self.weight == 0)).astype(np.int32)


@dataclass(frozen=True)
class Gathered:
    """What a Gathering has found so far: Replicates; closest (P,), the shortest way that any of their rays went, in scene
    diagonals; links (E,) bool, which neighbors see one another. As long as it goes on, so does this."""

    replicates: list
    closest: np.ndarray
    links: np.ndarray

    def copy(self):
        """The same, for another Gathering to go on from."""
        whole = [deepcopy(r) if len(r.left) else r for r in self.replicates]
        return Gathered(whole, self.closest.copy(), self.links.copy())


class Gathering:
    """Light at points, gathered in replicates: independent samples of the same light, to which more can be added.

    gathered: what there is so far, as Gathered. Replicates of n rays count by n^1.25: their variance falls by 1.0 to 1.6
    in the exponent, and what is said of it must not be too low.
    """

    def __init__(self, points, start, cells, settings, groups=1, gathered=None):
        """start: the Light to show where nothing was gathered yet. cells: started with `light_arrays`. groups: number of
        light groups, whose channels lie one after the other: noise is judged by their sum, so that they stay parts of it.
        gathered: what another Gathering of the same has found, to go on from.
        """
        self.points, self.cells, self.settings, self._start, self._groups = points, cells, settings, start, groups
        nothing = Gathered([], np.full(len(points), np.inf), np.zeros(len(points.neighbor), bool))
        self.gathered = gathered.copy() if gathered else nothing
        self._taken, self._light = None, None

    @property
    def rays(self):
        """(P,) gather rays so far."""
        return sum((r.rays * (r.weight > 0) for r in self.gathered.replicates), np.zeros(len(self.points)))

    @property
    def mean_rays(self):
        """Mean of the gather rays of all points."""
        return float(self.rays.mean()) if len(self.points) else 0.0

    @property
    def next(self):
        """Number of the first Replicate that is not complete, None if all are."""
        return next((k for k, r in enumerate(self.gathered.replicates) if len(r.left)), None)

    def ask(self, rays, ids=None):
        """Ask for another replicate of `rays` rays at points ids (K,), all if None."""
        count, light = len(self.points), (np.zeros(self._start.direct.shape, np.float32) for _ in PARTS)
        asked = np.ones(count, bool) if ids is None else np.isin(np.arange(count), ids)
        self.gathered.replicates.append(Replicate(rays, asked, np.zeros(count), *light, np.zeros(count, np.float32)))

    def gather(self):
        """Gather the first replicate that is not complete: a generator that yields the number of its points that are done.
        What is done counts at once."""
        number, replicate = self.next, self.gathered.replicates[self.next]
        ids, rays = replicate.left, replicate.rays
        size = max(TASK_RAYS // (rays + TESTS), 1)
        arguments = dict(rays=rays, seed=self.settings.seed + SEEDS * number, links=int(not number))
        parts = (ids[k : k + size] for k in range(0, len(ids), size))
        tasks = {self.cells.submit("gather", ids=part, **arguments): part for part in parts}
        done = int(replicate.asked.sum()) - len(ids)
        try:
            for task, part in tasks.items():
                self._add(replicate, part, *self.cells.take([task]))
                done += len(part)
                yield done
        finally:  # if it was broken off, later tasks may have been done before earlier ones
            for task, result in self.cells.brought(tasks).items():
                self._add(replicate, tasks[task], result)

    def _add(self, replicate, ids, result):
        """Add the result of a task at points ids (K,) to a Replicate."""
        points = self.points
        for name in (*PARTS, "nearness"):
            getattr(replicate, name)[..., ids] = result[name]
        self.gathered.closest[ids] = np.minimum(self.gathered.closest[ids], result["closest"])
        if "links" in result:
            here, number = counted(np.diff(points.neighbor_start)[ids].astype(np.int64))
            self.gathered.links[points.neighbor_start[ids][here] + number] = result["links"]
        replicate.weight[ids] = replicate.rays * np.sqrt(np.sqrt(replicate.rays))  # at last: what has it is whole

    def light(self, diagonal):
        """The Light so far, filtered; diagonal: of the scene [m].

        The filter is linear, so it can be applied to each replicate: how their results scatter shows the noise that is
        left in the mean, filtered as it is.
        """
        taken = len(self.gathered.replicates), float(self.rays.sum())
        if taken != self._taken:  # the same light is asked for after every look at its error
            self._taken, self._light = taken, self._filtered(diagonal)
        return self._light

    def _filtered(self, diagonal):
        replicates, rays = self.gathered.replicates, self.rays
        done = rays > 0
        if not done.any():
            return self._start
        links = self.gathered.links & np.repeat(done, np.diff(self.points.neighbor_start)) & done[self.points.neighbor]
        share = np.sqrt(np.sqrt(ratio(64.0, rays)))
        nearness = sum(r.rays * r.nearness.astype(float) for r in replicates)
        filter = _Filter(self.points, REACH * share * diagonal * ratio(rays, nearness), links)

        weights = [r.weight for r in replicates]
        whole = sum(weights)
        direct, found, reflected = (
            ratio(sum(r.weight * getattr(r, name) for r in replicates), whole) for name in PARTS
        )
        off = [np.where(r.weight > 0, r.found + r.reflected - found - reflected, 0.0) for r in replicates]
        off = [self._together(noise) for noise in off]
        trust, filtered, bias = _trust(filter, self._together(found + reflected), off, weights)
        # Beside a steep edge what is smoothed can fall below 0.
        found, reflected = (np.maximum(x + trust * (filter.smooth(x) - x), 0.0) for x in (found, reflected))

        scatter = np.zeros_like(off[0])
        for r, raw, smooth in zip(replicates, off, filtered):
            scatter += r.weight * (self._together(r.direct - direct) + raw + trust * (smooth - raw)) ** 2
        more = sum(r.weight > 0 for r in replicates) - 1
        return Light(
            np.where(done, direct + found, self._start.direct),
            np.where(done, reflected, self._start.indirect),
            ratio(scatter, whole * more),
            trust * trust * bias,
            done,
        )

    def _together(self, light):
        """(C, P) light of all groups, of light (G C, P)."""
        return light.reshape(self._groups, -1, light.shape[1]).sum(axis=0)


def light_arrays(points, solution, surfaces, sky):
    """The arrays that cells need to gather at points, as {name: array}. sky: (C, M) exitance of the
    world, of each cell of its map [W/m^2]."""
    # What rays bring, with what comes from beyond last: reflected light, and light no sampled source stands for.
    reflected = np.column_stack([solution.reflected, np.zeros_like(sky)])
    found = np.column_stack([surfaces.found, sky])
    nothing = np.zeros((len(sky), 0))
    through = nothing
    if surfaces.translucency.any():
        through = solution.reflected - surfaces.reflectance * solution.irradiance
    return {
        **to_arrays("points", points),
        "gather.reflected": reflected if reflected.any() else nothing,
        "gather.reflectance": surfaces.reflectance,
        "gather.through": through,
        "gather.found": found if found.any() else nothing,
    }


def gather_points(kernel, ids, rays, seed, links):
    """Light at points ids (K,): "direct" of sampled sources, "found" by rays and "reflected", (C, K) [W/m^2];
    "nearness" (K,), the mean inverse distance that their rays went, in scene diagonals; "closest" (K,), the shortest; if `links`, "links" (E,)
    bool, which of their neighbors they see along the edge."""
    reflected, found = kernel.arrays["gather.reflected"], kernel.arrays["gather.found"]
    count = kernel.sources.strength.shape[1]
    result = {name: np.zeros((count, len(ids))) for name in PARTS}
    result.update(nearness=np.zeros(len(ids)), closest=np.full(len(ids), np.inf))
    begun = thread_time()
    result["direct"] = _direct(kernel, ids, rays, seed)
    kernel.caster.note("sources", begun)
    if links:
        begun = thread_time()
        result["links"] = _links(kernel, ids)
        kernel.caster.note("links", begun)
    if not (reflected.size or found.size):
        return result
    tables = direction_tables(rays, seed)
    for part in blocks(len(ids), rays):
        normal, geometric = kernel.points.normal[ids[part]], kernel.points.geometric[ids[part]]
        origin = kernel.caster.start(kernel.points.position[ids[part]], geometric)
        directions = world_rays(tables, ids[part], normal, seed)
        hit = kernel.hits(np.repeat(origin, rays, axis=0), directions.reshape(3, -1).T)
        above = above_surface(directions, geometric) if (normal != geometric).any() else None
        if reflected.size:
            result["reflected"][:, part] = _mean(read_light(reflected, hit.side), rays, above)
        if found.size:
            result["found"][:, part] = _mean(read_light(found, hit.side), rays, above)
        near = 1.0 / np.maximum(hit.distance, 1e-6).astype(float)
        result["nearness"][part] = np.einsum("kn->k", near.reshape(-1, rays)) / rays
        result["closest"][part] = hit.distance.reshape(-1, rays).min(axis=1)
    return result


def find_sides(kernel, position, up):
    """{"side": (K,) int32} the patch sides that places (K, 3), just above surfaces with normals (K, 3), lie on."""
    hit = kernel.hits(kernel.caster.start(position, up), -up.astype(np.float32))
    return {"side": hit.side}


def sides_of(points, cells):
    """(P,) int32 the patch side that each point lies on. cells: started with the arrays of transport."""
    size = TASK_RAYS
    parts = [slice(k, k + size) for k in range(0, len(points), size)]
    tasks = [cells.submit("sides", position=points.position[p], up=points.geometric[p]) for p in parts]
    return np.concatenate([np.zeros(0, np.int32), *(result["side"] for result in cells.take(tasks))])


def patch_light(side, solution):
    """The Light at points as the patch sides (P,) they lie on have it: what there is before anything is gathered."""
    direct, none = solution.direct[:, side], np.zeros(len(side))
    indirect = solution.irradiance[:, side] - direct
    return Light(direct, indirect, np.zeros_like(direct), none, none > 0)


def _mean(light, rays, above):
    """(C, K) mean of the light (C, K * n) along rays; above: (K, n) bool, the rays that count, or None for all."""
    light = light.reshape(len(light), -1, rays)
    if above is not None:
        light = np.where(above, light, 0.0)
    return np.einsum("ckn->ck", light) / rays


class _Filter:
    """Diffusion of light over the mesh edges between P points, by steps that bend with it.

    reach: (P,) how far light may be mixed [m]. links: (E,) bool, the edges (to neighbors, in order) along which nothing
    stands. Points whose normals differ by more than 18 degrees are not mixed. All light is (K, P), a row per quantity.
    """

    def __init__(self, points, reach, links):
        here, there = pairs(points, np.arange(len(points)))
        joined = links & (dot(points.normal[here], points.normal[there]) >= SMOOTH)
        here, there = here[joined], there[joined]
        distance = length(points.position[here] - points.position[there])
        degree = np.maximum(np.diff(points.neighbor_start), 1)
        share = np.minimum(reach[here], reach[there])
        share /= np.maximum(distance, 1e-9 * np.maximum(reach[here], 1e-300))
        weight = np.minimum(1.0, share * share / 4) / np.maximum(degree[here], degree[there])
        self._flow = _EdgeSums(here, there, weight, len(points))
        self._mean = _EdgeSums(here, there, np.ones(len(here)), len(points))
        self._stays = 1.0 - np.bincount(here, weight, len(points))
        self._degree = np.bincount(here, minlength=len(points))

    def smooth(self, light):
        """Light with its noise diffused. What the diffusion F does to the light itself is undone in part: 2 F - F F."""
        once = self._diffuse(light)
        return 2 * once - self._diffuse(once)

    def local_mean(self, values):
        """Values averaged with those of their neighbors, and theirs."""
        for _ in range(NEARBY):
            values = (values + self._mean(values)) / (1 + self._degree)
        return values

    def _diffuse(self, light):
        for _ in range(STEPS):
            before, light = light, self._stays * light + self._flow(light)
        # Half of the last step: a pattern that changes sign from point to point, as on a chessboard, would turn round in
        # every whole step and never fade.
        return (before + light) / 2


class _EdgeSums:
    """Sums of values (K, P) of the neighbors of P points, weighted by edge: (K, P).

    Edges (E,) are given by their ends, sorted by `here`. The first few of every point are summed a column at a time, all
    points together, which takes a sixth of the time of sums of unequal length; those go over the edges that are left.
    """

    def __init__(self, here, there, weight, count):
        degree = np.bincount(here, minlength=count)
        rank = np.arange(len(here)) - (np.cumsum(degree) - degree)[here]
        wide = 0
        while wide < COLUMNS and 4 * np.count_nonzero(degree > wide) >= count:
            wide += 1
        self._columns = []
        for k in range(wide):
            edge = rank == k
            neighbor, share = np.arange(count), np.zeros(count)
            neighbor[here[edge]], share[here[edge]] = there[edge], weight[edge]
            self._columns.append((neighbor, share))
        left = rank >= wide
        self._there, self._weight, here = there[left], weight[left], here[left]
        self._start = np.flatnonzero(np.append(True, here[1:] != here[:-1])) if len(here) else np.zeros(0, np.int64)
        self._joined = here[self._start]

    def __call__(self, values):
        result = np.zeros_like(values)
        for neighbor, share in self._columns:
            result += np.take(values, neighbor, axis=1) * share
        if len(self._start):
            far = np.take(values, self._there, axis=1) * self._weight
            result[:, self._joined] += np.add.reduceat(far, self._start, axis=1)
        return result


def _trust(filter, light, off, weights):
    """(P,) how far the filter is to be trusted at each point, 0..1: so that the error of what is filtered so far is least.

    light: (C, P) unfiltered mean of replicates; off: R times (C, P), how far each is off it; weights: R times (P,).
    With V the variance of the mean, V' of what is filtered of it and K what they have in common, and b what the filter
    does to the light itself, the error of a filtered share a is (1 - a)^2 V + 2 a (1 - a) K + a^2 (V' + b^2). How much
    more the filter changes than the noise explains, V - 2 K + V', shows b^2. All of them are means over neighbors.
    """
    whole = sum(weights)
    count = sum(w > 0 for w in weights) - 1
    if not count.any():  # one replicate alone shows no noise
        return np.ones(len(whole)), off, np.zeros(len(whole))

    def spread(values):
        return sum(w * v for w, v in zip(weights, values))

    filtered = [filter.smooth(o) for o in off]
    change = ((filter.smooth(light) - light) ** 2).sum(axis=0)
    own = spread((o * o).sum(axis=0) for o in off)
    common = spread((o * f).sum(axis=0) for o, f in zip(off, filtered))
    theirs = spread((f * f).sum(axis=0) for f in filtered)
    parts = ratio(np.stack([own, common, theirs]), whole * count)
    own, common, theirs, change = filter.local_mean(np.vstack([parts, change]))
    noise = own - 2 * common + theirs
    plain = noise + np.maximum(change - CHANCE * noise, 0.0)
    return np.clip(ratio(own - common, plain), 0.0, 1.0), filtered, change - noise


def _links(kernel, ids):
    """(E,) bool: whether points ids see their neighbors, just above the surface. Both ends cast the same ray."""
    here, there = pairs(kernel.points, ids)
    if not kernel.occluded:
        return np.ones(len(here), bool)
    low, high = np.minimum(ids[here], there), np.maximum(ids[here], there)
    ends = (kernel.caster.start(kernel.points.position[k], kernel.points.geometric[k]) for k in (low, high))
    return ~kernel.caster.blocked(*ends)


def _direct(kernel, own, rays, seed):
    """(C, K) light of the sampled sources at points own (K,), which are sorted [W/m^2].

    All are tested a few times, with their neighbors; where a source is partly hidden, or hidden for one point and not
    for the next, more test rays follow.
    """
    points, sources = kernel.points, kernel.sources
    if not len(sources):
        return np.zeros((sources.strength.shape[1], len(own)))
    if not kernel.occluded and (points.normal[own] == points.geometric[own]).all():
        each = [unoccluded(sources, s, points.position[own], points.normal[own]) for s in range(len(sources))]
        return np.einsum("sk,sc->ck", np.stack(each), sources.strength)
    here, neighbor = pairs(points, own)
    ids = np.concatenate([own, np.setdiff1d(neighbor, own)])
    order = np.argsort(ids, kind="stable")
    there = order[np.searchsorted(ids, neighbor, sorter=order)]
    position, normal, geometric = points.position[ids], points.normal[ids], points.geometric[ids]
    origin = kernel.caster.start(position, geometric)

    def test(s, who, first, count):
        """Sums of the weights (K,) of `count` (K,) test rays of each of `who` (K,), from number `first` on, and of
        those that get through."""
        owner, number = counted(count)
        a, b = _test_places(ids[who][owner], first + number, s, seed)
        each = (x[who][owner] for x in (position, normal, geometric, origin))
        weight, seen = test_rays(sources, s, kernel.caster, *each, a, b)
        begin = np.cumsum(count) - count
        return np.add.reduceat(weight, begin), np.add.reduceat(seen, begin)

    factor = np.stack([unoccluded(sources, s, position, normal) for s in range(len(sources))], axis=1)
    weight, seen, tested = np.zeros(factor.shape), np.zeros(factor.shape), thread_time()
    for s in range(len(sources)):
        lit = np.flatnonzero(factor[:, s] > 0)
        if len(lit):
            weight[lit, s], seen[lit, s] = test(s, lit, 0, np.full(len(lit), _tests(kernel, s)))

    # Where the light is partly hidden: more rays, by the source's share of what the point could get.
    possible = factor * sources.strength.max(axis=1)
    share = ratio(possible, possible.sum(axis=1, keepdims=True))
    dim = (possible * ratio(seen, weight)).sum(axis=1) < DIM * possible.sum(axis=1)
    for s in range(len(sources)):
        if _sharp(kernel, s):
            continue
        state = np.where(weight[:, s] > 0, np.sign(seen[:, s]) + (seen[:, s] < weight[:, s]), -1)
        differs = (state[here] != state[there]) & (state[here] >= 0) & (state[there] >= 0)
        mixed = (state == 2) | (np.bincount(here, differs, len(ids)) > 0)
        count = np.where(mixed, np.clip(PENUMBRA * rays * np.sqrt(share[:, s]), 4, 2 * PENUMBRA * rays), 0)
        count = np.where(dim & (state >= 0), np.maximum(count, DIM_TESTS), count)
        count = count.astype(np.int64)
        more = np.flatnonzero(count[: len(own)])
        if len(more):
            extra = test(s, more, _tests(kernel, s), count[more])
            weight[more, s] += extra[0]
            seen[more, s] += extra[1]
    arriving = (factor * ratio(seen, weight))[: len(own)]
    kernel.caster.note("occlusion", tested)
    return np.einsum("ks,sc->ck", arriving, sources.strength)


def _tests(kernel, s):
    """Test rays toward a source before anything is known. One that does not shine in all directions alike needs more of
    them: the share that is visible is a ratio of sums of weights, which few very unlike weights bias."""
    if _sharp(kernel, s):
        return 1
    return TESTS if kernel.sources.cone[s, 0] <= -1 else UNLIKE * TESTS


def _sharp(kernel, s):
    """Whether a source is a mere point, which is seen or not."""
    return kernel.sources.kind[s] != FLAT and kernel.sources.radius[s] == 0 and not kernel.caster.veiled


def pairs(points, ids):
    """Points ids (K,), as rows 0 to K - 1, repeated, and their neighbors: two (E,) arrays."""
    here, number = counted((points.neighbor_start[ids + 1] - points.neighbor_start[ids]).astype(np.int64))
    return here, points.neighbor[points.neighbor_start[ids][here] + number]


def direction_tables(rays, seed):
    """(TABLES, 3, rays) float32 cosine-distributed directions about +z.

    The golden-ratio lattice on the hemisphere's disk is a sunflower. From table to table each ray moves on within its own
    ring, so that the sunflower keeps its shape: up to a quarter less noise than a shift that wraps around (measured).
    """
    u, v = lattice(rays)
    shift = (np.arange(TABLES) / TABLES + scatter(np.arange(1), GATHER + 8 * seed))[:, None] % 1.0
    direction = hemisphere(u + (shift - 0.5) / rays, np.broadcast_to(v, (TABLES, rays)))
    return np.ascontiguousarray(np.moveaxis(direction, -1, 1)).astype(np.float32)


def world_rays(tables, ids, normal, seed):
    """Directions (3, K, n) float32 of the rays of points: a table for each point, turned about its normal.

    Tables and turns go through the points in steps that differ from replicate to replicate: with the same steps, two
    replicates would differ by one and the same shift at all points, and their scatter would show one draw, not many.
    """
    place = np.asarray(ids, np.int64) * (1 + seed // SEEDS % REPLICATES)
    table = ((place * R2[0]) % 1.0 * TABLES).astype(np.int64)
    turn = 2 * np.pi * ((place * R2[1] + scatter(np.arange(1), GATHER + 8 * seed + 4)) % 1.0)
    t1, t2 = tangents(normal)
    cosine, sine = np.cos(turn)[:, None], np.sin(turn)[:, None]
    frame = np.stack([cosine * t1 + sine * t2, cosine * t2 - sine * t1, normal], axis=1).astype(np.float32)
    local = tables[table]
    directions = np.empty((3, *local[:, 0].shape), np.float32)
    for k in range(3):
        directions[k] = frame[:, 0, k, None] * local[:, 0]
        directions[k] += frame[:, 1, k, None] * local[:, 1]
        directions[k] += frame[:, 2, k, None] * local[:, 2]
    return directions


def above_surface(directions, geometric):
    """(K, n) bool: the rays (3, K, n) that leave above the surface itself."""
    g = geometric.astype(np.float32)
    return directions[0] * g[:, :1] + directions[1] * g[:, 1:2] + directions[2] * g[:, 2:] > 0


def _test_places(ids, number, s, seed):
    """Places a, b (K,) on source s for test rays `number` (K,) of points ids (K,): the R2 sequence, shifted by point."""
    shift = scatter(np.arange(2) + 2 * s, TEST + 8 * seed)
    return tuple((ids * APART[k] + number * R2[k] + shift[k]) % 1.0 for k in range(2))
