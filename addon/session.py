"""What lives as long as the add-on is enabled: warm cells between bakes, and the bake that is running.

Whatever ends the session (quit, another file, disabling the add-on) ends the bake and its cells first.
"""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent

from ..core.cells import make_cells
from .job import default_cells


class Session:
    """Cells that stay warm, and the running bake (an object with `cancel()`), if any."""

    cells = None
    running = None

    @classmethod
    def warm_cells(cls):
        """Cells for a bake, started the first time."""
        if cls.cells is None:
            cls.cells = make_cells(default_cells())
        return cls.cells

    @classmethod
    def end(cls):
        """Cancel the running bake and end the cells."""
        if cls.running is not None:
            cls.running.cancel()
            cls.running = None
        if cls.cells is not None:
            cls.cells.stop()
            cls.cells = None


@persistent
def _before_load(*_):
    Session.end()


def register():
    """Watch for other files being opened."""
    bpy.app.handlers.load_pre.append(_before_load)


def unregister():
    """End everything."""
    bpy.app.handlers.load_pre.remove(_before_load)
    Session.end()
