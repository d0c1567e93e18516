"""Work beside Blender's window, such as a bake: it runs in a thread that never touches Blender, and its light whenever
it is asked for."""

from __future__ import annotations

import threading
from time import perf_counter

from .translations import tr

PHASES = {
    "survey": "Surveying", "patches": "Cutting patches", "transport": "Light between patches",
    "gather": "Light at the points", "error": "Looking at the error",
}  # fmt: skip


class Running:
    """The work of a Job in a thread of its own: numpy and pipes alone. work: function of the job, a generator of Progress.
    expected: seconds that it may take, or None.

    phase: what the window is at ("read", "work", "write"). waiting: what it waits for, or "". progress: the last
    Progress, or None. bound, light_error: the last that are known of the light, or None. error: what the work has
    failed with, or None. brought: it has brought something to write; partial: it was ended early, with the light that
    was there. cost: seconds that the last look at the light took.
    """

    def __init__(self, job, work, expected=None):
        self.job, self.phase, self.waiting = job, "read", ""
        self._work, self._expected = work, expected
        self.progress = self.bound = self.light_error = self.error = None
        self.cost = 0.0
        self.brought = self.partial = False
        self._cancelled, self._dropped, self._wanted = (threading.Event() for _ in range(3))
        self._shown = None
        self._thread = threading.Thread(target=self._do, name="radiosity bake", daemon=True)

    def start(self):
        """Begin, once the scene is read."""
        self.phase = "work"
        self._thread.start()

    @property
    def done(self):
        return not self._thread.is_alive()

    @property
    def cancelled(self):
        return self._cancelled.is_set()

    @property
    def left(self):
        """Seconds left of the work, a guess; None if there is none."""
        progress = self.progress
        if self.phase != "work" or self.cancelled:
            return None
        if progress is None or progress.left is not None or self._expected is None:
            return progress and progress.left
        return max(self._expected - progress.seconds, 0.0)

    def cancel(self):
        """Ask the work to end early, with the light it has."""
        self._cancelled.set()

    def listen(self):
        """Forget that an early end was asked for: what follows can be cancelled anew."""
        self._cancelled.clear()

    def drop(self):
        """End the work with nothing, and wait until it has ended."""
        self._dropped.set()
        self._cancelled.set()
        if self._thread.is_alive():
            self._thread.join()

    def want_light(self):
        """Ask for the light as it is now."""
        self._wanted.set()

    def take_light(self):
        """The light asked for, as the output previews it, once; None until it is there."""
        shown, self._shown = self._shown, None
        return shown

    def _do(self):
        try:
            work = self._work(self.job)
            while not self._cancelled.is_set():
                try:
                    self.progress = next(work)
                except StopIteration:
                    self.brought = True
                    return
                self._note(self.progress)
                if self._wanted.is_set() and self.progress.take:
                    self._look()
            bake = None if self._dropped.is_set() else self.job.so_far(self.progress)
            if bake:
                self.job.keep(bake)
                self.brought = self.partial = True
            work.close()
        except Exception as error:
            self.error = error

    def _note(self, progress):
        """Keep what is known of the light: not every Progress tells it."""
        self.bound = self.bound if progress.bound is None else progress.bound
        self.light_error = self.light_error if progress.error is None else progress.error

    def _look(self):
        """Bring the light that was asked for."""
        begun = perf_counter()
        bake = self.job.so_far(self.progress)
        if bake:
            self._wanted.clear()
            self._shown = self.job.output.preview(bake)
        self.cost = perf_counter() - begun


def phase_text(running):
    """What is being done, and how far it is."""
    progress = running.progress
    if running.waiting:
        return tr("Waiting")
    if running.phase == "write":
        return tr("Writing")
    if progress is None:
        return tr("Reading the scene") if running.phase == "read" else tr("Surveying")
    return f"{tr(PHASES.get(progress.phase, progress.phase))}  {100 * progress.done:.0f} %"


def percent(share):
    """A share in percent, as it is told: nobody asks what is below a ten-thousandth."""
    return f"{max(100 * share, 0.01):.2g}"
