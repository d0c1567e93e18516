"""The schedule of the paper, as it was: emitters shoot like any other patch, as many patches a round as there are
cells, each cell finds the form factors of its patch, and all wait for the slowest.

Source: Kunitani, Sato, Kondo, Shimada, "Parallel Processing of Reflex Action in Radiosity Calculation".
"""

from __future__ import annotations

from time import perf_counter

from .host import light_patches, submit_rows
from .kept import AnalyticRows, RayRows
from .records import to_arrays
from .transport import Transport, round_of


def solve_paper(patches, surfaces, sources, sky, cells, settings):
    """Find the Solution: a generator that yields a Round after every round and returns the Solution.

    sky: (C, M) exitance of the world, of each cell of its map [W/m^2]. cells: started with `kernel.scene_arrays`; a
    round is one patch for each.
    """
    begun = perf_counter()
    count, target = 2 * len(patches), settings.error / 10
    # Faces shoot the light they emit; only lamps, which are no faces, light the patches first-hand. No row is kept.
    cells.start(to_arrays("sources", sources.only(sources.origin >= -1)))
    direct, _ = light_patches(cells, count, settings)
    cells.start(to_arrays("sources", sources))
    rows = RayRows(count, settings.row_rays, 0) if settings.rows == "rays" else AnalyticRows(count, 0)
    state = Transport(patches.area, surfaces, direct, sky, rows, own=surfaces.exitance)
    rounds, shots = [], 0
    while True:
        batch = state.pick(rows.kept, cells.count)
        bound = sum(state.missing())
        if not len(batch) or bound <= target:
            break
        tasks = [task for side in batch for task in submit_rows(cells, batch[batch == side], settings)]
        state.add(batch, cells.take(tasks))
        shots += len(batch)
        rounds.append(round_of(state, rounds, sum(state.missing()), shots, begun))
        yield rounds[-1]
    return state.solution(state.arrived / state.area, rounds, 0, target)
