"""Ambient occlusion against its closed form."""

from __future__ import annotations

import numpy as np
import pytest

from cell_radiosity.core.bake import bake, run
from cell_radiosity.core.layers import layer_colors
from cell_radiosity.core.polygons import polygon_factor
from cell_radiosity.core.settings import Settings

from scenes import Lamp, join_meshes, sheet

FLOOR = ((0, 0, 0), (4, 0, 0), (4, 4, 0), (0, 4, 0))
ROOF = np.array(((1, 1, 0.8), (1, 3, 0.8), (3, 3, 0.8), (3, 1, 0.8)), float)


@pytest.mark.parametrize(("reach", "seen"), [(50.0, True), (0.7, False)])
def test_openness_is_one_less_the_factor_of_what_is_near(cells, reach, seen):
    """Under a roof: 1 less its form factor from afar; 1 where it is beyond the distance."""
    scene = join_meshes([sheet("floor", FLOOR, 8, 8), sheet("roof", ROOF)], lamps=[Lamp("point", (1, 1, 1), (2, 2, 3))],
                        written=[True, False])  # fmt: skip
    baked = run(bake(scene, Settings(gather_rays=8, occlusion=reach), cells))
    points = baked.points
    factor = polygon_factor(points.position, points.normal, ROOF) if seen else 0.0
    error = baked.openness - (1 - factor)
    assert np.sqrt((error**2).mean()) < 0.015
    assert abs(error.mean()) < 0.002
    colors = layer_colors(baked, "Occlusion")
    assert np.array_equal(colors[points.corner][:, 0], baked.openness[points.corner_point])


def test_nothing_is_traced_for_it_unless_asked(cells):
    scene = join_meshes([sheet("floor", FLOOR, 8, 8), sheet("roof", ROOF)], lamps=[Lamp("point", (1, 1, 1), (2, 2, 3))])
    assert run(bake(scene, Settings(gather_rays=8), cells)).openness is None
