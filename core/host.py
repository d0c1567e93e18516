"""Phase 1, the host: the radiosity of all patch sides, by rounds of shooting and a solve over the rows that were kept.

The host alone owns radiosity and unshot power (float64); cells only find where light goes. A round: the host picks the
sides of highest unshot power, cells trace their form-factor rows, the host adds what each sends, in the order of the
picks. Rows are kept: light that comes back to a side is shot again through its row at no cost in rays, and at the end
every side gathers over its own row until nothing changes.
Source: Kunitani, Sato, Kondo, Shimada, "Parallel Processing of Reflex Action in Radiosity Calculation".
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from time import perf_counter

import numpy as np

from .accuracy import RARE
from .anew import Edges
from .graphs import components
from .guide import LOOK_RAYS, NOTHING, Guide, bright_sides, make_guide
from .records import to_arrays
from .sky import solid_angles
from .vectors import counted, ratio, runs

TASK_RAYS = 1 << 15  # of one task at most: some 10 ms
LEAST_RAYS = 1 << 13  # of one task at least: less is not worth a message and the calls that any task takes
ANALYTIC_TASK = 4  # analytic rows of one task at most
SHARES = 4  # tasks of a batch that a cell gets at least, if they are not too small: no cell waits long for another
ROWS_SHARE = 0.25  # of the memory that a bake may use, for kept rows
LAG = 3  # batches in flight; a batch is picked from the state that so many batches before it left
BATCH = 4096  # sides of a batch at least, and a share of those that wait
BATCH_SHARE = 0.5
FACING = 256  # patches that tell how many are in front of a side
AT_ONCE = 1 << 16  # rays of the rows that a solver step gathers over at a time: their light stays in the cache
KRYLOV = 8  # directions that the solve combines at a time
CERTAIN = 3.0  # standard errors that power gathered and power sent may differ by, where they are of the same sides
LEAST_COVERAGE = 1e-3  # of a patch, which keeps its irradiance finite
SWEEPS = 2000  # of the solve, at most
ENDLESS = 1 << 62  # bytes: as much memory as it takes
GUIDED_ROWS = 0.25  # rays of each kind for the first light of bright sides, for each ray of a row: more take off little
MOST_ROWS = 30  # rows that are found of each side in the mean, where memory holds only few of them; then it ends


@dataclass(frozen=True)
class Round:
    """Where the solve stands: number of the round, unshot power and bound on the power still missing from the result,
    both as shares of the power emitted; rows found so far (shots), and seconds since the start. solution(): the Solution
    as it stands, as long as the solve has not gone on."""

    number: int
    unshot: float
    bound: float
    shots: int
    seconds: float
    solution: Callable = field(default=None, repr=False, compare=False)


def round_of(state, rounds, bound, shots, begun):
    """The Round after those of `rounds`, of a Transport."""
    unshot = float(np.abs(state.unshot.sum()) / max(state.emitted.sum(), 1e-300))
    found = Round(len(rounds) + 1, unshot, float(bound), shots, perf_counter() - begun)
    return replace(found, solution=lambda: state.solution(state.arrived / state.area, (*rounds, found), 0, 0.0))


@dataclass(frozen=True)
class Solution:
    """What phase 1 found, (C, 2 N) per channel and side, in W/m^2.

    reflected: light sent back or through, what gather rays read. irradiance: light arriving; direct: the part of it
    from sampled sources. rounds: tuple of Round. sweeps: over all rows. bound: certified bound on the largest error of
    `irradiance`, as a share of its mean. energy: {name: W}, sums of the channels. edges: sides that a source lights in
    part. rows: those that were kept. guide: sides that rays are guided to, None as long as that is not known, and
    guided: (C, 2 N) irradiance by their first light.
    """

    reflected: np.ndarray
    irradiance: np.ndarray
    direct: np.ndarray
    rounds: tuple
    sweeps: int
    bound: float
    converged: bool
    energy: dict
    edges: Edges | None = None
    rows: RayRows | AnalyticRows | None = field(default=None, repr=False)
    guide: Guide | None = None
    guided: np.ndarray | None = field(default=None, repr=False)


class RayRows:
    """Form-factor rows that were kept: hits (K, n) of sides (K,), in the order they came; -1 is a ray that escaped.

    Rows are kept while they fit into `memory` bytes.
    """

    def __init__(self, count, rays, memory):
        self.count, self.rays = count, rays
        self.most = memory // (4 * rays + 8)
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


class Transport:
    """Where light is and where it goes: power [W] per channel and side (C, 2 N), in balance after every step.

    Power that is emitted (by faces that rays find) or arrives first-hand is `emitted`. What arrives on a side is
    partly absorbed; the rest is `unshot` until the side's row sends it on to other sides or out of the scene.
    emitted = absorbed + escaped + unshot, to rounding, at any time.
    island: (2 N,) number of the part of the scene that each side belongs to; a row that leads from one to another joins
    the two. What is still missing is judged in each of them by the light that is there.
    """

    def __init__(self, area, surfaces, direct, sky, rows, own=None, island=None, edges=None):
        self.area = np.repeat(area, 2)
        if surfaces.coverage is not None:  # of what rays may pass, the part that light falls on
            self.area = self.area * np.maximum(surfaces.coverage, LEAST_COVERAGE)
        self.surfaces, self.sky = surfaces, np.reshape(np.asarray(sky, float), (len(sky), -1))
        self.direct, self.edges = direct, edges
        self.rows = rows
        self.own = self.area * (surfaces.found if own is None else own)
        self.first = self.area * direct  # power that arrived first-hand
        self.arrived = self.first.copy()
        self.unshot = self.own + surfaces.send(self.arrived)
        self.escaped = np.zeros(len(direct))
        # Shot and arrived through rows that were not kept.
        self.loose_shot, self.loose_arrived, self.loose_escaped = np.zeros_like(direct), np.zeros_like(direct), 0.0
        # A side without a row may see all of the sky, for all we know: power it would send on then.
        angle = solid_angles(int(np.sqrt(self.sky.shape[1])))
        most = np.minimum(self.sky.max(axis=1), np.einsum("cm,m->c", self.sky, angle) / np.pi)[:, None]
        self.ahead = surfaces.send(self.area * most * np.ones_like(direct))
        self.island = np.zeros(direct.shape[1], np.int64) if island is None else np.asarray(island, np.int64)
        self.guide = self.guided = None

    @cached_property
    def first_light(self):
        """(C, 2 N) light that sides send before any of it has gone back and forth [W/m^2]."""
        return self.surfaces.found + self.surfaces.send(self.direct)

    @property
    def emitted(self):
        """(C,) power emitted so far."""
        return self.own.sum(axis=1) + self.first.sum(axis=1)

    @property
    def absorbed(self):
        """(C,) power absorbed so far."""
        return (self.arrived * (1.0 - self.surfaces.returned)).sum(axis=1)

    def pick(self, taken, count=None):
        """The next batch: the `count` sides of highest unshot power without a row and not `taken` (2 N,) bool, ties by
        id; count None takes a share of those that wait."""
        strength = np.where(self.rows.kept | taken, 0.0, (self.unshot + self.ahead).sum(axis=0))
        if self.island.any():  # the brightest of a dim island are as urgent as those of a bright one
            strength /= self._there()[self.island]
        waiting = np.flatnonzero(strength > 0)
        count = count or max(BATCH, int(BATCH_SHARE * len(waiting)))
        return waiting[np.argsort(-strength[waiting], kind="stable")[:count]]

    def add(self, sides, results):
        """Keep the rows of a batch as far as they fit; its sides take in the sky that they see, and shoot."""
        start = len(self.rows.sides)
        others = self.rows.add(sides, results)
        for rows, first in ((self.rows, start), (others, 0)):
            part = rows.sides[first:]
            if not len(part):
                continue
            if self.sky.any():
                seen = np.zeros_like(self.arrived)
                waits = self.ahead[:, part].any(axis=0)
                seen[:, part] = np.where(waits, self.area[part] * rows.sky_light(self.sky, first), 0.0)
                self.first += seen
                self._receive(seen)
                self.ahead[:, part] = 0.0
            if self.island.any():
                here, there = rows.links(self.island, first)
                self.island = components(here, there, int(self.island.max()) + 1)[self.island]
            power = self.unshot[:, part]
            self.unshot[:, part] = 0.0
            arrived, escaped = rows.shoot(power, first)
            self.escaped = self.escaped + escaped
            self._receive(arrived)
            if rows is others:
                self.loose_shot[:, part] += power
                self.loose_arrived += arrived
                self.loose_escaped = self.loose_escaped + escaped
        return others.sides

    def settle(self, target):
        """Solve for the light that goes back and forth between sides with rows: each gathers over its own row, until
        the certified bound is below `target`. What has been shot is then what the solution says, and the sides without
        rows get their share of it. Returns irradiance (C, 2 N), sweeps and bound.
        """
        rows, sides, surfaces = self.rows, self.rows.sides, self.surfaces
        irradiance = self.arrived / self.area
        sweeps, bound = 0, 0.0
        if len(sides):
            arriving, first = irradiance.copy(), self.direct[:, sides]
            rest = surfaces.found
            if self.guide is not None and len(self.guide):  # whose first light guided rays have found
                first, rest = first + self.guided[:, sides], rest.copy()
                rest[:, self.guide.sides] -= self.first_light[:, self.guide.sides]

            def update(values):
                arriving[:, sides] = values
                return first + rows.gather(rest + surfaces.send(arriving), self.sky)

            start, largest = irradiance[:, sides], surfaces.returned[:, sides]
            values, sweeps, bound = fixed_point(update, start, largest, self.area[sides], target, self.island[sides])
            irradiance[:, sides] = values
        return self._shot(irradiance), sweeps, bound

    def _shot(self, irradiance):
        """Let what has been shot be what an irradiance (C, 2 N) of the sides with rows says; returns it with that of the
        others, which get their share."""
        rows, sides, surfaces = self.rows, self.rows.sides, self.surfaces
        sent = self.area * (surfaces.found + surfaces.send(irradiance))
        arrived, escaped = rows.shoot(sent[:, sides])
        self.escaped = self.loose_escaped + escaped
        self.arrived = self.first + self.loose_arrived + arrived
        self.unshot = self.own + surfaces.send(self.arrived) - self.loose_shot
        self.unshot[:, sides] -= sent[:, sides]
        irradiance[:, ~rows.kept] = (self.arrived / self.area)[:, ~rows.kept]
        return irradiance

    def balanced(self, irradiance):
        """The irradiance (C, 2 N) that `settle` has found, with what sides with rows get of one another made to be as much
        as they send: by a factor for each channel, in islands where most light goes round, sent again to be sent again.

        What a side gathers has the noise of its row, and where nearly all light is reflected it piles up: if sides get a
        thousandth too much of one another, and send on 0.9 of it, all light is a hundredth too bright, and whoever gathers
        over such light finds a thousandth of it wrong. What they send has no such noise, as all arrives that does not escape.
        With p what they get, q what they send, and s the part of it that they have not from one another, f in
        f p = s + f (q - s) is the factor. Where p and q differ by more than the noise explains they are not of the same
        sides, as where surfaces lie on one another, and tell nothing.
        """
        rows, sides, surfaces = self.rows, self.rows.sides, self.surfaces
        if not (isinstance(rows, RayRows) and len(sides)):
            return irradiance
        area, island = self.area[sides], self.island[sides]
        light = surfaces.found + surfaces.send(irradiance)
        got, square, share = rows.among(light, self.sky.shape[1])
        sent = light[:, sides]
        # Of a ray: the variance of what it brings less what it sends. All channels are judged as one: of many groups of light,
        # each by itself, one would often seem not to be of the same sides.
        bring, send = got.sum(axis=0), sent.sum(axis=0)
        noise = square - 2 * send * bring + send * send * share - (bring - send * share) ** 2
        if self.guide is not None and len(self.guide):  # whose first light guided rays have found
            bright = np.zeros_like(light)
            bright[:, self.guide.sides] = self.first_light[:, self.guide.sides]
            got = got + self.guided[:, sides] - rows.among(bright, self.sky.shape[1])[0]
        before = irradiance.copy()
        before[:, sides] -= got
        first = (surfaces.found + surfaces.send(before))[:, sides]
        whole, p, q, s = (
            np.stack([np.bincount(island, area * channel) for channel in values])
            for values in (sent, got, share * sent, share * first)
        )
        variance = np.bincount(island, area**2 * noise) / rows.rays
        certain = (p - q).sum(axis=0) ** 2 <= CERTAIN**2 * variance
        chosen = certain & (2 * (q - s).sum(axis=0) > whole.sum(axis=0))
        factor = np.where(chosen, ratio(s, p - (q - s)), 1.0)
        irradiance = irradiance.copy()
        irradiance[:, sides] += (factor[:, island] - 1) * got
        return self._shot(irradiance)

    def reflected(self, bounces):
        """(C, 2 N) light that sides with rows send back or through, of light that was sent so less than `bounces` times
        before."""
        surfaces, sides = self.surfaces, self.rows.sides
        irradiance, reflected = self.direct.copy(), np.zeros_like(self.direct)
        for _ in range(bounces):
            irradiance[:, sides] = self.direct[:, sides] + self.rows.gather(surfaces.found + reflected, self.sky)
            reflected = surfaces.send(irradiance)
        return reflected

    def missing(self):
        """Bounds on the power that has not arrived yet, as shares of the power emitted, in the island where most is
        missing: what sides with rows have not shot, and sides without. Light u still to be shot adds at most
        g / (1 - g) u, g the largest share that a side sends on (power norm: what a row sends sums to at most 1)."""
        returned, unshot = self.surfaces.returned, np.abs(self.unshot)
        shared = self._sums(unshot)
        inside = self._sums(np.where(self.rows.kept, unshot, 0.0))
        ahead = self._sums(self.ahead)
        g = _over_parts(np.maximum, returned, self.island)
        there = self._there()
        outside = (shared - inside) * g / (1 - g) + ahead / (1 - g)
        inside = (inside * g / (1 - g)).sum(axis=0) / there
        return float(inside.max(initial=0.0)), float(np.maximum(outside.sum(axis=0) / there, 0.0).max(initial=0.0))

    def _sums(self, power):
        """(C, I) sums of power (C, 2 N) over each island."""
        return np.stack([np.bincount(self.island, channel) for channel in power])

    def _there(self):
        """(I,) power emitted in each island; where there is none, in all."""
        power = self._sums(self.own + self.first + self.ahead).sum(axis=0)
        return np.where(power > 0, power, max(power.sum(), 1e-300))

    def solution(self, irradiance, rounds, sweeps, target):
        """The Solution that an irradiance (C, 2 N) is, after some rounds; it has converged if the bound is below target."""
        bound = rounds[-1].bound if rounds else float(sum(self.missing()))
        return Solution(
            reflected=self.surfaces.send(irradiance),
            irradiance=irradiance,
            direct=self.direct,
            rounds=tuple(rounds),
            sweeps=sweeps,
            bound=bound,
            converged=bound <= target,
            energy=self.energy(),
            edges=self.edges,
            rows=self.rows,
            guide=self.guide,
            guided=self.guided,
        )

    def energy(self):
        """{name: W} where the power has gone, sums of red, green and blue (one channel stands for all three)."""
        return {
            "emitted_w": float(self.emitted.mean() * 3),
            "absorbed_w": float(self.absorbed.mean() * 3),
            "escaped_w": float(np.mean(self.escaped) * 3),
            "unshot_w": float(self.unshot.sum(axis=1).mean() * 3),
        }

    def _receive(self, power):
        self.arrived += power
        self.unshot += self.surfaces.send(power)


def fixed_point(update, values, returned, weight, target, island=None):
    """Solve values = update(values) for an affine update with row sums of at most the largest of `returned` (C, K) < 1.

    values: (C, K) start, weight: (K,). island: (K,) number of the part that each value belongs to; no part depends on
    another. Returns values, the number of updates, and the certified bound on the largest error in any part as a share
    of the part's weighted mean: if an update changes nothing by more than r, nothing is off by more than g / (1 - g) r,
    g the part's largest row sum. Updates alone converge by g a step; in between, the last few changes are combined so
    that the residual is least (GMRES, Saad and Schultz 1986), which cannot diverge.
    """
    island = np.zeros(values.shape[1], np.int64) if island is None else np.unique(island, return_inverse=True)[1]
    largest = _over_parts(np.maximum, returned, island)
    gain = largest / (1 - largest)
    size = np.bincount(island, weight)
    count, scale = 0, np.ones_like(values)

    def scaled_update(x):
        return update(scale * x) / scale

    while True:
        updated = update(values)
        count += 1
        mean = np.stack([np.bincount(island, weight * np.abs(channel)) for channel in updated]) / size
        error = gain * _over_parts(np.maximum, np.abs(updated - values), island)
        bound = float(ratio(error, mean).max())
        if bound <= target or count >= SWEEPS:
            return updated, count, bound
        if count == 1:  # every channel and part counts by its own light, however dim it is beside the others
            scale[:] = np.where(mean > 0, mean, 1.0)[:, island]
        goal = target / max(bound, 1e-300)
        step, used = _least_residual(scaled_update, values / scale, updated / scale, goal)
        values = values + scale * step
        count += used


def _over_parts(best, values, island):
    """(C, I) the `best` (np.maximum or the like) of values (C, K) >= 0 over each part."""
    result = np.zeros((len(values), int(island.max(initial=0)) + 1))
    for part, channel in zip(result, values):
        best.at(part, island, channel)
    return result


def _least_residual(update, values, updated, goal):
    """The step (C, K) from `values` in a Krylov space after which an update, which turns them into `updated`, would
    change least, and the number of updates used. Stops early when the change has shrunk to `goal` of itself."""
    residual = updated - values
    norm = first = float(np.sqrt((residual * residual).sum()))
    if norm == 0.0:
        return residual, 0
    basis, triangle, turns, right = [residual / norm], [], [], [norm]
    while len(triangle) < KRYLOV and abs(right[-1]) > goal * first:
        vector = basis[-1] - (update(values + basis[-1]) - updated)
        column = []
        for b in basis:
            column.append(float((b * vector).sum()))
            vector = vector - column[-1] * b
        length = float(np.sqrt((vector * vector).sum()))
        # Givens rotations keep the small least-squares problem triangular.
        for k, (c, s) in enumerate(turns):
            column[k], column[k + 1] = c * column[k] + s * column[k + 1], c * column[k + 1] - s * column[k]
        radius = float(np.hypot(column[-1], length))
        if radius == 0.0:
            break
        c, s = column[-1] / radius, length / radius
        turns.append((c, s))
        column[-1] = radius
        triangle.append(column)
        right[-1:] = [c * right[-1], -s * right[-1]]
        if length <= 1e-14 * norm:
            break
        basis.append(vector / length)
    share = []
    for k in reversed(range(len(triangle))):
        known = sum(triangle[k + 1 + i][k] * y for i, y in enumerate(share))
        share.insert(0, (right[k] - known) / triangle[k][k])
    return sum(y * b for y, b in zip(share, basis)) + np.zeros_like(residual), len(triangle)


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
    settled = False
    try:
        while not settled:
            # Fill the pipeline with the brightest sides that have no row yet.
            inside, outside = state.missing()
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
    """Empty rows of `count` sides, of the kind that the settings ask for."""
    memory = settings.memory * ROWS_SHARE
    return RayRows(count, settings.row_rays, memory) if settings.rows == "rays" else AnalyticRows(count, memory)


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


def _task_size(count, rays, cells):
    """Sides of one task of a batch of `count` with so many rays each. What a side gets does not depend on it."""
    most, least = max(TASK_RAYS // rays, 1), max(LEAST_RAYS // rays, 1)
    return min(max(count // (SHARES * cells.count), least), most)


def _parts(items, size):
    """Items (K,) cut into parts of at most `size`."""
    return [items[k : k + size] for k in range(0, len(items), size)]
