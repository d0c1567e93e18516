"""A narrow sun: seen whole or not at all from most places, and tested only where it is seen in part."""

from __future__ import annotations

import numpy as np
import pytest

from cell_radiosity.core import direct
from cell_radiosity.core.cells import LocalCells

from scenes import Lamp, Material, Settings, bake, join_meshes, run, sheet

BLACK = (Material("black", (0.0,) * 3),)
SUN, HALF = 3.0, 0.0175  # W/m^2, sine of half the angle
HEIGHT = 1.0  # of the screen's edge, at x = 0


def under_a_screen(low, high, columns, rows):
    """A floor from x = low to x = high, under a screen that hides the sun from where x > 0."""
    floor = sheet("floor", [(low, -1, 0), (high, -1, 0), (high, 1, 0), (low, 1, 0)], columns, rows)
    screen = sheet("screen", [(0, -5, HEIGHT), (5, -5, HEIGHT), (5, 5, HEIGHT), (0, 5, HEIGHT)])
    return join_meshes([floor, screen], BLACK, [Lamp("sun", (SUN,) * 3, angle=2 * np.arcsin(HALF))])


def light_on_floor(scene, **others):
    """Positions x (K,) and light (K,) of the floor's points, as a share of the sun's."""
    baked = run(bake(scene, Settings(**{"gather_rays": 16, "patch_edge": None, **others}), LocalCells()))
    floor = np.flatnonzero(baked.points.position[:, 2] < 0.5 * HEIGHT)
    return baked.points.position[floor, 0], baked.light.total[0, floor] / SUN


def part_seen(x):
    """(K,) part of the sun's disk that is seen from places x (K,): the part on one side of a chord."""
    u = np.clip(-x / (HEIGHT * HALF), -1.0, 1.0)
    return 0.5 + (u * np.sqrt(1.0 - u * u) + np.arcsin(u)) / np.pi


def test_a_penumbra_is_what_the_closed_form_says():
    x, light = light_on_floor(under_a_screen(-0.04, 0.04, 16, 150))
    exact = part_seen(x)
    whole = (exact == 0) | (exact == 1)
    assert whole.sum() > 500
    assert light[whole] == pytest.approx(exact[whole], abs=1e-6)
    for place in np.unique(x.round(6)):
        column = np.abs(x - place) < 1e-5
        # Some 30 test rays at each of 151 points.
        assert light[column].mean() == pytest.approx(exact[column].mean(), abs=4 * 0.5 / np.sqrt(30 * column.sum()))


@pytest.mark.parametrize("x", [-0.009, 0.0, 0.01])
def test_a_penumbra_is_seen_where_all_neighbors_lie_in_it(x):
    """Test rays to one place of the sun alone would find all of it there or nothing."""
    place, light = light_on_floor(under_a_screen(x - 1e-4, x + 1e-4, 1, 200))
    assert light.mean() == pytest.approx(part_seen(place).mean(), abs=4 * 0.5 / np.sqrt(30 * len(light)))


def test_rays_go_where_part_of_the_sun_is_seen(monkeypatch):
    """Elsewhere, in full light and in shadow, as many as tell that, and none more however many rays a point gets."""
    scene, count = under_a_screen(-1.0, 1.0, 40, 40), []

    def counted(*arguments, real=direct.test_rays):
        count.append(len(arguments[-1]))
        return real(*arguments)

    monkeypatch.setattr(direct, "test_rays", counted)
    x, light = light_on_floor(scene, gather_rays=64, pilot_rays=32)
    near = np.count_nonzero(np.abs(x) < 0.051)  # those beside the edge, and on it
    most = direct.RIM * (len(x) + 4) + near * (direct.TESTS + direct.PENUMBRA * 32)
    assert sum(count) <= 2 * 1.2 * most
    assert (light[x < -0.06] == 1).all()
    assert (light[x > 0.06] == 0).all()
