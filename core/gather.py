"""Phase 2: the light that arrives at points.

Owns the gathering of light at points and the filter of its indirect part. Every source counts exactly once: sampled
sources by test rays (`direct`), light of faces that are not sampled and of the sky by the gather rays that meet them
(also `direct`), reflected light by the gather rays that meet lit patches (`indirect`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .kernel import blocks
from .lights import FLAT, test_rays, unoccluded
from .records import to_arrays
from .sampling import R2, hemisphere, lattice, scatter, tangents
from .vectors import counted, dot, length, ratio

TASK_RAYS = 1 << 15  # of one task: some 10 ms
TABLES = 64  # direction tables, each turned by a step of its own; a point's shift picks one
APART = (0.41421356237309503, 0.7320508075688772)  # steps from point to point of the test rays' shifts
GATHER, TEST = 3, 4  # salts of the sample sequences

TESTS = 4  # test rays toward a source, before it is known whether it is partly hidden
PENUMBRA = 1.5  # more test rays where it is, as a multiple of the gather rays
DIM = 0.02  # a point that gets less than this share of its unoccluded light is tested DIM_TESTS times more
DIM_TESTS = 16

STEPS = 4  # diffusion steps of the filter
REACH = 0.4  # of the filter, in harmonic mean free distances, at 64 gather rays
SMOOTH = 0.9510565162951535  # cosine of 18 degrees: the largest turn between points that the filter mixes


@dataclass(frozen=True)
class Light:
    """Irradiance at P points [W/m^2], a row per color channel: direct (C, P) straight from sources, indirect (C, P)
    reflected at least once."""

    direct: np.ndarray
    indirect: np.ndarray


def gather(points, solution, surfaces, sky, diagonal, cells, settings):
    """Find the Light at points: a generator that yields (points done, all points) and returns the Light.

    sky: (C, M) exitance of the world, of each cell of its map [W/m^2]; diagonal: of the scene [m]. cells: started with `kernel.scene_arrays`.
    """
    # What rays bring, with what comes from beyond last: reflected light, and light no sampled source stands for.
    black = np.zeros_like(sky)
    reflected, found = np.column_stack([solution.reflected, black]), np.column_stack([surfaces.found, sky])
    nothing = np.zeros((len(sky), 0))
    cells.start(
        {
            **to_arrays("points", points),
            "gather.reflected": reflected if reflected.any() else nothing,
            "gather.found": found if found.any() else nothing,
        }
    )
    size = max(TASK_RAYS // (settings.gather_rays + TESTS), 1)
    starts = range(0, len(points), size)
    tasks = [
        cells.submit("gather", start=k, stop=min(k + size, len(points)), rays=settings.gather_rays, seed=settings.seed)
        for k in starts
    ]
    direct, indirect = np.zeros((len(sky), len(points))), np.zeros((len(sky), len(points)))
    nearness, links = np.zeros(len(points)), []
    for start, task in zip(starts, tasks):
        (result,) = cells.take([task])
        part = slice(start, start + len(result["nearness"]))
        direct[:, part], indirect[:, part] = result["direct"], result["indirect"]
        nearness[part] = result["nearness"]
        links.append(result["links"])
        yield part.stop, len(points)
    reach = REACH * np.sqrt(np.sqrt(64 / settings.gather_rays)) * diagonal
    links = np.concatenate([np.zeros(0, bool), *links])
    return Light(direct, smooth(points, indirect, reach / np.maximum(nearness, 1e-9), links))


def gather_points(kernel, start, stop, rays, seed):
    """Light at points start to stop: "direct", "indirect" (C, K) [W/m^2]; "nearness" (K,), the mean inverse distance
    that their rays went, in scene diagonals; "links" (E,) bool, which of their later neighbors they see along the edge.
    """
    reflected, found = kernel.arrays["gather.reflected"], kernel.arrays["gather.found"]
    direct = _direct(kernel, start, stop, rays, seed)
    indirect, nearness = np.zeros_like(direct), np.zeros(stop - start)
    if not (reflected.size or found.size):
        here, there = _pairs(kernel.points, start, stop)
        links = np.zeros(int((here + start < there).sum()), bool)
        return {"direct": direct, "indirect": indirect, "nearness": nearness, "links": links}
    tables = _direction_tables(rays, seed)
    for part in blocks(stop - start, rays):
        ids = np.arange(start, stop)[part]
        normal, geometric = kernel.points.normal[ids], kernel.points.geometric[ids]
        origin = kernel.caster.start(kernel.points.position[ids], geometric)
        directions = _world_rays(tables, ids, normal, seed)
        side, _, distance = kernel.sides_hit(np.repeat(origin, rays, axis=0), directions.reshape(3, -1).T)
        above = _above(directions, geometric) if (normal != geometric).any() else None
        if reflected.size:
            indirect[:, part] = _mean_light(reflected, side, rays, above)
        if found.size:
            direct[:, part] += _mean_light(found, side, rays, above)
        near = 1.0 / np.maximum(distance, 1e-6).astype(float)
        nearness[part] = np.einsum("kn->k", near.reshape(-1, rays)) / rays
    return {"direct": direct, "indirect": indirect, "nearness": nearness, "links": _links(kernel, start, stop)}


def _mean_light(light, side, rays, above):
    """(C, K) mean of what light (C, 2 N + M) brings along the rays that met sides (K * n,); above: (K, n) bool, the
    rays that count, or None for all."""
    seen = (np.take(channel, side, mode="wrap").reshape(-1, rays) for channel in light)
    if above is not None:
        seen = (np.where(above, channel, 0.0) for channel in seen)
    return np.stack([np.einsum("kn->k", channel) for channel in seen]) / rays


def smooth(points, light, reach, links):
    """Light (C, P) with its noise diffused over the mesh edges, by steps that bend with it.

    reach: (P,) how far light may be mixed [m]. links: (E,) bool, the edges (to later neighbors, in order) along which
    nothing stands. Points whose normals differ by more than 18 degrees are not mixed. What the diffusion F does to the
    light itself is undone in part: the result is 2 F - F F.
    """
    here, there = _pairs(points, 0, len(points))
    later = here < there
    here, there = here[later][links], there[later][links]
    apart = points.position[here] - points.position[there]
    distance = length(apart)
    degree = np.maximum(np.diff(points.neighbor_start), 1)
    share = np.minimum(reach[here], reach[there]) / np.maximum(distance, 1e-9 * np.maximum(reach[here], 1e-300))
    weight = np.minimum(1.0, share * share / 4) / np.maximum(degree[here], degree[there])
    weight[dot(points.normal[here], points.normal[there]) < SMOOTH] = 0.0

    def diffuse(light):
        for _ in range(STEPS):
            flow = [weight * (channel[there] - channel[here]) for channel in light]
            change = [np.bincount(here, f, len(points)) - np.bincount(there, f, len(points)) for f in flow]
            light = light + np.stack(change)
        return light

    once = diffuse(light)
    return np.maximum(2 * once - diffuse(once), 0.0)  # beside a steep edge the difference can fall below


def _links(kernel, start, stop):
    """(E,) bool: whether points start to stop see their neighbors with higher numbers, just above the surface."""
    points = kernel.points
    here, there = _pairs(points, start, stop)
    here = here + start
    here, there = here[here < there], there[here < there]
    if not kernel.occluded:
        return np.ones(len(here), bool)
    ends = [kernel.caster.start(points.position[k], points.geometric[k]) for k in (here, there)]
    return ~kernel.caster.blocked(*ends)


def _direct(kernel, start, stop, rays, seed):
    """(C, K) light of the sampled sources at points start to stop [W/m^2].

    All are tested a few times, with their neighbors outside the range; where a source is partly hidden, or hidden for
    one point and not for the next, more test rays follow.
    """
    points, sources = kernel.points, kernel.sources
    if not len(sources):
        return np.zeros((sources.strength.shape[1], stop - start))
    own = slice(start, stop)
    if not kernel.occluded and (points.normal[own] == points.geometric[own]).all():
        each = [unoccluded(sources, s, points.position[own], points.normal[own]) for s in range(len(sources))]
        return np.einsum("sk,sc->ck", np.stack(each), sources.strength)
    here, there = _pairs(points, start, stop)
    outside = np.unique(there[(there < start) | (there >= stop)])
    ids = np.concatenate([np.arange(start, stop), outside])
    there = np.where((there < start) | (there >= stop), stop - start + np.searchsorted(outside, there), there - start)
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
    weight, seen = np.zeros(factor.shape), np.zeros(factor.shape)
    for s in range(len(sources)):
        lit = np.flatnonzero(factor[:, s] > 0)
        if len(lit):
            weight[lit, s], seen[lit, s] = test(s, lit, 0, np.full(len(lit), 1 if _sharp(kernel, s) else TESTS))

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
        count = np.where(dim & (state >= 0), np.maximum(count, DIM_TESTS), count).astype(np.int64)
        more = np.flatnonzero(count[: stop - start])
        if len(more):
            extra = test(s, more, TESTS, count[more])
            weight[more, s] += extra[0]
            seen[more, s] += extra[1]
    arriving = (factor * ratio(seen, weight))[: stop - start]
    return np.einsum("ks,sc->ck", arriving, sources.strength)


def _sharp(kernel, s):
    """Whether a source is a mere point, which is seen or not."""
    return kernel.sources.kind[s] != FLAT and kernel.sources.radius[s] == 0 and not kernel.caster.veiled


def _pairs(points, start, stop):
    """The points from start to stop, counted from 0 and repeated, and their neighbors: two (E,) arrays."""
    runs = points.neighbor_start[start : stop + 1]
    return np.repeat(np.arange(stop - start), np.diff(runs)), points.neighbor[runs[0] : runs[-1]]


def _direction_tables(rays, seed):
    """(TABLES, 3, rays) float32 cosine-distributed directions about +z, each table's lattice shifted on."""
    u, v = lattice(rays)
    shift = (np.arange(TABLES) / TABLES + scatter(np.arange(1), GATHER + 8 * seed)) % 1.0
    direction = hemisphere((u + shift[:, None]) % 1.0, np.broadcast_to(v, (TABLES, rays)))
    return np.ascontiguousarray(np.moveaxis(direction, -1, 1)).astype(np.float32)


def _world_rays(tables, ids, normal, seed):
    """Directions (3, K, n) float32 of the rays of points: a table for each point, turned about its normal."""
    table = ((ids * R2[0]) % 1.0 * TABLES).astype(np.int64)
    turn = 2 * np.pi * ((ids * R2[1] + scatter(np.arange(1), GATHER + 8 * seed + 4)) % 1.0)
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


def _above(directions, geometric):
    """(K, n) bool: the rays (3, K, n) that leave above the surface itself."""
    g = geometric.astype(np.float32)
    return directions[0] * g[:, :1] + directions[1] * g[:, 1:2] + directions[2] * g[:, 2:] > 0


def _test_places(ids, number, s, seed):
    """Places a, b (K,) on source s for test rays `number` (K,) of points ids (K,): the R2 sequence, shifted by point."""
    shift = scatter(np.arange(2) + 2 * s, TEST + 8 * seed)
    return tuple((ids * APART[k] + number * R2[k] + shift[k]) % 1.0 for k in range(2))
