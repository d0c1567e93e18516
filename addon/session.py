"""What lives as long as the add-on is enabled: warm cells between bakes, the bake that is running, and what the panel
has looked up.

Whatever ends the session (quit, another file, disabling the add-on) ends the bake and its cells first.
"""

from __future__ import annotations

from contextlib import contextmanager
from functools import wraps

import bpy
from bpy.app.handlers import persistent

from ..core.cells import make_cells
from .job import default_cells

# What a bake does not look at, though Blender says that it has changed.
INDIFFERENT = (bpy.types.Scene, bpy.types.Camera, bpy.types.Screen, bpy.types.Brush, bpy.types.Text)
EMPTY_HANDED = {"CAMERA", "SPEAKER", "LIGHT_PROBE", "EMPTY"}  # objects that neither cast light nor shadow


class Session:
    """Cells that stay warm, and the running work (a `Running`), if any.

    edits: counts the changes of the file's data, so that what was looked up before one is known to be old; writes: those
    that the extension itself has made. changes: counts the edits that may change the light.
    shading: {address of a 3D view's space: (light, color type)} as they were before a layer was shown there. unshown: there
    was one in the views, until they were drawn again as they had been.
    """

    cells = None
    running = None
    edits = writes = changes = 0
    shading = {}
    unshown = False
    _writing = False

    @classmethod
    def warm_cells(cls, count=0):
        """Cells for a bake, started the first time. count: how many, 0 for as many as the machine has cores."""
        count = count or default_cells()
        if cls.cells is not None and cls._count != count:
            cls.cells.stop()
            cls.cells = None
        if cls.cells is None:
            cls.cells, cls._count = make_cells(count), count
        return cls.cells

    @classmethod
    @contextmanager
    def write(cls, context):
        """What changes in the file's data while this lasts is the extension's own doing, no edit of the user's."""
        if cls._writing:
            yield
            return
        context.view_layer.update()
        cls._writing = True
        try:
            yield
        finally:
            try:
                context.view_layer.update()
            finally:
                cls._writing = False

    @classmethod
    def note_edit(cls, scene, depsgraph):
        """Count a change, and mark the price list of a scene if it may no longer hold."""
        if cls._writing:
            cls.writes += 1
            return
        cls.edits += 1
        if any(_matters(update) for update in depsgraph.updates):
            cls.changes += 1
            if scene.radiosity.prices and not scene.radiosity.edited:
                scene.radiosity.edited = True

    @classmethod
    def end(cls):
        """Drop the running work and end the cells."""
        running, cls.running = cls.running, None
        if running is not None:
            running.drop()
        if cls.cells is not None:
            cls.cells.stop()
            cls.cells = None


def writing(execute):
    """The `execute` of an operator, or the update of a property, as a write of the extension's own."""

    @wraps(execute)
    def done(self, context):
        with Session.write(context):
            return execute(self, context)

    return done


def _matters(update):
    """Whether a change of the file's data may change the light."""
    if isinstance(update.id, bpy.types.Object):
        moved = update.is_updated_geometry or update.is_updated_transform
        return moved and (update.id.type not in EMPTY_HANDED or update.id.is_instancer)
    changed = update.is_updated_geometry or update.is_updated_transform or update.is_updated_shading
    return changed and not isinstance(update.id, INDIFFERENT)


@persistent
def _before_load(*_):
    Session.end()


@persistent
def _after_load(*_):
    with Session.write(bpy.context):  # that all of a file is new is no change of it ...
        pass
    Session.edits += 1  # ... but nothing that was looked up in another file holds here


@persistent
def _after_edit(scene, depsgraph):
    Session.note_edit(scene, depsgraph)


def register():
    """Watch for edits and for other files being opened."""
    for handlers, handler in _handlers():
        handlers.append(handler)


def unregister():
    """End everything."""
    for handlers, handler in _handlers():
        handlers.remove(handler)
    Session.end()


def _handlers():
    """(list of Blender's, our handler in it)."""
    told = bpy.app.handlers
    return (
        (told.load_pre, _before_load),
        (told.load_post, _after_load),
        (told.depsgraph_update_post, _after_edit),
        (told.frame_change_post, _after_edit),
    )
