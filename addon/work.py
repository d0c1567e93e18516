"""Work beside Blender's window, or to its end for scripts: what operators that bake, survey and price have in common."""

from __future__ import annotations

from time import perf_counter

import bpy

from ..core.bake import run
from .errors import Refused
from .job import Job
from .preferences import preference
from .preflight import price_key
from .running import Running, phase_text
from .session import Session, writing
from .steps import in_steps
from .translations import tr, tr_message
from .viewport import redraw

TICK = 0.02  # seconds between looks at the running bake
STEP = 0.03  # seconds of reading or writing between two of Blender's own turns
PANEL = 0.2  # seconds between two updates of the panel


class Idle:
    """Operators that wait until no bake runs."""

    @classmethod
    def poll(cls, context):
        if Session.running is not None:
            cls.poll_message_set(tr("A bake is running"))
            return False
        return True


class Work(Idle):
    """Operators whose work runs in a thread beside the window: first the scene is read in short steps, then `_work` is
    done while `_watch` looks at it, then `_end` puts what it has brought into the file, in steps again."""

    keeps = ""  # what Esc does, for the status bar

    @classmethod
    def poll(cls, context):
        if context.mode != "OBJECT":
            cls.poll_message_set(tr("Go to Object Mode first: colors are written there"))
            return False
        return super().poll(context)

    def _options(self, context):
        return context.scene.radiosity.options(context)

    @writing
    def execute(self, context):
        """Work to the end, blocking: in background and from scripts."""
        try:
            self._begin(context)
            job = Job(context, self._options(context), cells=Session.warm_cells(preference("cells")))
            run(self._work(job))
            return {run(self._finish(context, job))}
        except Refused as problem:
            self.report({"ERROR"}, tr_message(str(problem)))
            return {"CANCELLED"}

    def _begin(self, context):
        """Note what is asked for, and of which scene."""
        self._key, self._changes = price_key(context, self._options(context)), Session.changes

    def _expected(self, context, options):
        """Seconds that the work may take, None if nobody knows."""
        return None

    def invoke(self, context, event):
        if bpy.app.background:
            return self.execute(context)
        self._begin(context)
        job = Job(context, self._options(context), cells=Session.warm_cells(preference("cells")), read=False)
        self._running = Session.running = Running(job, self._work, self._expected(context, job.options))
        self._scene = context.scene.session_uid
        self._steps = self._all(context)
        self._timer = context.window_manager.event_timer_add(TICK, window=context.window)
        context.window_manager.modal_handler_add(self)
        self._tell(context)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        running = self._running
        if Session.running is not running:  # another file was opened, or the add-on disabled
            return self._end(context, "CANCELLED")
        if event.type == "ESC" and event.value == "PRESS" and not running.waiting:
            running.cancel()
            return {"RUNNING_MODAL"}
        if event.type == "TIMER":
            try:
                with Session.write(context):
                    next(self._steps)
            except StopIteration as end:
                return self._end(context, end.value)
            except Exception as problem:  # whatever it was: the window must not stay in work that has ended
                running.drop()
                self.report({"ERROR"}, tr_message(str(problem) or type(problem).__name__))
                return self._end(context, "CANCELLED")
            if perf_counter() - self._told > PANEL:
                self._tell(context)
        # While the scene is read or written step by step, nobody may change it between two steps.
        return {"RUNNING_MODAL"} if running.phase != "work" else {"PASS_THROUGH"}

    def cancel(self, context):
        """Called by Blender when it quits, opens another file or closes the window."""
        Session.end()
        self._steps.close()  # what it leaves in order needs the file, which will be gone

    def _all(self, context):
        """Everything, in short steps: a generator that gives Blender its turn at each yield, and returns the operator's
        result."""
        running, job = self._running, self._running.job
        yield from self._read(context, job)
        if running.cancelled:
            return "CANCELLED"
        running.start()
        yield from self._watch(context)
        if running.error is not None:
            raise running.error
        if not running.brought:
            self.report({"INFO"}, tr("Ended before there was anything to keep"))
            return "CANCELLED"
        yield from self._wait(context)
        if running.cancelled and running.waiting:
            return "CANCELLED"
        if self._gone():
            self.report({"WARNING"}, tr("The scene that was baked was removed: there is nothing to write to"))
            return "CANCELLED"
        running.phase, running.waiting = "write", ""
        return (yield from in_steps(self._finish(context, job, running.partial), STEP))

    def _read(self, context, job):
        """Read the scene in steps; if anything changes it between two of them, anew and in one."""
        reading = job.reading(context, step=STEP)
        for _ in reading:
            before = Session.edits, context.scene.frame_current
            yield
            if (Session.edits, context.scene.frame_current) != before:
                reading.close()
                run(job.reading(context))
        self._changes = Session.changes

    def _watch(self, context):
        """Look at the work until it has ended: a generator."""
        while not self._running.done:
            yield

    def _wait(self, context):
        """Wait until the light can be written; Cancel ends the waiting, and the light is lost."""
        running = self._running
        while running.waiting or self._hindrance(context):
            if not running.waiting:
                running.listen()
            running.waiting = self._hindrance(context)
            if running.cancelled:
                return
            if running.waiting:
                yield

    def _hindrance(self, context):
        """Why the light cannot be written now, or ""."""
        if context.scene.session_uid != self._scene and not self._gone():
            return "Go back to the scene that was baked to see the result"
        if context.mode != "OBJECT":
            return "Go to Object Mode to see the result"
        return ""

    def _gone(self):
        """Whether the scene that was read has been removed."""
        return all(scene.session_uid != self._scene for scene in bpy.data.scenes)

    def _tell(self, context):
        """Bring the status bar and the panels up to date."""
        self._told = perf_counter()
        waiting = self._running.waiting
        text = tr(waiting) if waiting else f"{phase_text(self._running)}   [Esc] {tr(self.keeps)}"
        context.workspace.status_text_set(f"Radiosity: {text}")
        redraw(context)

    def _end(self, context, result):
        self._steps.close()
        Session.running = None
        context.window_manager.event_timer_remove(self._timer)
        context.workspace.status_text_set(None)
        redraw(context)
        return {result}
