"""Phase 1, the host: the radiosity of all patch sides, by rounds of shooting and a solve over the rows that were kept.

The host alone owns radiosity and unshot power, in a `Transport`; cells only find where light goes. A round: the host
picks the sides of highest unshot power, cells trace their form-factor rows, the host adds what each sends, in the order
of the picks. Rows are kept: light that comes back to a side is shot again through its row at no cost in rays, and at the
end every side gathers over its own row until nothing changes.
Source: Kunitani, Sato, Kondo, Shimada, "Parallel Processing of Reflex Action in Radiosity Calculation".
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from time import perf_counter

import numpy as np

from .accuracy import RARE
from .anew import Edges
from .guide import LOOK_RAYS, NOTHING, bright_sides, make_guide
from .kept import ENDLESS, HIT_BYTES, ROW_BYTES, AnalyticRows, RayRows, joined_rows
from .records import to_arrays
from .transport import Transport, round_of

TASK_RAYS = 1 << 15  # of one task at most: some 10 ms
LEAST_RAYS = 1 << 13  # of one task at least: less is not worth a message and the calls that any task takes
ANALYTIC_TASK = 4  # analytic rows of one task at most
SHARES = 4  # tasks of a batch that a cell gets at least, if they are not too small: no cell waits long for another
ROWS_SHARE = 0.25  # of the memory that a bake may use, for kept rows
LEAST_ROW = 8  # rays, of which a row tells its own noise; a patch takes ten times as much memory
LAG = 3  # batches in flight; a batch is picked from the state that so many batches before it left
FACING = 256  # patches that tell how many are in front of a side
GUIDED_ROWS = 0.25  # rays of each kind for the first light of bright sides, for each ray of a row: more take off little
MOST_ROWS = 30  # rows that are found of each side in the mean, where memory holds only few of them; then it ends


def solve(patches, surfaces, sky, cells, settings, survey=None, known=None, written=None, points=0, owner=None):
    """Find the Solution: a generator that yields a Round after every round and returns the Solution.

    sky: (C, M) exitance of the world, of each cell of its map [W/m^2]. survey: the Survey of the scene, if one was
    made. cells: started with `kernel.scene_arrays`. known: a Solution for the same, perhaps unfinished, whose direct
    light and rows are taken, not traced again; the result has the bits that it would have without. written: (2 N,)
    bool, sides whose light is asked for; None: all. points: about how many there will be to gather at. owner: (2 N,) object
    of each side, if every object is to reach the error by itself; None: the whole.
    """
    begun = perf_counter()
    count, target = 2 * len(patches), settings.error / 10
    rows = make_rows(count, settings)
    sides, island = np.arange(count), None
    if survey is not None:
        island = np.unique(survey.island[patches.polygon].reshape(-1), return_inverse=True)[1].reshape(-1)
        sides = sides if survey.needs("two-sided") else sides[::2]
    known_rows = rows.empty() if known is None else known.rows
    direct, edges = light_patches(cells, count, settings, sides) if known is None else (known.direct, known.edges)
    state = Transport(patches.area, surfaces, direct, sky, rows, island=island, edges=edges)
    if known is not None:
        state.guide, state.guided = known.guide, known.guided
    taken, in_flight, rounds, sweeps, shots = np.zeros(count, bool), deque(), [], 0, 0
    settled, (inside, outside) = False, state.missing()
    try:
        while not settled:
            # Fill the pipeline with the brightest sides that have no row yet.
            while (
                len(in_flight) < LAG
                and outside > target / 2
                and shots < MOST_ROWS * count
                and len(batch := state.pick(taken))
            ):
                taken[batch] = True
                batch = costliest_first(batch, patches, settings)
                in_flight.append((batch, submit_rows(cells, batch[~known_rows.kept[batch]], settings)))
            if in_flight:
                batch, tasks = in_flight[0]
                again = state.add(batch, _with_known(known_rows, batch, cells.take(tasks)))
                in_flight.popleft()
                shots += len(batch)
                taken[again] = False  # their rows did not fit: they may be picked again when light comes back to them
                inside, outside = state.missing()
            else:
                # No bright side is left without a row: solve, and see whether that brightens the others.
                _guide(state, cells, settings, written, points, owner)
                # Either half of what may be missing, of sides with rows and of the others, is the half of the target.
                irradiance, more, inside = state.settle(target / 2)
                sweeps += more
                _, outside = state.missing()
                settled = outside <= target / 2 or shots >= MOST_ROWS * count or not len(state.pick(taken))
            rounds.append(round_of(state, rounds, inside + outside, shots, begun))
            yield rounds[-1]
    finally:
        state.rows = _brought(state.rows, in_flight, cells)  # there are some if it was broken off
    found = state.solution(state.balanced(irradiance), rounds, sweeps, target)
    return found if settings.bounces is None else replace(found, reflected=state.reflected(settings.bounces))


def _guide(state, cells, settings, written, points, owner=None):
    """Choose what rays are guided to, if that is not known, and find what its first light brings to sides with rows."""
    rows, rays = state.rows, settings.row_rays
    if state.guide is None:
        state.guide, state.guided = NOTHING, np.full_like(state.direct, np.nan)
        if isinstance(rows, RayRows):
            weight = state.area[rows.sides] * (1.0 if written is None else written[rows.sides])
            light = np.append(state.first_light.mean(axis=0), state.sky.mean(axis=0))
            direct = state.direct[:, rows.sides].mean(axis=0)
            cost = 2 * GUIDED_ROWS * rows.hits.size
            found = state.surfaces.found.mean(axis=0)
            arrived = (state.arrived / state.area)[:, rows.sides].mean(axis=0)
            parts = [weight] if owner is None else _of_objects(weight, owner[rows.sides], arrived)
            bright = np.zeros(len(state.area), bool)
            for own in parts:
                count = points * float(own.sum()) / max(float(weight.sum()), 1e-300)
                bright |= bright_sides(rows.hits, own, direct, light, found, state.area, settings.error, count, cost)
            if bright.any():
                look = rows.sides[weight > 0]
                look = look[:: max(len(look) * rays // LOOK_RAYS, 1)]
                hits = _found(cells, "rows", look, rays, "hits", 0, rays=rays, seed=settings.seed + 1)
                state.guide = make_guide(bright, hits, light, state.area)
    if len(state.guide):
        sides = rows.sides[np.isnan(state.guided[0, rows.sides])]
        cells.start(to_arrays("guide", state.guide))
        rays = max(int(GUIDED_ROWS * rays), 1)
        asked = dict(rays=rays, seed=settings.seed, light=state.first_light[:, state.guide.sides])
        if len(sides):
            state.guided[:, sides] = _found(cells, "guided", sides, 2 * rays, "guided", 1, **asked)


def _of_objects(weight, owner, light):
    """Weights (K,) of sides, an array for each object that is not too dark to be looked at, with those of its own sides.
    owner: (K,) object of each side; light: (K,) that arrives there."""
    area, power = np.bincount(owner, weight), np.bincount(owner, weight * light * light)
    seen = power * area.sum() > RARE**2 * power.sum() * area
    return [np.where(owner == number, weight, 0.0) for number in np.flatnonzero(seen)]


def _found(cells, task, sides, each, name, axis, **asked):
    """What tasks of so many rays each find for sides (K,), which must not be none, put together along an axis."""
    parts = _parts(sides, _task_size(len(sides), each, cells))
    found = cells.take([cells.submit(task, sides=part, **asked) for part in parts])
    return np.concatenate([result[name] for result in found], axis=axis)


def _brought(rows, in_flight, cells):
    """Rows with those that cells have brought of batches under way."""
    sides = {task: part for _, tasks in in_flight for task, part in tasks.items()}
    results = cells.brought(sides)
    others = [sides[task] for task in results]
    return joined_rows(rows, rows.sides, np.concatenate(others), list(results.values())) if others else rows


def light_patches(cells, count, settings, sides=None):
    """(C, 2 N) direct irradiance of all patch sides, or of some of them (K,); the others' is 0; and their Edges."""
    sides = np.arange(count) if sides is None else sides
    samples = max(int(settings.light_samples * settings.patch_samples), 1)
    size = _task_size(len(sides), samples, cells)
    tasks = [
        cells.submit("direct", sides=part, samples=samples, seed=settings.seed)
        for part in _parts(sides, size) or [sides]
    ]
    results = cells.take(tasks)
    found = np.concatenate([result["direct"] for result in results], axis=1)
    direct = np.zeros((len(found), count))
    direct[:, sides] = found
    edges = (np.concatenate([result[name] for result in results]) for name in ("partly", "source", "mean", "whole"))
    return direct, Edges(*edges)


def make_rows(count, settings):
    """Empty rows of `count` sides, of the kind that the settings ask for. Ray rows are all kept, see `rays_that_fit`."""
    if settings.rows == "rays":
        return RayRows(count, settings.row_rays, ENDLESS)
    return AnalyticRows(count, settings.memory * ROWS_SHARE)


def rays_that_fit(count, settings):
    """Rays of a row, no more than the settings ask for, so that rows of `count` sides fit into their share of the memory.

    Short rows of all sides are noisy, but the light of each is the mean of what it sees, and all of it can be balanced. Of
    long rows, some would have to be found anew whenever light came back, many times in a bright room; and what those
    sides send has another noise than what the others gather of it, which piles up as light goes back and forth.
    """
    fit = (settings.memory * ROWS_SHARE / max(count, 1) - ROW_BYTES) // HIT_BYTES
    return int(min(max(fit, LEAST_ROW), settings.row_rays))


def submit_rows(cells, sides, settings):
    """The tasks that find the rows of sides (K,): {id: sides}."""
    if settings.rows == "analytic":
        size = min(max(len(sides) // (SHARES * cells.count), 1), ANALYTIC_TASK)
        return {cells.submit("analytic", sides=part, seed=settings.seed): part for part in _parts(sides, size)}
    size, asked = _task_size(len(sides), settings.row_rays, cells), dict(rays=settings.row_rays, seed=settings.seed)
    return {cells.submit("rows", sides=part, **asked): part for part in _parts(sides, size)}


def costliest_first(sides, patches, settings):
    """Sides (K,) in the order in which a batch is dealt: those whose rows take longest first, so that no cell begins
    one when the others are done. All ray rows take the same time; an analytic row goes with the number of patches in
    front of its side, of which a sample tells."""
    if settings.rows == "rays":
        return sides
    sample = np.arange(0, len(patches), max(len(patches) // FACING, 1))
    normal = np.where(sides % 2, -1.0, 1.0)[:, None] * patches.normal[sides // 2]
    offset = np.einsum("kc->k", normal * patches.centroid[sides // 2])
    height = np.einsum("kc,sc->ks", normal, patches.centroid[sample]) - offset[:, None]
    return sides[np.argsort(-(height > 0).sum(axis=1), kind="stable")]


def _with_known(known, sides, results):
    """What tasks would have found for sides (K,), from the results for those of them that have no `known` row."""
    there = known.kept[sides]
    if not there.any():
        return results
    both = joined_rows(known, sides[there], sides[~there], results)
    return [both.of_sides(sides)]


def _task_size(count, rays, cells):
    """Sides of one task of a batch of `count` with so many rays each. What a side gets does not depend on it."""
    most, least = max(TASK_RAYS // rays, 1), max(LEAST_RAYS // rays, 1)
    return min(max(count // (SHARES * cells.count), least), most)


def _parts(items, size):
    """Items (K,) cut into parts of at most `size`."""
    return [items[k : k + size] for k in range(0, len(items), size)]
