"""Cells that are only counted, not there: a bake's own schedule, run against tasks whose times were measured before.

Owns the discrete-event replay that says what a bake would take on more cells than this machine has. The host's code is
the real one; it sees a `Cells` whose results come when, by the measured times, they would have come. Its own work
takes its place in the same clock, by the CPU seconds it takes: whatever else runs on the machine does not count.
"""

from __future__ import annotations

import heapq
from bisect import bisect_right
from collections import deque
from dataclasses import dataclass
from hashlib import blake2b
from time import perf_counter, process_time, thread_time

import numpy as np

from .cells import Cells, ProcessCells, ahead, run_task
from .kernel import Kernel
from .sampling import scatter

FILLING = 1 << 24  # bytes of the arrays whose sending is timed
BY_THEMSELVES = ("control",)  # tasks whose number does not go with that of the points
CAUSES = ("too few shooters", "waiting", "messages", "serial host work")


@dataclass(frozen=True)
class MessageCost:
    """What a task costs beside its own work [s]: host, per task and per byte of its arguments and result; latency,
    until a cell's result is with the host and the next task with the cell; start_per_byte, until a cell has a byte of
    new arrays, which all cells take in at the same time, or each in its turn."""

    host: float
    host_per_byte: float
    latency: float
    start_per_byte: float = 0.0
    in_turn: bool = False


def measure_messages(cells):
    """The MessageCost of one process cell, by tasks that do nothing but answer with a given number of bytes."""

    def ask(size=8):
        return cells.submit("wait", seconds=0.0, sizes=np.array([size]), carried=np.zeros(size))

    def answer():
        cells.take([ask()])

    def host_seconds(count, size):
        spent = process_time()
        for task in [ask(size) for _ in range(count)]:
            cells.take([task])
        return (process_time() - spent) / count

    def trip():
        begun = perf_counter()
        answer()
        return perf_counter() - begun

    def start_seconds(number):
        filling = scatter(np.arange(FILLING // 8) + FILLING * number, 0)  # nothing that is there, or that can be packed
        begun = perf_counter()
        cells.start({"wait.filling": filling})
        answer()
        return perf_counter() - begun

    host_seconds(20, 8)
    small, large = host_seconds(400, 8), host_seconds(60, 1 << 17)
    trips = float(np.median([trip() for _ in range(100)]))
    filling = min(start_seconds(number) for number in range(3)) - trips
    cells.start({"wait.filling": np.zeros(0)})
    per_byte, latency = max(large - small, 0.0) / (16 << 17), max(trips - small, 0.0) / 2
    return MessageCost(small, per_byte, latency, max(filling, 0.0) / FILLING, cells.in_turn)


class TaskTimes:
    """Results and times [s] of tasks, each run once, here, and remembered by what it depends on."""

    def __init__(self):
        self._kernel, self._digests, self._needs, self._known = Kernel({}), {}, {}, {}

    def start(self, arrays):
        """Give the tasks these arrays; returns a short name {name: digest} for what is in each."""
        self._kernel = self._kernel.renewed(arrays)
        digests = {name: _digest(array) for name, array in arrays.items()}
        self._digests.update(digests)
        self._needs = {}
        return digests

    def run(self, name, arguments):
        """(result, seconds, rays) of a task."""
        if name not in self._needs:
            parts = ("scene", "patches", "sources", "gather")[: 4 if name in ("gather", "control") else 3]
            self._needs[name] = tuple(d for k, d in sorted(self._digests.items()) if k.split(".")[0] in parts)
        key = (name, self._needs[name], *((k, _digest(v)) for k, v in sorted(arguments.items())))
        if key not in self._known:
            result, spent = run_task(self._kernel, name, arguments)
            self._known[key] = result, spent[0], int(spent[2])
        return self._known[key]


class ReplayCells(Cells):
    """`count` cells that are not there. `clock` is the time since the start [s]; `busy` (count,) what each has worked;
    `lost` {cause: s} what all of them together have not worked, and why.

    While the host works or passes messages, that is what an idle cell waits for. While the host itself waits, a cell
    that had no part in the latest burst of tasks had "too few shooters", if there were fewer tasks than cells; any
    other has done its part and is "waiting" for the rest.

    copies: as how many each point counts from `multiply` on: so many copies of each task are dealt, and so many times what
    the host does takes as long.
    """

    def __init__(self, count, times, message, copies=1):
        super().__init__()
        self.count, self.times, self.message, self._copies = count, times, message, copies
        self._each, self._left, self._alone = 1, {}, 0
        self._there = {}  # what the cells have been given, by its digest: the same is not sent twice
        self.busy = np.zeros(count)
        self.lost = dict.fromkeys(CAUSES, 0.0)
        self.clock, self._mark = 0.0, thread_time()
        # What the host did: up to a moment of `_moments`, `_spent` of each cause in all; waits in short bursts apart.
        self._moments, self._spent = [0.0], [dict.fromkeys(CAUSES, 0.0)]
        self._bursts, self._outstanding, self._peak = [0.0], 0, 0
        self._collecting = False
        self._waiting, self._running = deque(), []
        self._held, self._free = [0] * count, [0.0] * count
        self._opened = 0.0

    def start(self, arrays):
        self._host_worked()
        digests = self.times.start(arrays)
        size = _bytes({name: array for name, array in arrays.items() if digests[name] != self._there.get(name)})
        self._there.update(digests)
        for cell in range(self.count):
            arrives = self.clock + self.message.start_per_byte * size * (cell + 1 if self.message.in_turn else 1)
            self._lose(cell, self.clock)
            self.lost["messages"] += max(arrives - max(self._free[cell], self.clock), 0.0)
            self._free[cell] = max(self._free[cell], arrives)
        self._mark = thread_time()

    def submit(self, name, **arguments):
        self._host_worked()
        result, seconds, rays = self.times.run(name, arguments)
        copies = 1 if name in BY_THEMSELVES else self._each
        self.usage.rays += copies * rays
        if self._collecting:
            self._collecting = False
            self._bursts.append(self.clock)
            self._peak = 0
        self._alone += name in BY_THEMSELVES
        self._left[self._next] = copies, name
        passing = self._passing(arguments)
        self._outstanding += copies
        self._peak = max(self._peak, self._outstanding)
        self._waiting.extend([(self._next, result, seconds, passing)] * copies)
        self._next += 1
        self._deal()
        self._mark = thread_time()
        return self._next - 1

    def results(self):
        while self._running:
            self._host_worked()
            self._collecting = True
            finish, number, cell, result = heapq.heappop(self._running)
            few = self._peak < self.count
            self._advance(finish, "too few shooters" if few else "waiting")
            self._advance(finish + self.message.latency, "messages")
            self._advance(self.clock + self._passing(result), "messages")
            self._held[cell] -= 1
            self._outstanding -= 1
            self._deal()
            self._mark = thread_time()
            left, name = self._left[number]
            self._left[number] = left - 1, name
            if left == 1:
                del self._left[number]
                yield number, result
                self._host_worked()
                self._alone -= name in BY_THEMSELVES
        self._host_worked()

    def clear(self):
        self._outstanding -= len(self._waiting)
        self._waiting.clear()
        self._left, self._alone = {number: self._left[number] for _, number, *_ in self._running}, 0
        self._kept.clear()

    def stop(self):
        self.clear()

    def multiply(self):
        """From now on, what is done is done for every copy of the points."""
        self._host_worked()
        self._each = self._copies

    @property
    def points_each(self):
        """Of the copies, once they are there."""
        return self._each

    def open_books(self):
        """Count work and losses from now on."""
        self._host_worked()
        self._free = [max(free, self.clock) for free in self._free]
        self.busy[:] = 0.0
        self.lost = dict.fromkeys(CAUSES, 0.0)
        self.lost["messages"] = sum(self._free) - self.count * self.clock  # arrays that are still on their way
        self._opened = self.clock

    def close_books(self):
        """Seconds since the books were opened; what the cells did not work until now is lost."""
        self._host_worked()
        for cell in range(self.count):
            self._lose(cell, self.clock)
            self.lost["messages"] -= max(self._free[cell] - self.clock, 0.0)  # arrays that have come too late
            self._free[cell] = self.clock
        return self.clock - self._opened

    def _host_worked(self):
        """The host has worked since the mark: that is so much of the clock."""
        now = thread_time()
        each = 1 if self._alone else self._each
        self._advance(self.clock + each * (now - self._mark), "serial host work")
        self._mark = now

    def _advance(self, until, cause):
        """Move the clock on; `cause` is what idle cells wait for meanwhile."""
        if until > self.clock:
            self._spent.append({**self._spent[-1], cause: self._spent[-1][cause] + until - self.clock})
            self._moments.append(until)
            self.clock = until

    def _deal(self):
        """Tasks go to the cells that hold the fewest, as from the real host."""
        while self._waiting:
            cell = self._held.index(min(self._held))
            if self._held[cell] >= ahead(len(self._waiting), self.count):
                return
            number, result, seconds, passing = self._waiting.popleft()
            self._advance(self.clock + passing, "messages")
            begin = max(self._free[cell], self.clock + self.message.latency)
            self._lose(cell, begin)
            self._free[cell] = begin + seconds
            self.busy[cell] += seconds
            self._held[cell] += 1
            heapq.heappush(self._running, (begin + seconds, number, cell, result))

    def _passing(self, arrays):
        """Seconds that the host takes to send, or to receive, what a task works on or brings."""
        return self.message.host / 2 + _bytes(arrays) * self.message.host_per_byte

    def _lose(self, cell, until):
        """A cell had nothing to do from when it was free until now: find out why."""
        begin = self._free[cell]
        if until <= begin:
            return
        end = min(until, self.clock)
        if begin < end:
            before, after = self._until(begin), self._until(end)
            for cause in CAUSES:
                self.lost[cause] += after[cause] - before[cause]
            # Of the burst in which it has worked, the cell has done its part.
            burst = bisect_right(self._bursts, begin)
            over = self._until(min(self._bursts[burst], end) if burst < len(self._bursts) else end)
            done = over["too few shooters"] - before["too few shooters"]
            if self._worked_in(cell, burst - 1):
                self.lost["too few shooters"] -= done
                self.lost["waiting"] += done
        self.lost["messages"] += until - max(begin, end)

    def _worked_in(self, cell, burst):
        """Whether the cell has worked since a burst began."""
        return self.busy[cell] > 0 and self._free[cell] > self._bursts[burst]

    def _until(self, moment):
        """{cause: s} of all the time up to a moment."""
        k = min(bisect_right(self._moments, moment), len(self._moments) - 1)
        left = self._moments[k] - moment
        if left <= 0:
            return self._spent[k]
        cause = next(c for c in CAUSES if self._spent[k][c] > self._spent[k - 1][c])
        return {**self._spent[k], cause: self._spent[k][cause] - left}


class SleepingCells(ProcessCells):
    """Real processes that wait as long as a task was measured to take, and answer with as many bytes: real messages and
    real host work, to check the replay. Every task must have been run by `times` before.

    All bakes must be of the same: in the first one tasks are looked up, which takes the host longer than it should; later
    ones submit the same tasks in the same order.
    """

    def __init__(self, count, times):
        self._times, self._answers = times, {}
        self._tasks, self._place, self._looked_up = [], 0, False
        super().__init__(count)

    def start(self, arrays):
        if not self._looked_up:
            self._times.start(arrays)

    def limit(self, count):
        """They hold nothing."""

    def submit(self, name, **arguments):
        if not self._looked_up:
            result, seconds, _ = self._times.run(name, arguments)
            sizes = np.array([np.asarray(a).nbytes // 8 + 1 for a in result.values()])
            carried = np.zeros(_bytes(arguments) // 8 + 1)
            self._tasks.append((result, dict(seconds=seconds, sizes=sizes, carried=carried)))
        result, asked = self._tasks[self._place]
        self._place += 1
        number = super().submit("wait", **asked)
        self._answers[number] = result
        return number

    def clear(self):
        super().clear()
        self._place, self._looked_up = 0, len(self._tasks) > 0

    def _receive(self, cell):
        message = super()._receive(cell)
        return message and (message[0], self._answers.pop(message[0]))


def _bytes(arrays):
    """Bytes of arrays and numbers {name: value}."""
    return sum(np.asarray(a).nbytes for a in arrays.values())


def _digest(value):
    """A short name for the content of an array or a number."""
    array = np.ascontiguousarray(value)
    return blake2b(array.tobytes() + f"{array.dtype.str}{array.shape}".encode(), digest_size=12).hexdigest()
