"""Contacts: patches are cut along what stands on them, or a little above them."""

from __future__ import annotations

import numpy as np
import pytest

from cell_radiosity.core.cells import LocalCells
from cell_radiosity.core.contacts import cut_contacts
from cell_radiosity.core.kernel import scene_arrays
from cell_radiosity.core.lights import make_sources
from cell_radiosity.core.patches import make_patches

from scenes import Material, box, join_meshes, sheet

WEST, EAST = 0.33, 0.61  # of the wall, which is as long as the floor


def widest_across(gap):
    """How far patches of a floor reach beyond both sides of one of the faces of a wall, so far above it [m]."""
    floor = sheet("floor", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], 4, 4)
    wall = box("wall", (WEST, -0.2, gap), (EAST, 1.2, 1.0), inward=False)
    scene = join_meshes([floor, wall], [Material("gray", (0.5,) * 3)])
    patches, sources = make_patches(scene, None), make_sources(scene)[0]
    cells = LocalCells()
    cells.start(scene_arrays(scene, patches, sources))
    patches = cut_contacts(scene, patches, cells)
    owner = np.repeat(np.arange(len(patches)), np.diff(patches.element_start))
    own = (scene.polygon_object[patches.polygon] == 0)[owner]
    p, a, b = np.moveaxis(patches.element_frame[own], 1, 0)
    far = np.where(patches.element_square[own][:, None], p + a + b, p)
    x = np.stack([p, p + a, p + b, far])[..., 0]
    low, high = np.full(len(patches), np.inf), np.full(len(patches), -np.inf)
    np.minimum.at(low, owner[own], x.min(axis=0))
    np.maximum.at(high, owner[own], x.max(axis=0))
    return max(np.minimum(high - at, at - low).max() for at in (WEST, EAST))


@pytest.mark.parametrize("gap", [0.0, 2e-5, 1e-3, -0.01])
def test_what_stands_on_a_floor_or_a_little_above_it_cuts_it(gap):
    """Touching, a millimeter above, and sunk: no patch is half below the wall and half beside it. The power that falls on
    one would go out below the wall."""
    assert widest_across(gap) < 1e-6


def test_what_hangs_above_a_floor_does_not_cut_it():
    """Light reaches below it: two columns of patches go on from one side of its faces to the other."""
    assert widest_across(0.05) > 0.05
