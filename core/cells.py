"""Cells: the workers that hold the geometry and nothing else, one process each.

Owns what the host may ask of cells, whatever they are: `start(arrays)`, `submit(task)`, `results()` and `stop()`.
A task is a name in `tasks.TASKS` with small arguments; its result depends on them and on the start arrays alone, so
tasks may run in any order, anywhere, or twice: a cell that dies is replaced and its tasks are dealt again.

Processes start as `runpy.run_path` of a boot file, with an empty `__main__`: it is the one way that works from inside
Blender (in background, in the window, from a script) as well as from the bpy module and from pytest.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import queue
import runpy
import signal
import sys
import threading
import types
from collections import deque
from dataclasses import dataclass, field, replace
from math import inf
from multiprocessing import connection, resource_tracker
from time import monotonic

from .kernel import Kernel
from .tasks import TASKS

BOOT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "cell_boot.py")
AHEAD = 3  # tasks that a cell holds at a time, so that it never waits for the host,
LAST = 2  # and when there are fewer tasks left than cells
APART = 1 << 16  # bytes of an array from which on it is sent without a copy
LOOK = 8  # tasks from one look at the memory used to the next: a look takes half a millisecond
PATIENCE = 20.0  # seconds without a sign of life from a cell that has work, after which it is replaced
RESTARTS = 3  # per cell; beyond them the tasks run in this process


@dataclass
class Usage:
    """What the cells have used: CPU seconds (`here`: those of them in the host's process), seconds of them inside
    Embree, rays; of each process the CPU seconds, `busy`, and the peak memory [MB]; and the CPU seconds of `parts` of the
    work: tasks by name, and what was noted within them."""

    cpu: float = 0.0
    here: float = 0.0
    embree: float = 0.0
    rays: int = 0
    busy: dict = field(default_factory=dict)
    memory: dict = field(default_factory=dict)
    parts: dict = field(default_factory=dict)

    def snapshot(self):
        return replace(self, busy=dict(self.busy), memory=dict(self.memory), parts=dict(self.parts))

    def add(self, cell, spent):
        cpu, embree, rays, memory, parts = spent
        self.cpu += cpu
        if cell == "host":
            self.here += cpu
        self.embree += embree
        self.rays += int(rays)
        self.busy[cell] = self.busy.get(cell, 0.0) + cpu
        self.memory[cell] = max(self.memory.get(cell, 0.0), memory)
        for part, seconds in parts.items():
            self.parts[part] = self.parts.get(part, 0.0) + seconds


class Cells:
    """What all kinds of cells have in common.

    count: how many work at a time. restarted: how many were replaced. note: why they are not what was asked for, or "".
    in_turn: whether start arrays reach one cell after the other, not all at the same time. flow_each: tasks of a flow that
    are made ahead for each cell. points_each: as how many each point counts, more than one where cells are only counted.
    """

    in_turn = False
    flow_each = 2 * AHEAD
    points_each = 1

    def __init__(self):
        self.count, self.restarted, self.note = 1, 0, ""
        self.usage = Usage()
        self._next = 0
        self._kept = {}
        self._ready = deque()  # results that have come together, and were not asked for yet

    def start(self, arrays):
        """Give every cell these arrays, {name: array}, in place of any of the same name."""
        raise NotImplementedError

    def submit(self, name, **arguments):
        """Queue a task; returns the id under which its result will come."""
        raise NotImplementedError

    def results(self):
        """Yield (id, result) of the tasks submitted, in the order they are done, until none is left."""
        raise NotImplementedError

    def limit(self, count):
        """Let at most so many work, where they take this machine's memory: the others end, what they had is dealt again, and
        they are back when more may work. With none the work is done in this process."""

    def clear(self):
        """Forget all tasks: queued ones are not run, results still to come are dropped."""
        raise NotImplementedError

    def stop(self):
        """End all cells; nothing of theirs is left."""
        raise NotImplementedError

    def take(self, ids):
        """The results of tasks, in the order of their ids; waits for them. Others that come meanwhile are kept."""
        kept = self._kept
        if not all(k in kept for k in ids):
            for number, result in self.results():
                kept[number] = result
                if number in ids and all(k in kept for k in ids):
                    break
        return [kept.pop(k) for k in ids]

    def flow(self, name, each, most=inf):
        """Yield the results of tasks in order. each: iterable of their arguments, which are made as cells come free, so
        that those of all tasks are never held at a time. most: that wait, where they are large."""
        waiting = deque()
        for arguments in each:
            waiting.append(self.submit(name, **arguments))
            if len(waiting) > min(self.flow_each * self.count, most):
                yield from self.take([waiting.popleft()])
        yield from self.take(list(waiting))

    def brought(self, ids):
        """{id: result} of those of some tasks whose results have come and were not taken yet."""
        self._kept.update(self._ready)
        self._ready.clear()
        return {number: self._kept[number] for number in ids if number in self._kept}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stop()


class LocalCells(Cells):
    """Cells in this process: a task is run when its result is asked for."""

    def __init__(self, note=""):
        super().__init__()
        self.note = note
        self._kernel = Kernel({})
        self._waiting = deque()

    def start(self, arrays):
        self._kernel = self._kernel.renewed(arrays)

    def submit(self, name, **arguments):
        self._waiting.append((self._next, name, arguments))
        self._next += 1
        return self._next - 1

    def results(self):
        while self._waiting:
            number, name, arguments = self._waiting.popleft()
            result, spent = run_task(self._kernel, name, arguments)
            self.usage.add("host", spent)
            yield number, result

    def clear(self):
        self._waiting.clear()
        self._kept.clear()

    def stop(self):
        self.clear()
        self._kernel = Kernel({})


class ProcessCells(Cells):
    """Cells that are processes of this machine, joined to the host by pipes.

    count: number of cells. Raises OSError if no process can be started at all (see `make_cells`).
    """

    def __init__(self, count):
        super().__init__()
        self.count = count
        _survive_broken_pipes()
        self._arrays = {}
        self._waiting = deque()
        self._cells = []
        self._dropped = set()
        self._local, self._aside = None, 0
        try:
            for index in range(count):
                self._cells.append(_Process(index))
        except OSError as error:
            if not self._cells:
                raise
            self.count = len(self._cells)
            self.note = f"only {self.count} of {count} cells could be started ({error})"
        except BaseException:
            self.stop()
            raise

    def start(self, arrays):
        changed = {k: a for k, a in arrays.items() if self._arrays.get(k) is not a}
        self._arrays.update(changed)
        message = _packed(("arrays", changed), APART)
        for cell in self._cells:
            cell.send(message)
        if self._local:
            self._local.start(changed)

    def submit(self, name, **arguments):
        self._waiting.append((self._next, name, arguments))
        self._next += 1
        if len(self._waiting) == 1:  # or else no cell had room for the one before it
            self._deal()
        return self._next - 1

    def results(self):
        while self._ready or self._waiting or any(cell.tasks.keys() - self._dropped for cell in self._cells):
            if self._ready:  # to ask many cells whether they have something takes time
                yield self._ready.popleft()
                continue
            self._deal()
            if not self._cells:
                yield from self._run_here()
                continue
            busy = [cell for cell in self._cells if cell.tasks]
            ready = connection.wait([cell.pipe for cell in busy], timeout=1.0)
            for cell in busy:
                if cell.pipe in ready:
                    message = self._receive(cell)
                    if message is not None:
                        self._ready.append(message)
                elif monotonic() - cell.heard > PATIENCE:
                    self._replace(cell)

    def limit(self, count):
        before = len(self._cells)
        while len(self._cells) > count:
            self._give_back(self._cells[-1])
            self.usage.memory.pop(self._cells.pop().process.pid, None)
            self._aside += 1
        while self._aside and len(self._cells) < count:
            try:
                self._cells.append(_Process(len(self._cells)))
            except OSError:
                break
            self._cells[-1].send(_packed(("arrays", self._arrays), APART))
            self._aside -= 1
        now = len(self._cells)
        if now != before:
            self.count = max(now, 1)
            few = f"only {now} of {now + self._aside} cells fit into the memory that may be used"
            self.note = (few if now else f"{few}; the work was done in this process") if self._aside else ""

    def clear(self):
        self._waiting.clear()
        self._ready.clear()
        self._kept.clear()
        self._dropped.update(number for cell in self._cells for number in cell.tasks)

    def stop(self):
        self.clear()
        for cell in self._cells:
            cell.end()
        self._cells = []

    def _deal(self):
        """Give tasks to the cells that hold the fewest."""
        while self._waiting:
            cell = min(self._cells, key=lambda c: len(c.tasks), default=None)
            if cell is None or len(cell.tasks) >= ahead(len(self._waiting), len(self._cells)):
                return
            number, name, arguments = task = self._waiting.popleft()
            if not cell.tasks:
                cell.heard = monotonic()
            cell.tasks[number] = task
            cell.send(_packed(("task", number, name, arguments)))

    def _receive(self, cell):
        """(id, result) that a cell has sent; None for a sign of life, a dropped task or a cell that is gone."""
        try:
            kind, *rest = cell.pipe.recv()
        except (EOFError, OSError):
            self._replace(cell)
            return None
        cell.heard = monotonic()
        if kind == "alive":
            return None
        number, payload, spent = rest
        cell.tasks.pop(number, None)
        if number in self._dropped:
            self._dropped.remove(number)
            return None
        if kind == "error":
            raise CellError(payload)
        self.usage.add(cell.process.pid, spent)
        return number, payload

    def _replace(self, cell):
        """Start a new cell in place of one that died or hangs, and deal its tasks again."""
        self._give_back(cell)
        place = self._cells.index(cell)
        self.restarted += 1
        if self.restarted > RESTARTS * self.count:
            del self._cells[place]
            self.note = "cells keep dying; their work was done in this process"
            return
        try:
            self._cells[place] = fresh = _Process(cell.index)
        except OSError as error:
            del self._cells[place]
            self.note = f"no new cell could be started ({error}); its work was done in this process"
            return
        fresh.send(_packed(("arrays", self._arrays), APART))

    def _give_back(self, cell):
        """End a cell; its tasks wait again."""
        tasks = [task for number, task in cell.tasks.items() if number not in self._dropped]
        self._dropped.difference_update(cell.tasks)
        cell.end()
        self._waiting.extendleft(reversed(tasks))

    def _run_here(self):
        """Do the waiting tasks in this process: no cell is left."""
        if not self._local:
            self._local = LocalCells()
            self._local.start(self._arrays)
            self._local.usage = self.usage
        while self._waiting:
            number, name, arguments = self._waiting.popleft()
            self._local.submit(name, **arguments)
            yield from ((number, result) for _, result in self._local.results())


class CellError(RuntimeError):
    """A task failed in a cell; the message is the cell's own traceback."""


class _Process:
    """One cell: its process, the pipe to it, and the tasks it holds, {id: (id, name, arguments)}.

    A thread writes to the pipe, so that a cell that does not read (it hangs, or is stopped) never blocks the host.
    """

    def __init__(self, index):
        context = multiprocessing.get_context("spawn")
        self.index, self.tasks, self.heard = index, {}, monotonic()
        self.pipe, there = context.Pipe()
        entry = {"pipe": there}
        self.process = context.Process(target=runpy.run_path, args=(BOOT, entry, "radiosity_cell"), daemon=True)
        with _empty_main(), _uninterrupted():
            self.process.start()
        there.close()  # so that the pipe ends when the cell does
        self._outbox = queue.SimpleQueue()
        self._writer = threading.Thread(target=self._write, daemon=True)
        self._writer.start()

    def send(self, message):
        """Send a packed message in its turn. A cell that is gone is noticed when its pipe is read."""
        self._outbox.put(message)

    def end(self):
        """Kill the cell and wait until it is gone."""
        if self.process.is_alive():
            self.process.kill()
        self.process.join()
        self._outbox.put(None)
        self._writer.join()
        self.pipe.close()

    def _write(self):
        with contextlib.suppress(OSError):
            while (message := self._outbox.get()) is not None:
                for part in message:
                    self.pipe.send_bytes(part)


def _packed(message, apart=inf):
    """A message as the parts that are sent one by one, packed once for all cells. Arrays of `apart` bytes or more,
    which nobody may change any more, are parts of their own: to copy them would hold up the other threads, Blender's
    window too."""
    arrays = []
    callback = lambda array: array.raw().nbytes < apart or arrays.append(array.raw())
    head = pickle.dumps(message, 5, buffer_callback=callback)
    return [pickle.dumps((head, [array.nbytes for array in arrays])), *arrays]


def unpacked(pipe):
    """The next message that comes through a pipe, of those that `_packed` makes."""
    head, sizes = pipe.recv()
    arrays = [bytearray(size) for size in sizes]
    for array in arrays:
        pipe.recv_bytes_into(array)
    return pickle.loads(head, buffers=arrays)


def ahead(waiting, count):
    """How many tasks each of `count` cells may hold when so many wait."""
    return AHEAD if waiting >= count else LAST


def make_cells(count):
    """Cells: `count` processes; if none can be started, cells in this process, which say why in their `note`."""
    if not sys.executable:
        return LocalCells("there is no Python program to start cells with; the work was done in this process")
    try:
        return ProcessCells(count)
    except OSError as error:
        return LocalCells(f"no process could be started ({error}); the work was done in this process")


def run_task(kernel, name, arguments):
    """The result of a task, and what it used: (CPU seconds, those inside Embree, rays, peak memory [MB], {part of the work:
    CPU seconds})."""
    from time import thread_time

    begun = thread_time()
    result = TASKS[name](kernel, **arguments)
    embree, rays, parts = kernel.spent()
    seconds = thread_time() - begun
    if kernel.tasks % LOOK == 0:
        kernel.peak = peak_memory()
    kernel.tasks += 1
    return result, (seconds, embree, rays, kernel.peak, {name: seconds, **parts})


def peak_memory():
    """Peak memory of this process so far [MB]; 0 where the system does not say."""
    # A new process inherits its parent's peak in getrusage; Linux keeps the process's own here.
    told = _told_memory("VmHWM")
    if told is not None:
        return told
    try:
        import resource
    except ImportError:
        return 0.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1 << 20 if sys.platform == "darwin" else 1 << 10)


def memory_now():
    """Memory of this process [MB], its peak where the system says no more."""
    told = _told_memory("VmRSS")
    return peak_memory() if told is None else told


def _told_memory(name):
    """What Linux says of the memory of this process [MB], or None."""
    try:
        with open("/proc/self/status") as status:
            return next(float(line.split()[1]) / 1024 for line in status if line.startswith(name))
    except (OSError, StopIteration):
        return None


@contextlib.contextmanager
def _empty_main():
    """While a process is spawned, hide the program's `__main__`: the child would run it again (a Blender script, say)."""
    main = sys.modules["__main__"]
    sys.modules["__main__"] = types.ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


@contextlib.contextmanager
def _uninterrupted():
    """While a process is spawned, hold Ctrl-C back: the child inherits that, and would else die of it while it loads."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # Started now, as its start would let interrupts through again.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _survive_broken_pipes():
    """Where SIGPIPE is at its default (as inside some Blenders), writing to a dead cell would end the whole program."""
    if not hasattr(signal, "SIGPIPE") or threading.current_thread() is not threading.main_thread():
        return
    if signal.getsignal(signal.SIGPIPE) == signal.SIG_DFL:
        signal.signal(signal.SIGPIPE, signal.SIG_IGN)
