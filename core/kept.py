"""Form-factor rows that the host keeps, and what light does through them.

`RayRows` and `AnalyticRows` are of one interface: `add` and `joined_rows` keep what tasks have found, `shoot` sends power
along the rows, `gather` brings light back over them. Sides without a row, and rows that do not fit into the memory, are the
caller's matter.
"""

from __future__ import annotations

import numpy as np

from .sky import solid_angles
from .vectors import counted, runs

AT_ONCE = 1 << 16  # rays of the rows that a solver step gathers over at a time: their light stays in the cache
ENDLESS = 1 << 62  # bytes: as much memory as it takes
HIT_BYTES, ROW_BYTES = 4, 8  # that a ray row takes for each of its rays, and for itself


class RayRows:
    """Form-factor rows that were kept: hits (K, n) of sides (K,), in the order they came; -1 is a ray that escaped.

    Rows are kept while they fit into `memory` bytes.
    """

    def __init__(self, count, rays, memory):
        self.count, self.rays = count, rays
        self.most = memory // (HIT_BYTES * rays + ROW_BYTES)
        self.sides = np.zeros(0, np.int64)
        self.hits = np.zeros((0, rays), np.int32)
        self.kept = np.zeros(count, bool)

    def add(self, sides, results):
        """Keep the rows of sides (K,), given by the results of their tasks; returns those that did not fit, as rows."""
        hits = np.concatenate([result["hits"] for result in results])
        fits = int(min(max(self.most - len(self.sides), 0), len(sides)))
        self._append(sides[:fits], hits[:fits])
        others = RayRows(self.count, self.rays, np.inf if fits < len(sides) else 0)
        others._append(sides[fits:], hits[fits:])
        return others

    def empty(self):
        """Rows of the same kind, none so far, that are kept in any number."""
        return RayRows(self.count, self.rays, ENDLESS)

    def of_sides(self, sides):
        """What a task would find for sides (K,) whose rows are kept."""
        return {"hits": self.hits[_places(self.sides, self.count)[sides]]}

    def _append(self, sides, hits):
        self.sides, self.hits = np.concatenate([self.sides, sides]), np.concatenate([self.hits, hits])
        self.kept[sides] = True

    def shoot(self, power, start=0):
        """Power (C, 2 N) that arrives on all sides and (C,) that escapes, when rows from `start` on send power (C, K)."""
        target = self.hits[start:].reshape(-1).astype(np.intp)
        target += 1  # escaped rays are counted first, wherever to
        np.maximum(target, 0, out=target)
        each = np.empty(self.hits[start:].shape)
        arrived = np.empty((len(power), self.count + 1))
        for channel, result in zip(power, arrived):
            each[:] = (channel / self.rays)[:, None]
            result[:] = np.bincount(target, each.reshape(-1), self.count + 1)
        return arrived[:, 1:], arrived[:, 0]

    def gather(self, light, beyond):
        """(C, K) irradiance of the rows' sides, from light (C, 2 N) of the sides they hit and (C, M) of the sky's cells."""
        result = np.empty((len(light), len(self.sides)))
        for c, part, seen in self._seen(np.column_stack([light, beyond])):
            np.einsum("kn->k", seen, out=result[c, part])
        return result / self.rays

    def among(self, light, beyond):
        """What rays from the rows' sides to one another bring of light (C, 2 N): the mean of all of a row's rays (C, K), the
        mean square of all channels together (K,), and the share of rays that meet such a side (K,). beyond: number of the sky's
        cells."""
        light = np.concatenate([light, light.sum(axis=0, keepdims=True), np.ones((1, self.count))]) * self.kept
        mean, square = np.empty((len(light), len(self.sides))), np.empty(len(self.sides))
        for c, part, seen in self._seen(np.column_stack([light, np.zeros((len(light), beyond))])):
            np.einsum("kn->k", seen, out=mean[c, part])
            if c == len(light) - 2:
                np.einsum("kn,kn->k", seen, seen, out=square[part])
        mean /= self.rays
        return mean[:-2], square / self.rays, mean[-1]

    def _seen(self, light):
        """Yield, channel by channel for some rows at a time, the channel's number, the rows, a slice, and the light (K, n) that
        their rays meet, of light (C, 2 N + M)."""
        for part in runs(len(self.sides), self.rays, AT_ONCE):
            hits = self.hits[part].reshape(-1).astype(np.intp)  # once for all channels
            for c, channel in enumerate(light):
                yield c, part, np.take(channel, hits, mode="wrap").reshape(-1, self.rays)

    def escaped(self, start=0):
        """(K,) share of the light that escapes, of the rows from `start` on."""
        return (self.hits[start:] < 0).sum(axis=1) / self.rays

    def sky_light(self, sky, start=0):
        """(C, K) irradiance that the sky's cells (C, M) give the sides of the rows from `start` on."""
        hits = self.hits[start:].reshape(-1)
        cell = np.where(hits < 0, hits, -1)  # wrapping counts down step by step: only ever one step
        seen = (np.where(hits < 0, np.take(cells, cell, mode="wrap"), 0.0).reshape(-1, self.rays) for cells in sky)
        return np.stack([np.einsum("kn->k", channel) for channel in seen]) / self.rays

    def links(self, island, start=0):
        """Pairs (L,), (L,) of islands (2 N,) that rows from `start` on lead from and to."""
        here = np.repeat(island[self.sides[start:]], self.rays)
        hits = self.hits[start:].reshape(-1)
        there = np.take(island, hits, mode="wrap")
        other = (here != there) & (hits >= 0)
        return here[other], there[other]


class AnalyticRows:
    """Rows of form factors: side k sends share (Z,) of its light to target (Z,), from start[k] to start[k + 1]; the rest
    escapes. The same interface as `RayRows`."""

    def __init__(self, count, memory):
        self.count, self.memory = count, memory
        self.sides = np.zeros(0, np.int64)
        self.start = np.zeros(1, np.int64)
        self.target, self.share = np.zeros(0, np.int32), np.zeros(0)
        self.kept = np.zeros(count, bool)

    def add(self, sides, results):
        """Keep the rows of sides (K,), given by the results of their tasks; returns those that did not fit, as rows."""
        size = np.concatenate([np.diff(result["start"]) for result in results])
        target = np.concatenate([result["target"] for result in results])
        share = np.concatenate([result["share"] for result in results])
        fits = int(np.searchsorted(12 * (len(self.target) + np.cumsum(size)), self.memory, side="right"))
        cut = int(size[:fits].sum())
        self._append(sides[:fits], size[:fits], target[:cut], share[:cut])
        others = AnalyticRows(self.count, np.inf)
        others._append(sides[fits:], size[fits:], target[cut:], share[cut:])
        return others

    def empty(self):
        return AnalyticRows(self.count, ENDLESS)

    def of_sides(self, sides):
        row = _places(self.sides, self.count)[sides]
        owner, number = counted(np.diff(self.start)[row])
        entry = self.start[row][owner] + number
        start = np.append(0, np.cumsum(np.diff(self.start)[row]))
        return {"start": start, "target": self.target[entry], "share": self.share[entry]}

    def _append(self, sides, size, target, share):
        self.sides = np.concatenate([self.sides, sides])
        self.start = np.concatenate([self.start, self.start[-1] + np.cumsum(size)])
        self.target, self.share = np.concatenate([self.target, target]), np.concatenate([self.share, share])
        self.kept[sides] = True

    def shoot(self, power, start=0):
        first = self.start[start]
        owner = np.repeat(np.arange(len(self.sides) - start), np.diff(self.start[start:]))
        sent = power[:, owner] * self.share[first:]
        arrived = np.stack([np.bincount(self.target[first:], channel, self.count) for channel in sent])
        return arrived, power.sum(axis=1) - arrived.sum(axis=1)

    def gather(self, light, beyond):
        filled = np.flatnonzero(np.diff(self.start))
        seen = np.zeros((len(light), len(self.sides)))
        if len(filled):
            for channel, result in zip(light, seen):
                result[filled] = np.add.reduceat(channel[self.target] * self.share, self.start[filled])
        return seen + self.sky_light(beyond)

    def escaped(self, start=0):
        owner = np.repeat(np.arange(len(self.sides) - start), np.diff(self.start[start:]))
        return 1.0 - np.bincount(owner, self.share[self.start[start] :], len(self.sides) - start)

    def sky_light(self, sky, start=0):  # the rows do not know where to: the sky's mean
        sky = np.reshape(sky, (len(sky), -1))
        angle = solid_angles(int(np.sqrt(sky.shape[1])))
        return self.escaped(start) * np.einsum("cm,m->c", sky, angle)[:, None] / angle.sum()

    def links(self, island, start=0):
        here = np.repeat(island[self.sides[start:]], np.diff(self.start[start:]))
        there = island[self.target[self.start[start] :]]
        other = here != there
        return here[other], there[other]


def joined_rows(known, kept, others, results):
    """Rows with those of sides `kept` (K,) of `known` rows and those of others (L,), given by the results of their
    tasks."""
    both = known.empty()
    both.add(kept, [known.of_sides(kept)])
    if len(others):
        both.add(others, results)
    return both


def _places(sides, count):
    """(count,) where each side is among sides (K,)."""
    place = np.zeros(count, np.int64)
    place[sides] = np.arange(len(sides))
    return place
