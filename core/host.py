"""Phase 1, the host: the radiosity of all patch sides, by rounds of shooting and a solve over the rows that were kept.

The host alone owns radiosity and unshot power (float64); cells only find where light goes. A round: the host picks the
sides of highest unshot power, cells trace their form-factor rows, the host adds what each sends, in the order of the
picks. Rows are kept: light that comes back to a side is shot again through its row at no cost in rays, and at the end
every side gathers over its own row until nothing changes.
Source: Kunitani, Sato, Kondo, Shimada, "Parallel Processing of Reflex Action in Radiosity Calculation".
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from time import perf_counter

import numpy as np

TASK_RAYS = 1 << 16  # of one task: some 10 to 30 ms
LAG = 3  # batches in flight; a batch is picked from the state that so many batches before it left
BATCH = 4096  # sides of a batch at least, and a share of those that wait
BATCH_SHARE = 0.25
SWEEPS = 20_000  # of the final solve, at most


@dataclass(frozen=True)
class Round:
    """Where the solve stands: number of the round, unshot power and bound on the power still missing from the result,
    both as shares of the power emitted, rows kept and rays cast so far, seconds since the start."""

    number: int
    unshot: float
    bound: float
    rows: int
    rays: int
    seconds: float


@dataclass(frozen=True)
class Solution:
    """What phase 1 found, per side (2 N, 3), RGB in W/m^2.

    reflected: light sent back or through, what gather rays read. irradiance: light arriving. rounds: tuple of Round.
    bound: certified bound on the largest error of `irradiance`, as a share of its mean. energy: {name: W}, sums of RGB.
    """

    reflected: np.ndarray
    irradiance: np.ndarray
    rounds: tuple
    sweeps: int
    bound: float
    converged: bool
    energy: dict


class Rows:
    """Form-factor rows that were kept: hits (K, n) of sides (K,), in the order they came; -1 is a ray that escaped."""

    def __init__(self, count, rays):
        self.rays = rays
        self.sides = np.zeros(0, np.int64)
        self.hits = np.zeros((0, rays), np.int32)
        self.kept = np.zeros(count, bool)

    def add(self, sides, hits):
        self.sides, self.hits = np.concatenate([self.sides, sides]), np.concatenate([self.hits, hits])
        self.kept[sides] = True

    def shoot(self, power, start=0):
        """(2 N, 3) power that arrives on all sides, and (3,) that escapes, when rows from `start` on send power (K, 3)."""
        beyond = len(self.kept)
        target = self.hits[start:].reshape(-1)
        target = np.where(target < 0, beyond, target)
        each = np.repeat(power / self.rays, self.rays, axis=0)
        arrived = np.stack([np.bincount(target, each[:, c], beyond + 1) for c in range(3)], axis=1)
        return arrived[:-1], arrived[-1]

    def gather(self, light, beyond):
        """(K, 3) irradiance of the rows' sides, from light (2 N, 3) of the sides that they hit and (3,) from beyond."""
        light = np.vstack([light, beyond])
        seen = np.take(light, self.hits.reshape(-1), axis=0, mode="wrap").reshape(-1, self.rays, 3)
        return np.einsum("knc->kc", seen) / self.rays

    def escaped(self, start=0):
        """(K, 1) share of the rays that escaped, of the rows from `start` on."""
        return (self.hits[start:] < 0).sum(axis=1, keepdims=True) / self.rays


class Transport:
    """Where light is and where it goes: power [W] per side (2 N, 3), kept in balance by every step.

    Power that is emitted (by faces that rays find) or arrives first-hand is `emitted`. What arrives on a side is
    partly absorbed; the rest is `unshot` until the side's row sends it on to other sides or out of the scene.
    emitted = absorbed + escaped + unshot, to rounding, at any time.
    """

    def __init__(self, area, surfaces, direct, sky, rays):
        self.area, self.surfaces, self.sky = np.repeat(area, 2)[:, None], surfaces, sky
        self.direct = direct
        self.rows = Rows(len(direct), rays)
        self.first = self.area * direct  # power that arrived first-hand
        self.arrived = self.first.copy()
        self.shot = np.zeros_like(direct)
        self.escaped = np.zeros(3)
        # A side without a row may see all of the sky, for all we know: power it would send on then.
        self.ahead = surfaces.send(self.area * sky * np.ones_like(direct))

    @property
    def own(self):
        """(2 N, 3) power that sides emit and that rays find."""
        return self.area * self.surfaces.found

    @property
    def emitted(self):
        return (self.own + self.first).sum(axis=0)

    @property
    def absorbed(self):
        returned = self.surfaces.reflectance + self.surfaces.translucency
        return (self.arrived * (1.0 - returned)).sum(axis=0)

    @property
    def unshot(self):
        return self.own + self.surfaces.send(self.arrived) - self.shot

    def pick(self, taken):
        """The next batch: sides of highest unshot power without a row and not `taken` (2 N,) bool, ties by id."""
        strength = np.where(self.rows.kept | taken, 0.0, (self.unshot + self.ahead).sum(axis=1))
        waiting = np.flatnonzero(strength > 0)
        count = max(BATCH, int(BATCH_SHARE * len(waiting)))
        return waiting[np.argsort(-strength[waiting], kind="stable")[:count]]

    def add(self, sides, hits):
        """Keep the rows of a batch; its sides take in the sky that they see, and shoot."""
        start = len(self.rows.sides)
        self.rows.add(sides, hits)
        self.ahead[sides] = 0.0
        if self.sky.any():
            seen = self.area[sides] * self.rows.escaped(start) * self.sky
            self.first[sides] += seen
            self.arrived[sides] += seen
        power = self.unshot[sides]
        self.shot[sides] += power
        arrived, escaped = self.rows.shoot(power, start)
        self.arrived += arrived
        self.escaped = self.escaped + escaped

    def settle(self, target):
        """Solve for the light that goes back and forth between sides with rows: each gathers over its own row, again
        and again. Then what has been shot is what the solution says, and the sides without rows get their share.

        Returns irradiance (2 N, 3), sweeps, and the certified bound on its error, as a share of its mean. Row sums are
        at most 1, so if a sweep changes nothing by more than r, nothing is off by more than g / (1 - g) r.
        """
        rows, sides = self.rows, self.rows.sides
        irradiance = self.arrived / self.area
        g = self.surfaces.returned
        sweeps, bound = 0, 0.0
        while len(sides) and sweeps < SWEEPS:
            light = self.surfaces.found + self.surfaces.send(irradiance)
            updated = self.direct[sides] + rows.gather(light, self.sky)
            change = np.abs(updated - irradiance[sides]).max(axis=0)
            irradiance[sides] = updated
            sweeps += 1
            mean = (self.area[sides] * updated).sum(axis=0) / self.area[sides].sum()
            bound = float((g / (1 - g) * change / np.maximum(mean, 1e-300)).max(where=mean > 0, initial=0.0))
            if bound <= target:
                break
        power = (self.area * (self.surfaces.found + self.surfaces.send(irradiance)))[sides]
        self.shot[sides] = power
        arrived, self.escaped = rows.shoot(power)
        self.arrived = self.first + arrived
        others = ~rows.kept
        irradiance[others] = (self.arrived / self.area)[others]
        return irradiance, sweeps, bound

    def missing(self):
        """Bounds on the power that has not arrived yet, as shares of the power emitted: what sides with rows have not
        shot, and sides without. Light u still to be shot adds at most g / (1 - g) u (power norm, row sums at most 1)."""
        g = self.surfaces.returned
        emitted = max((self.emitted + self.ahead.sum(axis=0)).sum(), 1e-300)
        unshot = np.abs(self.unshot)
        kept = self.rows.kept[:, None]
        inside = (np.where(kept, unshot, 0.0).sum(axis=0) * g / (1 - g)).sum()
        outside = (np.where(kept, 0.0, unshot).sum(axis=0) * g / (1 - g) + self.ahead.sum(axis=0) / (1 - g)).sum()
        return inside / emitted, outside / emitted


def solve(patches, surfaces, sky, cells, settings):
    """Find the Solution: a generator that yields a Round after every round and returns the Solution.

    sky: (3,) exitance of the world [W/m^2]. cells: started with `kernel.scene_arrays`.
    """
    begun = perf_counter()
    count, target = 2 * len(patches), settings.error / 10
    state = Transport(patches.area, surfaces, _light_patches(cells, count, settings), sky, settings.row_rays)
    taken, in_flight, rounds, sweeps = np.zeros(count, bool), deque(), [], 0
    settled = False
    while not settled:
        # Fill the pipeline with the brightest sides that have no row yet.
        inside, outside = state.missing()
        while len(in_flight) < LAG and outside > target / 2 and len(batch := state.pick(taken)):
            taken[batch] = True
            in_flight.append((batch, _trace_rows(cells, batch, settings)))
        if in_flight:
            batch, tasks = in_flight.popleft()
            state.add(batch, np.concatenate([result["hits"] for result in cells.take(tasks)]))
            inside, outside = state.missing()
        else:
            # No bright side is left without a row: solve, and see whether that brightens the others.
            irradiance, more, inside = state.settle(target)
            sweeps += more
            _, outside = state.missing()
            settled = outside <= target / 2 or not len(state.pick(taken))
        rounds.append(
            Round(
                number=len(rounds) + 1,
                unshot=float(abs(state.unshot.sum()) / max(state.emitted.sum(), 1e-300)),
                bound=float(inside + outside),
                rows=len(state.rows.sides),
                rays=count * settings.patch_samples + state.rows.hits.size,
                seconds=perf_counter() - begun,
            )
        )
        yield rounds[-1]
    return Solution(
        reflected=surfaces.send(irradiance),
        irradiance=irradiance,
        rounds=tuple(rounds),
        sweeps=sweeps,
        bound=rounds[-1].bound,
        converged=rounds[-1].bound <= target,
        energy={
            "emitted_w": float(state.emitted.sum()),
            "absorbed_w": float(state.absorbed.sum()),
            "escaped_w": float(state.escaped.sum()),
            "unshot_w": float(state.unshot.sum()),
        },
    )


def _light_patches(cells, count, settings):
    """(2 N, 3) direct irradiance of all patch sides."""
    size = max(TASK_RAYS // settings.patch_samples, 1)
    tasks = [
        cells.submit("direct", sides=part, samples=settings.patch_samples, seed=settings.seed)
        for part in _parts(np.arange(count), size)
    ]
    return np.concatenate([np.zeros((0, 3)), *(result["direct"] for result in cells.take(tasks))])


def _trace_rows(cells, sides, settings):
    """Ids of the tasks that find the rows of sides (K,)."""
    size = max(TASK_RAYS // settings.row_rays, 1)
    return [
        cells.submit("rows", sides=part, rays=settings.row_rays, seed=settings.seed) for part in _parts(sides, size)
    ]


def _parts(items, size):
    """Items (K,) cut into parts of at most `size`."""
    return [items[k : k + size] for k in range(0, len(items), size)]
