"""The Bake button: a bake that runs beside Blender's window, and the same bake to its end for scripts."""

from __future__ import annotations

import threading
from collections import deque

import bpy

from ..core.bake import run
from .errors import Refused
from .job import Job
from .progress import progress_text
from .session import Session

TICK = 0.05  # seconds between looks at the running bake


class RunningBake:
    """A job's bake in a thread of its own, which never touches Blender: numpy and pipes alone."""

    def __init__(self, job):
        self.job = job
        self.progress = deque(maxlen=1)
        self.error = None
        self._cancelled = threading.Event()
        self._thread = threading.Thread(target=self._work, name="radiosity bake", daemon=True)
        self._thread.start()

    @property
    def done(self):
        return not self._thread.is_alive()

    def cancel(self):
        """Stop the bake and wait until it has stopped."""
        self._cancelled.set()
        self._thread.join()

    def _work(self):
        try:
            baking = self.job.bake()
            while not self._cancelled.is_set():
                try:
                    self.progress.append(next(baking))
                except StopIteration:
                    return
            baking.close()
        except Exception as error:
            self.error = error


class RADIOSITY_OT_bake(bpy.types.Operator):
    """Bake the light of the scene into color attributes"""

    bl_idname = "radiosity.bake"
    bl_label = "Bake Radiosity"
    bl_options = {"UNDO"}

    @classmethod
    def poll(cls, context):
        if context.mode != "OBJECT":
            cls.poll_message_set("Leave Edit Mode first: the colors are written in Object Mode")
            return False
        if Session.running is not None:
            cls.poll_message_set("A bake is running")
            return False
        return True

    def execute(self, context):
        """Bake to the end, blocking: in background and from scripts."""
        try:
            job = Job(context, context.scene.radiosity.options(context), cells=Session.warm_cells())
            run(job.bake())
            job.write(context)
        except Refused as problem:
            self.report({"ERROR"}, str(problem))
            return {"CANCELLED"}
        self._tell(job)
        return {"FINISHED"}

    def invoke(self, context, event):
        if bpy.app.background:
            return self.execute(context)
        try:
            job = Job(context, context.scene.radiosity.options(context), cells=Session.warm_cells())
        except Refused as problem:
            self.report({"ERROR"}, str(problem))
            return {"CANCELLED"}
        Session.running = self._bake = RunningBake(job)
        self._timer = context.window_manager.event_timer_add(TICK, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        bake = self._bake
        if Session.running is not bake:
            return self._finish(context, "CANCELLED")
        if event.type == "ESC":
            bake.cancel()
            self.report({"INFO"}, "Bake cancelled")
            return self._finish(context, "CANCELLED")
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        if not bake.done:
            self._show(context, bake)
            return {"RUNNING_MODAL"}
        if bake.error is not None:
            self.report({"ERROR"}, str(bake.error))
            return self._finish(context, "CANCELLED")
        if context.mode != "OBJECT":
            self._say(context, 1.0, "Leave Edit Mode to see the result")
            return {"PASS_THROUGH"}
        try:
            bake.job.write(context)
        except Refused as problem:
            self.report({"ERROR"}, str(problem))
            return self._finish(context, "CANCELLED")
        show_layer(context)
        self._tell(bake.job)
        return self._finish(context, "FINISHED")

    def cancel(self, context):
        """Called by Blender when it quits, opens another file or closes the window."""
        Session.end()

    def _show(self, context, bake):
        if bake.progress:
            progress = bake.progress[-1]
            self._say(context, progress.done, progress_text(progress))

    def _say(self, context, done, text):
        """Show a text in the status bar and the panel."""
        settings = context.scene.radiosity
        settings.progress, settings.status = done, text
        context.workspace.status_text_set(f"Radiosity: {text}   [Esc] cancel")
        redraw(context)

    def _finish(self, context, result):
        Session.running = None
        context.window_manager.event_timer_remove(self._timer)
        context.workspace.status_text_set(None)
        context.scene.radiosity.progress = -1.0
        redraw(context)
        return {result}

    def _tell(self, job):
        """Say what was found and reached."""
        survey = job.result.survey
        for finding in survey.health:
            self.report({"WARNING"}, f"{finding.object}: {finding.finding}; {finding.action}")
        seconds = sum(job.result.seconds[k] for k in ("survey", "patches", "transport", "gather"))
        self.report({"INFO"}, f"Baked {len(job.result.points)} points in {seconds:.1f} s")


def show_layer(context):
    """Let the solid 3D views show the active color attribute as it is."""
    for area in context.screen.areas:
        if area.type == "VIEW_3D":
            shading = area.spaces.active.shading
            if shading.type == "SOLID":
                shading.light, shading.color_type = "FLAT", "VERTEX"


def redraw(context):
    """Redraw the 3D views of all windows."""
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


CLASSES = (RADIOSITY_OT_bake,)
