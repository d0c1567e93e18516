"""Panels that hang close before a wall: patches are cut along their outlines, and what is caught behind them stays there."""

from __future__ import annotations

import numpy as np
import pytest

from cell_radiosity.core.bake import bake, run
from cell_radiosity.core.cells import LocalCells
from cell_radiosity.core.lights import make_sources
from cell_radiosity.core.patches import make_patches
from cell_radiosity.core.settings import Settings
from cell_radiosity.core.steep import make_fine_patches

from scenes import Lamp, Material, box, join_meshes, sheet

LOW, HIGH = 0.27, 0.73  # of the panel
GLOW = 10.0
WALL = 0  # polygon of the room


def panel(gap, turned=False):
    """A panel that faces into the room, in front of its wall x = 0, or turned by an eighth."""
    corners = np.array(((gap, LOW, LOW), (gap, HIGH, LOW), (gap, HIGH, HIGH), (gap, LOW, HIGH)))
    if turned:
        y, z = corners[:, 1] - 0.5, corners[:, 2] - 0.5
        corners[:, 1], corners[:, 2] = 0.5 + (y - z) * np.sqrt(0.5), 0.5 + (y + z) * np.sqrt(0.5)
    return sheet("panel", corners, material=1)


def room(*meshes, lamps=()):
    gray = Material("gray", reflectance=(0.7,) * 3)
    glow = Material("glow", reflectance=(0.7,) * 3, exitance=(GLOW,) * 3)
    return join_meshes([box(n=1), *meshes], [gray, glow], lamps=lamps)


@pytest.mark.parametrize("turned", [False, True])
def test_no_patch_lies_partly_behind_a_panel(turned):
    """Behind it there is as much of the wall as the panel is large, to rounding, and no area gets lost."""
    scene = room(panel(0.005, turned))
    fine = make_fine_patches(scene, make_sources(scene)[0], 0.2, 0.0)
    wall = fine.polygon == WALL
    y, z = (fine.centroid[:, k] - 0.5 for k in (1, 2))
    if turned:
        y, z = (y + z) * np.sqrt(0.5), (z - y) * np.sqrt(0.5)
    behind = wall & (np.maximum(np.abs(y), np.abs(z)) < (HIGH - LOW) / 2)
    assert np.isclose(fine.area[behind].sum(), (HIGH - LOW) ** 2, rtol=1e-9)
    assert np.isclose(fine.area[wall].sum(), 1.0, rtol=1e-9)
    even = make_patches(scene, 0.2)
    assert np.isclose(fine.area.sum(), even.area.sum(), rtol=1e-9)


def test_a_panel_far_from_the_wall_cuts_nothing():
    scene = room(panel(0.3))
    fine = make_fine_patches(scene, make_sources(scene)[0], 0.2, 0.0)
    assert not len(fine.cut_patch)


def test_a_panel_close_to_a_wall_lights_the_room_as_one_that_is_part_of_it():
    """Twin: a lamp that shines into the room alone, on the same wall. A patch partly behind the panel would send what it
    gets there into the room: more than a tenth of all reflected light, with such patches."""
    x = ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (-1.0, 0.0, 0.0))
    lamp = Lamp("area", (GLOW / np.pi,) * 3, (0.0005, 0.5, 0.5), axes=x, size=(HIGH - LOW,) * 2)
    settings = Settings(error=0.01, patch_edge=0.1, row_rays=128, gather_rays=256)
    light = []
    for scene in (room(panel(0.0005)), room(lamps=(lamp,))):
        baked = run(bake(scene, settings, LocalCells()))
        far = baked.points.position[:, 0] > 0.9
        light.append((baked.points.area * baked.light.total[0])[far].sum() / baked.points.area[far].sum())
    assert light[0] == pytest.approx(light[1], rel=0.012)
