"""Phase 2: the light that arrives at points.

Owns the gathering of light at points. Every source counts exactly once: sampled sources by test rays (`direct`), light of
faces that are not sampled and of the sky by the gather rays that meet them (also `direct`), reflected light by the gather
rays that meet lit patches (`indirect`).
"""

from __future__ import annotations

from collections import deque
from copy import deepcopy
from dataclasses import dataclass, replace
from hashlib import blake2b
from time import thread_time

import numpy as np

from .anew import edge_arrays, read_light, read_reflected
from .direct import TESTS, light_of_crowd, light_of_sources
from .guide import NOTHING, Aim, guide_samples
from .points import Block, block_arrays
from .records import to_arrays
from .replicates import (
    PARTS,
    WHOLE,
    Light,
    Replicate,
    block_of_light,
    direct_variance,
    light_blocks,
    light_of_block,
    mean_light,
    mean_of,
)
from .sampling import R2, fraction, hemisphere, lattice, scatter, tangents
from .vectors import counted, ratio, runs, span

# Rays of one task at most, less than 0.1 s. Points of a task share what is cast for neighbors: with half of the rays each
# takes 7 % longer, with an eighth a third (measured where every point has 1500).
TASK_RAYS = 1 << 18
LEAST_RAYS = 1 << 15  # of one task at least: a task takes some 3 ms however few they are, a third of what 2^13 take
LEAST_POINTS = 16  # of one task: each of a few would bring as many neighbors along
TASK_POINTS = 1 << 12  # of one task at most
SHARES = 2  # for each cell, of what is left, is a task at most: they get ever smaller, so that cells end together
TABLES = 64  # direction tables, each turned by a step of its own; a point's shift picks one
GATHER = 3  # salt of the sample sequences
SIDES = 1 << 15  # points of a task that finds which patch sides they lie on
POINT_BYTES = 150  # that a point takes in a task, there and back
BLOCK_BYTES = 6e6  # that a replicate has in a block of light
WAITING_SHARE = 0.05  # of the memory that may be used, for tasks that wait for cells
REPLICATES = 12  # with steps of their own
SEEDS = 1 << 20  # between the seeds of replicates

GUIDED_SHARE = 0.25  # guided rays, if there are any, for each ray over the hemisphere


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

    gathered: what there is so far, as Gathered.
    """

    def __init__(self, points, rows, start, cells, settings, groups=1, gathered=None):
        """rows: of light, channels times groups. start: function that returns the Light to show where nothing was gathered
        yet. cells: started with `light_arrays`. groups: number of
        light groups, whose channels lie one after the other: noise is judged by their sum, so that they stay parts of it.
        gathered: what another Gathering of the same has found, to go on from.
        """
        self.points, self.cells, self.settings, self._start, self._groups = points, cells, settings, start, groups
        nothing = Gathered([], np.full(len(points), np.inf, np.float32), np.zeros(len(points.neighbor), bool))
        self.gathered = gathered.copy() if gathered else nothing
        self._shape = rows, len(points)
        self._taken, self._light = None, None

    @property
    def rays(self):
        """(P,) gather rays so far."""
        return sum((r.rays * r.taken for r in self.gathered.replicates), np.zeros(len(self.points)))

    @property
    def mean_rays(self):
        """Mean of the gather rays of all points."""
        return float(self.rays.mean()) if len(self.points) else 0.0

    @property
    def next(self):
        """Number of the first Replicate that is not complete, None if all are."""
        return next((k for k, r in enumerate(self.gathered.replicates) if len(r.left)), None)

    def ask(self, rays, ids=None, test_rays=None):
        """Ask for another replicate of `rays` rays at points ids (K,), all if None; test_rays: so many of them have test rays
        toward sources with them, None: all."""
        count, light = len(self.points), (np.zeros(self._shape, np.float32) for _ in PARTS)
        asked = np.ones(count, bool) if ids is None else np.isin(np.arange(count), ids)
        self.gathered.replicates.append(
            Replicate(
                rays,
                rays if test_rays is None else test_rays,
                asked,
                np.zeros(count, bool),
                *light,
                np.zeros(count, np.float32),
            )
        )

    def gather(self):
        """Gather the first replicate that is not complete: a generator that yields the number of its points that are done.
        What is done counts at once."""
        number, replicate = self.next, self.gathered.replicates[self.next]
        ids, rays = replicate.left, replicate.rays
        arguments = dict(
            rays=rays,
            test_rays=replicate.test_rays,
            tests=self.settings.light_samples,
            seed=self.settings.seed + SEEDS * number,
            links=int(not number),
        )
        size = task_size(len(ids), rays + TESTS, self.cells)
        tasks, most = {}, min(self.cells.flow_each * self.cells.count, self._waiting(POINT_BYTES * size))
        done = int(replicate.asked.sum()) - len(ids)
        try:
            while tasks or len(ids):
                while len(ids) and len(tasks) < most:  # never all: each carries its points
                    part, ids = np.split(ids, [task_size(len(ids), rays + TESTS, self.cells)])
                    tasks[self.cells.submit("gather", **arguments, **block_arrays(self.points, part))] = part
                first = next(iter(tasks))
                self._add(replicate, tasks[first], *self.cells.take([first]))
                done += len(tasks.pop(first))
                yield done
        finally:  # if it was broken off, later tasks may have been done before earlier ones
            for task, result in self.cells.brought(tasks).items():
                self._add(replicate, tasks[task], result)

    def _waiting(self, size):
        """How many tasks of so many bytes may wait for cells at a time."""
        return max(int(WAITING_SHARE * self.settings.memory / size), 1)

    def _add(self, replicate, ids, result):
        """Add the result of a task at points ids (K,) to a Replicate."""
        points, own = self.points, span(ids)
        for name in (*PARTS, "nearness"):
            if result[name].any():  # memory that is not written to is not taken
                getattr(replicate, name)[..., own] = result[name]
        self.gathered.closest[own] = np.minimum(self.gathered.closest[own], result["closest"])
        if "links" in result:
            here, number = counted(np.diff(points.neighbor_start)[ids].astype(np.int64))
            self.gathered.links[points.neighbor_start[ids][here] + number] = result["links"]
        replicate.taken[own] = True  # at last: what has it is whole

    def sampled(self, ids):
        """(G C, K) light of the sampled sources alone at points ids (K,), a part of the direct light."""
        weight = [r.test_weight[ids] for r in self.gathered.replicates]
        total = sum(w * r.direct[:, ids] for w, r in zip(weight, self.gathered.replicates))
        return ratio(total, sum(weight))

    def direct_noise(self):
        """(P,) variance of the direct light of sampled sources [W^2/m^4], summed over channels."""
        variance = np.empty(len(self.points))
        for part in light_blocks(len(self.points), len(self.points) > WHOLE):
            own = [r.part(part) for r in self.gathered.replicates]
            variance[part] = direct_variance(own, mean_of(own, "direct"), self._groups).sum(axis=0)
        return variance

    def of(self, replicates):
        """A Gathering of some of the replicates alone."""
        own = replace(self.gathered, replicates=replicates)
        return Gathering(self.points, self._shape[0], self._start, self.cells, self.settings, self._groups, own)

    def light(self, diagonal):
        """The Light so far, filtered; diagonal: of the scene [m]. See `mean_light`."""
        (light,) = deque(self.smoothing(diagonal, in_cells=False), maxlen=1)
        return light

    def smoothing(self, diagonal, in_cells=True):
        """The Light so far, as `light`, where there are many points by the cells: a generator that yields None for every
        block of points, and the Light in the end."""
        taken = len(self.gathered.replicates), float(self.rays.sum())
        if taken != self._taken:  # the same light is asked for after every look at its error
            self._taken = self._light = None  # two would take twice the memory
            light = yield from self._filtered(diagonal, in_cells)
            self._taken, self._light = taken, light
        yield self._light

    def _filtered(self, diagonal, in_cells):
        replicates, done = self.gathered.replicates, self.rays > 0
        if not done.any():
            return self._start()
        many = len(done) * self.cells.points_each > WHOLE
        parts = light_blocks(len(done), many)
        if not many:
            blocks = [mean_light(self.points, self.gathered.links, replicates, self._groups, diagonal)]
        else:
            more = dict(rows=self._shape[0], groups=self._groups, diagonal=float(diagonal))
            each = (block_of_light(self.points, self.gathered.links, replicates, part) | more for part in parts)
            blocks = (light_of_block(None, **own) for own in each)
            if in_cells:
                blocks = self.cells.flow("smooth", each, self._waiting(BLOCK_BYTES * len(replicates)))
        direct, indirect = np.empty(self._shape), np.empty(self._shape)
        variance, blurred = np.empty((self._shape[0] // self._groups, len(done))), np.empty(len(done))
        light = Light(direct, indirect, variance, blurred, done)
        for part, block in zip(parts, blocks):
            for name, array in block.items():
                getattr(light, name)[..., part] = array
            yield
        if not done.all():
            start = self._start()
            np.copyto(direct, start.direct, where=~done)
            np.copyto(indirect, start.indirect, where=~done)
        return light


def light_arrays(points, solution, surfaces, sky, side, close=(0.0, 0.0), gaps=False):
    """The arrays that cells need to gather at points, as {name: array}. sky: (C, M) exitance of the
    world, of each cell of its map [W/m^2]. side: (P,) the patch side that each point lies on. close: how near hits of
    fine meshes go on, and how fine these are, see `choices.goes_on`; gaps: whether those across narrow gaps do, see `anew`."""
    light = _on_sides(solution.irradiance, side).max(axis=0)
    # What rays bring, with what comes from beyond last: reflected light, and light no sampled source stands for.
    reflected = np.column_stack([solution.reflected, np.zeros_like(sky)])
    found = np.column_stack([surfaces.found, sky])
    nothing = np.zeros((len(sky), 0))
    through = nothing
    if surfaces.translucency.any():
        through = solution.reflected - surfaces.reflectance * solution.irradiance
    level = np.sqrt((points.area * light * light).sum() / max(points.area.sum(), 1e-300))
    # Cells know no points; but what they have found out at some is not true of others.
    place = blake2b(np.ascontiguousarray(points.position), digest_size=16)
    place.update(np.ascontiguousarray(points.normal))
    return {
        "points.count": np.array(len(points)),
        "points.print": np.frombuffer(place.digest(), np.uint8),
        **to_arrays("guide", solution.guide or NOTHING),
        "gather.reflected": reflected if reflected.any() else nothing,
        "gather.reflectance": surfaces.reflectance,
        "gather.through": through,
        "gather.level": level,
        "gather.close": np.array(close),
        "gather.gaps": np.array(gaps),
        **edge_arrays(solution.edges if reflected.any() else None, surfaces.reflectance, level),
        "gather.found": found if found.any() else nothing,
    }


def task_size(count, rays, cells):
    """How many points a task gets of `count` that are left, with so many rays each. What a point gets does not depend on
    it."""
    least, most = (max(number // rays, LEAST_POINTS) for number in (LEAST_RAYS, TASK_RAYS))
    return min(max(count * cells.points_each // (SHARES * cells.count), least), most, TASK_POINTS)


def gather_points(kernel, rays, test_rays, tests, seed, links, **points):
    """Light at the K points of a Block, by `rays` rays and `tests` times the usual test rays of test_rays: "direct" of sampled
    sources, "found" by rays and "reflected", (C, K) float32 [W/m^2]; "nearness" (K,) float32, the mean inverse distance
    that their rays went, in scene diagonals; "closest" (K,) float32, the shortest; if `links`, "links" (E,) bool, which
    of their neighbors they see along the edge."""
    reflected, found = kernel.arrays["gather.reflected"], kernel.arrays["gather.found"]
    points, count = Block(**points), kernel.sources.strength.shape[1]
    result = {name: np.zeros((count, len(points)), np.float32) for name in PARTS}
    result.update(nearness=np.zeros(len(points), np.float32), closest=np.full(len(points), np.inf, np.float32))
    begun = thread_time()
    if test_rays:
        result["direct"][:] = light_of_sources(kernel, points, test_rays, tests, seed)
        if kernel.crowd is not None:
            result["direct"] += light_of_crowd(kernel, points, test_rays, tests, seed)
    kernel.caster.note("sources", begun)
    if links:
        begun = thread_time()
        result["links"] = _links(kernel, points)
        kernel.caster.note("links", begun)
    if not (reflected.size or found.size):
        return result
    shooter = Shooter(kernel, points, rays, seed)
    for part in runs(len(points), shooter.each):
        hit, weight = shooter.shoot(part)
        if reflected.size:
            light = read_reflected(kernel, hit, points.ids[part], points.geometric[part], points.size[part], seed)
            result["reflected"][:, part] = weighted_sum(light, weight)
        if found.size:
            result["found"][:, part] = weighted_sum(read_light(found, hit.side), weight)
        distance = hit.distance.reshape(-1, shooter.each)[:, :rays]
        near = 1.0 / np.maximum(distance, 1e-6).astype(float)
        result["nearness"][part] = np.einsum("kn->k", near) / rays
        result["closest"][part] = distance.min(axis=1)
    return result


class Shooter:
    """Rays from the points of a Block: `rays` over the hemisphere of each, and guided ones if there are any, `each` in
    all."""

    def __init__(self, kernel, points, rays, seed):
        self._kernel, self._points, self._rays, self._seed = kernel, points, rays, seed
        self._tables = kernel.once(direction_tables, rays, seed)
        self._guided = max(int(GUIDED_SHARE * rays), 1) if kernel.guide else 0
        self.each = rays + self._guided

    def shoot(self, part):
        """What the rays of part of the points, a slice, meet, as Hits of K * each rays, and what each counts, (K, each)."""
        kernel, points, rays = self._kernel, self._points, self._rays
        ids, position, normal, geometric = (
            x[part] for x in (points.ids, points.position, points.normal, points.geometric)
        )
        directions = world_rays(self._tables, ids, normal, self._seed)
        if self._guided:
            aim = Aim(kernel.guide, position, normal)
            more = aim.rays(position[:, None], *guide_samples(ids, self._guided, self._seed))
            directions = np.concatenate([directions, more], axis=2)
        origin = np.repeat(kernel.caster.start(position, geometric), self.each, axis=0)
        hit = kernel.hits(origin, directions.reshape(3, -1).T)
        weight = np.full((len(ids), self.each), 1.0 / rays)
        if self._guided:
            weight = aim.weights(hit, directions, normal[:, None], rays)
        if (normal != geometric).any():
            weight = weight * above_surface(directions, geometric)
        return hit, weight


def find_sides(kernel, position, up):
    """{"side": (K,) int32} the patch sides that places (K, 3), just above surfaces with normals (K, 3), lie on, whether light
    passes them or not; -1 where there is none, as of faces too small for rays."""
    origin, way = kernel.caster.start(position, up), -up.astype(np.float32)
    triangle, u, v, _, back = kernel.caster.hits(origin, way, passing=False)
    side = 2 * kernel.patch_hit(triangle, u, v) + back
    return {"side": np.where(triangle < 0, -1, side).astype(np.int32)}


def sides_of(points, cells):
    """(P,) int32 the patch side that each point lies on, -1 for none. cells: started with the arrays of transport."""
    parts = [slice(k, k + SIDES) for k in range(0, len(points), SIDES)]
    tasks = [cells.submit("sides", position=points.position[p], up=points.geometric[p]) for p in parts]
    return np.concatenate([np.zeros(0, np.int32), *(result["side"] for result in cells.take(tasks))])


def patch_light(side, solution):
    """The Light at points as the patch sides (P,) they lie on have it: what there is before anything is gathered."""
    direct = _on_sides(solution.direct, side)
    indirect = _on_sides(solution.irradiance, side)
    indirect -= direct
    nothing = np.zeros(1)  # for all points
    unknown = np.broadcast_to(nothing, direct.shape)
    return Light(direct, indirect, unknown, unknown[0], np.zeros(len(side), bool))


def _on_sides(light, side):
    """(C, P) light (C, 2 N) of sides (P,), 0 where that is -1."""
    return np.where(side < 0, 0.0, light[:, side])


def weighted_sum(light, weight):
    """(C, K) sums of the light (C, K * n) along rays times weight (K, n)."""
    return np.einsum("ckn,kn->ck", light.reshape(len(light), *weight.shape), weight)


def _links(kernel, points):
    """(E,) bool: whether the points of a Block see their neighbors, just above the surface. Both ends cast the same ray."""
    here, there = points.edges
    if not kernel.occluded:
        return np.ones(len(here), bool)
    upward = points.ids[here] < points.ids[there]
    low, high = np.where(upward, here, there), np.where(upward, there, here)
    ends = (kernel.caster.start(points.position[k], points.geometric[k]) for k in (low, high))
    return ~kernel.caster.blocked(*ends)


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
    table = (fraction(place * R2[0]) * TABLES).astype(np.int64)
    turn = 2 * np.pi * fraction(place * R2[1] + scatter(np.arange(1), GATHER + 8 * seed + 4))
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
