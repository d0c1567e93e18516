"""Light groups: what each brings, and their sum."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cell_radiosity.core.bake import bake, run
from cell_radiosity.core.groups import one_group, weighted
from cell_radiosity.core.layers import layer_colors
from cell_radiosity.core.settings import Settings

from scenes import Lamp, Material, World, box, join_meshes, sheet

LAMPS = (
    Lamp("point", (9, 3, 1), (1, 1, 1.5), name="warm"),
    Lamp("point", (1, 2, 9), (3, 2, 1.5), name="cold", radius=0.1),
)
MATERIALS = (Material(reflectance=(0.7, 0.6, 0.5)), Material(exitance=(2, 5, 3), reflectance=(0.2, 0.2, 0.2)))


def scene(lamps=LAMPS, glow=1.0, sky=1.0):
    """A room with a hole in its ceiling, a glowing panel, two lamps and a block."""
    shapes = [
        box("room", high=(4, 3, 2), n=4, faces="xXyYz"),
        sheet("panel", ((0.2, 1, 1), (0.2, 2, 1), (0.2, 2, 1.6), (0.2, 1, 1.6)), 2, 2, 1),
        box("block", (2, 1, 0.4), (2.6, 1.6, 0.9), inward=False),
    ]
    materials = (MATERIALS[0], replace(MATERIALS[1], exitance=tuple(glow * x for x in MATERIALS[1].exitance)))
    return join_meshes(shapes, materials, lamps, World((0.2 * sky, 0.3 * sky, 0.5 * sky)))


def baked(scene, cells, **groups):
    # A given number of rays; the bound is tight, so that rounds do not end at another place for one group alone.
    return run(bake(scene, Settings(error=1e-4, gather_rays=48), cells, **groups))


def test_groups_are_the_light_of_their_own_lamps_and_add_up_to_all(cells):
    """Each group equals a bake in which all other lights are dark; their sum equals one without groups."""
    whole = baked(scene(), cells)
    grouped = baked(scene(), cells, group_of=lambda name: name)
    assert grouped.groups.names == ("warm", "cold", "panel", "World")
    assert grouped.rays <= 1.1 * whole.rays  # they share every ray
    np.testing.assert_allclose(grouped.light.direct, whole.light.direct, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(grouped.light.indirect, whole.light.indirect, rtol=2e-3, atol=1e-5)
    alone = {
        "warm": scene(LAMPS[:1], 0, 0), "cold": scene(LAMPS[1:], 0, 0), "panel": scene((), 1, 0), "World": scene((), 0, 1),
    }  # fmt: skip
    for number, name in enumerate(grouped.groups.names):
        one, other = one_group(grouped.by_group, grouped.groups, number), baked(alone[name], cells).light
        error = one.direct + one.indirect - other.direct - other.indirect
        assert np.sqrt((error**2).mean() / ((other.direct + other.indirect) ** 2).mean()) < 0.05, name
    np.testing.assert_allclose(
        sum(layer_colors(grouped, "Radiosity", g) for g in range(4)), layer_colors(grouped, "Radiosity"), rtol=1e-9
    )


def test_relit_is_baked_anew(cells):
    """A weighted sum of groups is the bake of lamps of other strength and color."""
    grouped = baked(scene(), cells, group_of=lambda name: name)
    factors = np.array([[0.5, 0.5, 0.5], [2.0, 1.0, 0.0], [3.0, 3.0, 3.0], [0.0, 0.0, 0.0]])
    relit = weighted(grouped.by_group, grouped.groups, factors)
    lamps = tuple(replace(lamp, strength=tuple(f * np.array(lamp.strength))) for lamp, f in zip(LAMPS, factors))
    anew = baked(scene(lamps, 3.0, 0.0), cells).light
    error = relit.direct + relit.indirect - anew.direct - anew.indirect
    assert np.sqrt((error**2).mean() / ((anew.direct + anew.indirect) ** 2).mean()) < 0.03


def test_groups_of_several(cells):
    grouped = baked(scene(), cells, group_of=lambda name: "lamps" if name in ("warm", "cold") else "rest")
    assert grouped.groups.names == ("lamps", "rest")
    dark = replace(scene(), lamps=(replace(LAMPS[0], strength=(0, 0, 0)), LAMPS[1]))
    assert baked(dark, cells, group_of=lambda name: name).groups.names == ("cold", "panel", "World")
