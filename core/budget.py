"""The memory of a bake: what host and cells will take together, and how many cells leave it within what may be used.

Owns what a cell, a triangle, a patch and a point are known to take. How many cells work changes no bit of a bake, so this
may go by what the host's process takes at the moment.
"""

from __future__ import annotations

from .cells import memory_now

# Bytes, measured on Linux with Python 3.11.
CELL = 110e6  # of a cell without a scene: Python, numpy, Embree, and what a task works on
CELL_TRIANGLE = 260.0  # of each triangle in a cell: the mesh, the ray caster's tree, which patches lie there
CELL_PATCH = 500.0
HOST_TRIANGLE = 150.0  # of each triangle in the host, beside what was read: what is derived from it
HOST_PATCH = 1000.0  # of each patch in the host, rows of both sides among it
HOST_POINT = 500.0  # of each point in the host: it, its neighbors, three replicates of its light, and that light


def cells_within(memory, triangles, patches, points, begun):
    """How many cells leave host and cells within so much memory [bytes] in a bake of so many triangles, patches and points; 0
    where not even one does. begun: the host holds by now what it needs of the triangles."""
    ahead = HOST_PATCH * patches + HOST_POINT * points + (0.0 if begun else HOST_TRIANGLE * triangles)
    each = CELL + CELL_TRIANGLE * triangles + CELL_PATCH * patches
    return int(max((memory - 1e6 * memory_now() - ahead) // each, 0))
