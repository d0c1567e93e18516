"""Where the time of a bake goes: wall and CPU seconds by phase, and what its cells used."""

from __future__ import annotations

from time import perf_counter, process_time, thread_time

from .cells import peak_memory


class Clock:
    """Wall and CPU seconds of the phases of one bake, and what its cells used, which may have worked before."""

    def __init__(self, cells):
        self._cells, self._usage = cells, cells.usage.snapshot()
        self._restarted = cells.restarted
        self._begun = self._lap = perf_counter()
        self._cpu = process_time()
        self._phases, self.watched = {}, 0.0

    def watch(self, generator):
        """Yield what a generator yields and return what it returns; `watched` are the CPU seconds of this thread in it,
        without those of cells that work here."""
        try:
            while True:
                begun, here = thread_time(), self._cells.usage.here
                try:
                    item = next(generator)
                except StopIteration as end:
                    return end.value
                finally:
                    self.watched += thread_time() - begun - (self._cells.usage.here - here)
                yield item
        finally:
            generator.close()

    def lap(self, phase):
        """Add the time since the last lap to a phase."""
        now = perf_counter()
        self._phases[phase], self._lap = self._phases.get(phase, 0.0) + now - self._lap, now

    def total(self):
        return perf_counter() - self._begun

    def rays(self):
        return self._cells.usage.rays - self._usage.rays

    def parts(self):
        """{part of the cells' work: CPU seconds}."""
        before = self._usage.parts
        return {part: seconds - before.get(part, 0.0) for part, seconds in self._cells.usage.parts.items()}

    def seconds(self, phase=None):
        """{phase: seconds}, and CPU seconds. phase: that which goes on, if its time so far is to count."""
        used, before = self._cells.usage, self._usage
        here = process_time() - self._cpu
        cpu = here + used.cpu - before.cpu - (used.here - before.here)
        phases = {**dict.fromkeys(("survey", "patches", "transport", "gather"), 0.0), **self._phases}
        if phase:
            phases[phase] += perf_counter() - self._lap
        return {**phases, "cpu": cpu, "embree_cpu": used.embree - before.embree}

    def pace(self):
        """Wall seconds that a CPU second takes, of the host and of the cells, which work side by side."""
        used, before = self._cells.usage, self._usage
        cells, count = used.cpu - before.cpu, max(self._cells.count, 1)
        host = process_time() - self._cpu - (used.here - before.here)
        pace = self.total() / max(host + cells / count, 1e-9)
        return pace, pace / count

    def cells(self):
        """Number of cells, restarts, and peak memory [MB] of the host and of each cell."""
        memory = {k: v for k, v in self._cells.usage.memory.items() if k != "host"}
        return dict(
            count=self._cells.count,
            restarted=self._cells.restarted - self._restarted,
            host_mb=peak_memory(),
            cells_mb=list(memory.values()),
        )
