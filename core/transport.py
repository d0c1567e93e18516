"""The state of phase 1: where light is and where it goes, and the solve over the rows that were kept.

`Transport` owns radiosity and unshot power (float64) and keeps them in balance: emitted = absorbed + escaped + unshot.
What may still be missing has a certified bound at any time. It asks no cell for anything.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from time import perf_counter

import numpy as np

from .anew import Edges
from .graphs import components
from .guide import Guide
from .kept import AnalyticRows, RayRows
from .sky import solid_angles
from .vectors import ratio

BATCH = 4096  # sides of a batch at least, and a share of those that wait
BATCH_SHARE = 0.5
KRYLOV = 8  # directions that the solve combines at a time
CERTAIN = 3.0  # standard errors that power gathered and power sent may differ by, where they are of the same sides
LEAST_COVERAGE = 1e-3  # of a patch, which keeps its irradiance finite
SWEEPS = 2000  # of the solve, at most


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
        self.gathered = np.full_like(direct, np.nan)  # irradiance that the last solve has found

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
        # What has been shot has the noise of all rows, and so has a start from it: from where the last solve ended, the next one
        # takes two thirds of the steps (sun through a window: 36 in three solves, not 50).
        irradiance = np.where(np.isnan(self.gathered), self.arrived / self.area, self.gathered)
        sweeps, bound = 0, 0.0
        if len(sides):
            arriving, first = irradiance.copy(), self.direct[:, sides]
            rest = surfaces.found
            if self.guide is not None and len(self.guide):  # whose first light guided rays have found
                first, rest = first + self.guided[:, sides], rest.copy()
                rest[:, self.guide.sides] -= self.first_light[:, self.guide.sides]

            def update(values):
                for channel, new in zip(arriving, values):  # in a third of the time of all at once
                    channel[sides] = new
                return first + rows.gather(rest + surfaces.send(arriving), self.sky)

            start, largest = irradiance[:, sides], surfaces.returned[:, sides]
            values, sweeps, bound = fixed_point(update, start, largest, self.area[sides], target, self.island[sides])
            # Where next to nothing arrives, what is still in the way of the bound may be less than nothing.
            irradiance[:, sides] = self.gathered[:, sides] = np.maximum(values, 0.0)
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
        as they send: by a factor for each channel and island.

        What a side gathers has the noise of its row, and where nearly all light is reflected it piles up: if sides get a
        thousandth too much of one another, and send on 0.9 of it, all light is a hundredth too bright, and whoever gathers
        over such light finds a thousandth of it wrong. What they send has no such noise, as all arrives that does not escape.
        With p what they get, q what they send, and s the part of it that they have not from one another, f in
        f p = s + f (q - s) is the factor. Where much of what they send escapes, the little that arrives is noisy too: p is then
        moved toward q only as far as makes their mean the least noisy. Where p and q differ by more than the noise explains they are not of the same
        sides, as where surfaces lie on one another, and tell nothing.
        """
        rows, sides, surfaces = self.rows, self.rows.sides, self.surfaces
        if not (isinstance(rows, RayRows) and len(sides)):
            return irradiance
        area, island = self.area[sides], self.island[sides]
        light = surfaces.found + surfaces.send(irradiance)
        got, square, share = rows.among(light, self.sky.shape[1])
        sent = light[:, sides]
        # Of a ray: the variance of what it brings, of what it sends, and of both with one another. All channels are judged as
        # one: of many groups of light, each by itself, one would often seem not to be of the same sides.
        bring, send = got.sum(axis=0), sent.sum(axis=0)
        noises = square - bring**2, send * send * share * (1 - share), send * bring * (1 - share)
        if self.guide is not None and len(self.guide):  # whose first light guided rays have found
            bright = np.zeros_like(light)
            bright[:, self.guide.sides] = self.first_light[:, self.guide.sides]
            got = got + self.guided[:, sides] - rows.among(bright, self.sky.shape[1])[0]
        before = irradiance.copy()
        before[:, sides] -= got
        first = (surfaces.found + surfaces.send(before))[:, sides]
        p, q, s = (
            np.stack([np.bincount(island, area * channel) for channel in values])
            for values in (got, share * sent, share * first)
        )
        brought, away, both = (np.bincount(island, area**2 * noise) for noise in noises)
        variance = np.maximum(brought + away - 2 * both, 0.0)
        certain = (p - q).sum(axis=0) ** 2 <= CERTAIN**2 * variance / rows.rays
        trust = np.clip(ratio(brought - both, variance), 0.0, 1.0)
        factor = np.where(certain, ratio(s, s + trust * (p - q)), 1.0)
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
        if not self.island.any():  # in a fifth of the time
            return power.sum(axis=1, keepdims=True)
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
    if not island.any():  # in a fifth of the time
        return best.reduce(values, axis=1, keepdims=True, initial=0.0)
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
            column.append(float(np.einsum("ck,ck->", b, vector)))
            vector = vector - column[-1] * b
        length = float(np.sqrt(np.einsum("ck,ck->", vector, vector)))
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
