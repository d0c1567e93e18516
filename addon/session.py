"""What lives as long as the add-on is enabled: warm cells between bakes, the bake that is running, and what the panel
has looked up.

Whatever ends the session (quit, another file, disabling the add-on) ends the bake and its cells first.
"""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent

from ..core.cells import make_cells
from .job import default_cells


class Session:
    """Cells that stay warm, and the running work (a `RunningBake`), if any.

    edits: counts the changes of the file's data, so that what was looked up before one is known to be old.
    shading: {address of a 3D view's space: (light, color type)} as they were before a layer was shown there.
    """

    cells = None
    running = None
    edits = 0
    shading = {}

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
    def end(cls):
        """Drop the running work and end the cells."""
        running, cls.running = cls.running, None
        if running is not None:
            running.drop()
        if cls.cells is not None:
            cls.cells.stop()
            cls.cells = None


@persistent
def _before_load(*_):
    Session.end()


@persistent
def _after_edit(*_):
    Session.edits += 1


def register():
    """Watch for edits and for other files being opened."""
    bpy.app.handlers.load_pre.append(_before_load)
    bpy.app.handlers.depsgraph_update_post.append(_after_edit)


def unregister():
    """End everything."""
    bpy.app.handlers.depsgraph_update_post.remove(_after_edit)
    bpy.app.handlers.load_pre.remove(_before_load)
    Session.end()
