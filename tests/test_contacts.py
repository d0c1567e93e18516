"""Contacts: patches are cut along what stands on them, or a little above them."""

from __future__ import annotations

import numpy as np
import pytest

from cell_radiosity.core.cells import LocalCells
from cell_radiosity.core.contacts import cut_contacts
from cell_radiosity.core.kernel import scene_arrays
from cell_radiosity.core.lights import make_sources
from cell_radiosity.core.patches import draw_on_patches, make_patches

from scenes import Material, Mesh, box, join_meshes, sheet

WEST, EAST = 0.33, 0.61  # of the wall, which is as long as the floor


FLOOR = sheet("floor", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], 4, 4)


def widest_across(gap, floor=FLOOR, faces=(WEST, EAST)):
    """How far patches of a floor reach beyond both sides of one of the two faces of a wall, so far above it [m]."""
    wall = box("wall", (faces[0], -0.2, gap), (faces[1], 1.2, 1.0), inward=False)
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
    return max(np.minimum(high - at, at - low).max() for at in faces)


@pytest.mark.parametrize("gap", [0.0, 2e-5, 1e-3, -0.01, 0.03])
def test_what_stands_on_a_floor_or_a_little_above_it_cuts_it(gap):
    """Touching, a millimeter above, sunk, and as close before it as an eighth of a patch: no patch is half below the wall and half beside it. The power that falls on
    one would go out below the wall."""
    assert widest_across(gap) < 1e-6


@pytest.mark.parametrize("corners", [[(0, 0), (0.9, 0.5), (0, 1)], [(0, 0), (0.6, 0.2), (0.6, 0.8), (0, 1)]])
def test_what_stands_in_the_middle_of_a_floor_cuts_it(corners):
    """Of any shape: paths from the middle to the corners would begin at the wall, on either side of it, and meet nothing."""
    floor = Mesh.of_polygons("floor", np.column_stack([corners, np.zeros(len(corners))]), [list(range(len(corners)))])
    middle = make_patches(join_meshes([floor]), None).centroid[0, 0]
    assert widest_across(0.0, floor, (middle, 1.0)) < 1e-6


@pytest.mark.parametrize("turn", [0.1, 0.3, 0.5, 1.0])
@pytest.mark.parametrize("place", [(0.5, 0.5), (0.31, 0.17), (-0.25, 0.25)])
def test_a_corner_that_reaches_into_a_patch_cuts_it(turn, place):
    """A block that is turned against the patches of its floor: next to nothing of any patch is below it if the middle is
    not, and beside it otherwise."""
    floor = sheet("floor", [(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)], 52, 52)
    block, size = box("block", (-0.4, -0.3, 0.0), (0.4, 0.3, 0.5), inward=False), (0.4, 0.3)
    frame = np.array([(np.cos(turn), np.sin(turn)), (-np.sin(turn), np.cos(turn))])
    block.vertices[:, :2] = block.vertices[:, :2] @ frame + place
    scene = join_meshes([floor, block], [Material("gray", (0.5,) * 3)])
    patches, cells = make_patches(scene, None), LocalCells()
    cells.start(scene_arrays(scene, patches, make_sources(scene)[0]))
    patches = cut_contacts(scene, patches, cells)
    near = np.abs(patches.centroid[:, :2] - place).max(axis=1) < 0.6
    own = np.flatnonzero(near & (scene.polygon_object[patches.polygon] == 0))
    position, _ = draw_on_patches(patches, own, *np.random.default_rng(1).random((2, len(own), 2000)))
    below = (np.abs((position[..., :2] - place) @ frame.T) < size).all(axis=-1).mean(axis=1)
    power = np.minimum(below, 1 - below) * patches.area[own]
    assert power.max() < 3e-3 * (4 / 52) ** 2


def test_what_hangs_above_a_floor_does_not_cut_it():
    """Light reaches below it: two columns of patches go on from one side of its faces to the other."""
    assert widest_across(0.05) > 0.05
