"""The filter of light at points: it mixes what neighbors get, and so takes noise away.

Owns the edges over which points are mixed, and the steps by which that is done. They go block by block: what a block of
neighboring points needs stays in the processor's cache, and nothing as long as all edges is made beside what is kept.
"""

from __future__ import annotations

import numpy as np

from .points import pairs
from .vectors import dot, length, rows_of, runs

STEPS = 6  # diffusion steps of the filter
COLUMNS = 8  # neighbors of a point that are summed with those of all others
NEARBY = 8  # steps along edges over which noise is compared
SPREAD = (
    2 * STEPS + NEARBY + 1
)  # neighbors of neighbors that tell what becomes of a point, the last only by their number
SMOOTH = 0.9510565162951535  # cosine of 18 degrees: the largest turn between points that the filter mixes
LANES = 4  # rows of light that are worked on together: a neighbor's lie side by side, and are fetched as one


class Filter:
    """Diffusion of light over the mesh edges between P points, by steps that bend with it.

    reach: (P,) how far light may be mixed [m]. links: (E,) bool, the edges (to neighbors, in order) along which nothing
    stands. Points whose normals differ by more than 18 degrees are not mixed. All light is (K, P), a row per quantity.

    The first few neighbors of every point are kept as columns, (W, P) int32: all points are summed together, which takes
    a sixth of the time of sums of unequal length. Those go over the edges that are left. P stands for no neighbor: behind
    the light of all points lies a place without any. Within, light is (P + 1, LANES), and what is shared of it is kept as
    often as there are lanes, which takes half the time of a row after the other.
    """

    def __init__(self, points, reach, links):
        count = len(points)
        degree = np.diff(points.neighbor_start)
        wide = 0
        while wide < COLUMNS and 4 * np.count_nonzero(degree > wide) >= count:
            wide += 1
        self._neighbor = np.full((wide, count), count, np.int32)
        self._share = np.zeros((wide, count, LANES))
        stays, members = np.ones(count), np.ones(count)
        left = [(np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros(0, np.float32))]
        for part in runs(count):
            here, there = pairs(points, np.arange(part.start, part.stop))
            edges = slice(points.neighbor_start[part.start], points.neighbor_start[part.stop])
            own = here + part.start
            joined = links[edges] & (dot(rows_of(points.normal, own), rows_of(points.normal, there)) >= SMOOTH)
            here, own, there = here[joined], own[joined], there[joined]
            distance = length(rows_of(points.position, own) - rows_of(points.position, there))
            share = np.minimum(reach[own], reach[there])
            share /= np.maximum(distance, 1e-9 * np.maximum(reach[own], 1e-300))
            share = np.minimum(1.0, share * share / 4) / np.maximum(degree[own], degree[there])
            share = share.astype(np.float32).astype(float)  # as it is kept: what goes and what stays are one

            number = np.bincount(here, minlength=part.stop - part.start)
            rank = np.arange(len(here)) - (np.cumsum(number) - number)[here]
            near = rank < wide
            self._neighbor[rank[near], own[near]] = there[near]
            self._share[rank[near], own[near]] = share[near, None]
            stays[part] -= np.bincount(here, share, len(number))
            members[part] += number
            left.append((own[~near].astype(np.int32), there[~near], share[~near].astype(np.float32)))
        self._stays, self._number = (np.repeat(x[:, None], LANES, axis=1) for x in (stays, members))
        here, self._there, self._weight = (np.concatenate(parts) for parts in zip(*left))
        self._start = np.flatnonzero(np.append(True, here[1:] != here[:-1])) if len(here) else here
        self._joined = here[self._start]

    def smooth(self, light):
        """Light with its noise diffused. What the diffusion F does to the light itself is undone in part: 2 F - F F."""
        return self._by_rows(light, self._smoothed)

    def local_mean(self, values):
        """Values averaged with those of their neighbors, and theirs."""
        return self._by_rows(values, self._averaged)

    def _by_rows(self, light, change):
        """Rows of light changed, LANES at a time."""
        result = np.empty(light.shape)
        for k in range(0, len(light), LANES):
            part = light[k : k + LANES]
            lanes = np.zeros((light.shape[1] + 1, LANES))
            lanes[:-1, : len(part)] = part.T
            result[k : k + LANES] = change(lanes)[:-1, : len(part)].T
        return result

    def _smoothed(self, light):
        once = self._diffused(light)
        again = self._diffused(once)
        once *= 2
        once -= again
        return once

    def _averaged(self, values):
        for _ in range(NEARBY):
            values = self._summed(values, None)
            values[:-1] /= self._number
        return values

    def _diffused(self, light):
        for _ in range(STEPS):
            before, light = light, self._summed(light, self._share)
        # Half of the last step: a pattern that changes sign from point to point, as on a chessboard, would turn round in
        # every whole step and never fade.
        light += before
        light /= 2
        return light

    def _summed(self, light, share):
        """What stays of light (P + 1, LANES) and what neighbors give; share: (W, P, LANES) of theirs. None: all of all."""
        result = np.zeros_like(light)
        for part in runs(len(light) - 1):
            own = result[part]
            theirs = np.empty_like(own)
            np.multiply(light[part], 1.0 if share is None else self._stays[part], out=own)
            for k, neighbor in enumerate(self._neighbor[:, part]):
                np.take(light, neighbor, axis=0, out=theirs, mode="clip")
                if share is not None:
                    theirs *= share[k, part]
                own += theirs
        if len(self._start):
            far = np.take(light, self._there, axis=0)
            if share is not None:
                far *= self._weight[:, None]
            result[self._joined] += np.add.reduceat(far, self._start, axis=0)
        return result
