"""Cells that are only counted, not there: a bake's own schedule, run against tasks whose times were measured before.

Owns the discrete-event replay that says what a bake would take on more cells than this machine has. The host's code is
the real one; it sees a `Cells` whose results come when, by the measured times, they would have come. Its own work is
timed as it runs and takes its place in the same clock.
"""

from __future__ import annotations

import heapq
from collections import deque
from dataclasses import dataclass
from hashlib import blake2b
from time import perf_counter, process_time

import numpy as np

from .cells import AHEAD, Cells, ProcessCells, run_task
from .kernel import Kernel

CAUSES = ("too few shooters", "waiting", "messages", "serial host work")


@dataclass(frozen=True)
class MessageCost:
    """What a task costs beside its own work [s]: host, per task and per byte of its result; latency, until a cell's
    result is with the host and the next task with the cell."""

    host: float
    host_per_byte: float
    latency: float


def measure_messages(cells):
    """The MessageCost of process cells, by tasks that do nothing but answer with a given number of bytes."""

    def host_seconds(count, size):
        list(cells.results())
        begun, spent = perf_counter(), process_time()
        for task in [cells.submit("wait", seconds=0.0, sizes=np.array([size])) for _ in range(count)]:
            cells.take([task])
        return (process_time() - spent) / count, (perf_counter() - begun) / count

    host_seconds(20, 8)
    small, _ = host_seconds(400, 8)
    large, _ = host_seconds(60, 1 << 17)
    trips = []
    for _ in range(100):
        begun = perf_counter()
        cells.take([cells.submit("wait", seconds=0.0, sizes=np.array([8]))])
        trips.append(perf_counter() - begun)
    per_byte = max(large - small, 0.0) / (8 << 17)
    return MessageCost(small, per_byte, max(float(np.median(trips)) - small, 0.0) / 2)


class TaskTimes:
    """Results and times [s] of tasks, each run once, here, and remembered by what it depends on."""

    def __init__(self):
        self._kernel, self._digests, self._known = Kernel({}), {}, {}

    def start(self, arrays):
        self._kernel = self._kernel.renewed(arrays)
        for name, array in arrays.items():
            self._digests[name] = _digest(array)

    def run(self, name, arguments):
        """(result, seconds, rays) of a task."""
        parts = ("scene", "patches", "sources", "points", "gather")[: 5 if name == "gather" else 3]
        needs = tuple(d for k, d in sorted(self._digests.items()) if k.split(".")[0] in parts)
        key = (name, needs, *((k, _digest(v)) for k, v in sorted(arguments.items())))
        if key not in self._known:
            result, spent = run_task(self._kernel, name, arguments)
            self._known[key] = result, spent[0], int(spent[2])
        return self._known[key]


class ReplayCells(Cells):
    """`count` cells that are not there. `clock` is the time since the start [s]; `busy` (count,) what each has worked;
    `lost` {cause: s} what all of them together have not worked, and why."""

    def __init__(self, count, times, message):
        super().__init__()
        self.count, self.times, self.message = count, times, message
        self.busy = np.zeros(count)
        self.lost = dict.fromkeys(CAUSES, 0.0)
        self.clock, self._mark = 0.0, perf_counter()
        self._host = deque()  # (from, to, cause) of what the host did while it did not wait
        self._waiting, self._running = deque(), []
        self._held, self._free = [0] * count, [0.0] * count
        self._few, self._opened = False, 0.0

    def start(self, arrays):
        self._host_worked()
        self.times.start(arrays)
        self._mark = perf_counter()

    def submit(self, name, **arguments):
        self._host_worked()
        result, seconds, rays = self.times.run(name, arguments)
        self.usage.rays += rays
        self._mark = perf_counter()
        self._host_spends(self.message.host / 2, "messages")
        self._waiting.append((self._next, result, seconds))
        self._next += 1
        self._few = len(self._waiting) + sum(self._held) < self.count
        self._deal()
        return self._next - 1

    def results(self):
        while self._running:
            self._host_worked()
            finish, number, cell, result = heapq.heappop(self._running)
            self.clock = max(self.clock, finish + self.message.latency)
            size = sum(np.asarray(a).nbytes for a in result.values())
            self._host_spends(self.message.host / 2 + size * self.message.host_per_byte, "messages")
            self._held[cell] -= 1
            self._deal()
            self._mark = perf_counter()
            yield number, result
        self._host_worked()

    def clear(self):
        self._waiting.clear()
        self._kept.clear()

    def stop(self):
        self.clear()

    def open_books(self):
        """Count work and losses from now on."""
        self._host_worked()
        self._free = [max(free, self.clock) for free in self._free]
        self.busy[:] = 0.0
        self.lost = dict.fromkeys(CAUSES, 0.0)
        self._opened = self.clock

    def close_books(self):
        """Seconds since the books were opened; what the cells did not work until now is lost."""
        self._host_worked()
        for cell in range(self.count):
            self._lose(cell, self.clock)
            self._free[cell] = self.clock
        return self.clock - self._opened

    def _host_worked(self):
        """The host has worked since the mark: that is so much of the clock."""
        now = perf_counter()
        self._host_spends(now - self._mark, "serial host work")
        self._mark = now

    def _host_spends(self, seconds, cause):
        self._host.append((self.clock, self.clock + seconds, cause))
        self.clock += seconds

    def _deal(self):
        """Tasks go to the cells that hold the fewest, as from the real host."""
        while self._waiting:
            cell = min(range(self.count), key=lambda c: (self._held[c], self._free[c]))
            if self._held[cell] >= AHEAD:
                return
            number, result, seconds = self._waiting.popleft()
            begin = max(self._free[cell], self.clock + self.message.latency)
            self._lose(cell, begin)
            self._free[cell] = begin + seconds
            self.busy[cell] += seconds
            self._held[cell] += 1
            heapq.heappush(self._running, (begin + seconds, number, cell, result))

    def _lose(self, cell, until):
        """A cell had nothing to do from when it was free until now: find out why."""
        begin = self._free[cell]
        if until <= begin:
            return
        left = until - begin
        for start, stop, cause in reversed(self._host):
            if stop <= begin:
                break
            overlap = min(stop, until) - max(start, begin)
            if overlap > 0:
                self.lost[cause] += overlap
                left -= overlap
        latency = min(max(left, 0.0), self.message.latency)
        self.lost["messages"] += latency
        self.lost["too few shooters" if self._few else "waiting"] += max(left - latency, 0.0)


class SleepingCells(ProcessCells):
    """Real processes that wait as long as a task was measured to take, and answer with as many bytes: real messages and
    real host work, to check the replay. Every task must have been run by `times` before."""

    def __init__(self, count, times):
        super().__init__(count)
        self._times, self._answers = times, {}

    def start(self, arrays):
        self._times.start(arrays)

    def submit(self, name, **arguments):
        result, seconds, _ = self._times.run(name, arguments)
        sizes = np.array([np.asarray(a).nbytes // 8 + 1 for a in result.values()])
        number = super().submit("wait", seconds=seconds, sizes=sizes)
        self._answers[number] = result
        return number

    def results(self):
        for number, _ in super().results():
            yield number, self._answers.pop(number)


def _digest(value):
    """A short name for the content of an array or a number."""
    array = np.ascontiguousarray(value)
    return blake2b(array.tobytes() + str((array.dtype, array.shape)).encode(), digest_size=12).hexdigest()
