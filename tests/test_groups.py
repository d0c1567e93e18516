"""Light groups: what each brings, and their sum."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cell_radiosity.core.bake import bake, relit, restored, run
from cell_radiosity.core.groups import one_group, weighted
from cell_radiosity.core.layers import layer_colors
from cell_radiosity.core.settings import Settings
from cell_radiosity.core.state import load_state, save_state

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
    np.testing.assert_allclose(grouped.light.direct, whole.light.direct, rtol=1e-4, atol=1e-6)
    # Each group is balanced by itself: what rows are off by weighs differently in each.
    np.testing.assert_allclose(grouped.light.indirect, whole.light.indirect, rtol=1e-2, atol=1e-5)
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


def test_a_state_is_relit_without_a_ray(cells, tmp_path):
    """Lamps, glowing faces and the sky, in every layer: as a bake of lights of other strength and color."""
    by_name = dict(group_of=lambda name: name)
    settings = Settings(error=1e-4, gather_rays=48)
    save_state(run(bake(scene(), settings, cells, **by_name)).state(), tmp_path / "s")
    before = run(restored(scene(), load_state(tmp_path / "s")))
    factors = np.array([[0.5, 0.5, 0.5], [2.0, 1.0, 0.0], [3.0, 2.0, 1.0], [0.0, 0.0, 0.0]])
    found = relit(before, factors)
    lamps = tuple(replace(lamp, strength=tuple(f * np.array(lamp.strength))) for lamp, f in zip(LAMPS, factors))
    other = scene(lamps, 1.0, 0.0)
    glow = replace(other.materials[1], exitance=tuple(factors[2] * other.materials[1].exitance))
    anew = run(bake(replace(other, materials=(other.materials[0], glow)), settings, cells, **by_name))
    for layer in ("Radiosity", "Lighting", "Direct", "Indirect"):
        a, b = layer_colors(found, layer), layer_colors(anew, layer)
        assert np.sqrt(((a - b) ** 2).mean() / (b**2).mean()) < 0.03, layer
        parts = [layer_colors(found, layer, g) for g in range(4)]
        np.testing.assert_allclose(sum(parts), a, rtol=1e-9, atol=1e-12)
        assert not parts[3].any()
    assert found.estimate is None
    # What glows shows it: exactly as bright as it was made.
    np.testing.assert_allclose(
        layer_colors(found, "Radiosity", 2).max(axis=0), layer_colors(anew, "Radiosity", 2).max(axis=0), rtol=0.02
    )


def test_a_factor_of_all_groups_is_a_factor(cells):
    grouped = baked(scene(), cells, group_of=lambda name: name)
    for layer in ("Radiosity", "Direct", "Indirect"):
        whole = layer_colors(grouped, layer)
        assert np.array_equal(layer_colors(relit(grouped, np.full((4, 3), 1.0)), layer), whole)
        assert np.array_equal(layer_colors(relit(grouped, np.full((4, 3), 4.0)), layer), 4 * whole)
        np.testing.assert_allclose(layer_colors(relit(grouped, np.full((4, 3), 0.3)), layer), 0.3 * whole, rtol=1e-12)


def test_a_gray_scene_is_relit_in_color(cells):
    """One channel was enough for the bake; it is not for what comes of it."""
    gray = join_meshes(
        [box("room", n=4)], lamps=(replace(LAMPS[0], strength=(5, 5, 5)), replace(LAMPS[1], strength=(7, 7, 7)))
    )
    grouped = baked(gray, cells, group_of=lambda name: name)
    assert len(grouped.light.direct) == 1
    found = relit(grouped, [[1, 0, 0], [0, 0, 2]])
    warm, cold = (layer_colors(grouped, "Lighting", g)[:, 0] for g in range(2))
    np.testing.assert_allclose(
        layer_colors(found, "Lighting"), np.stack([warm, 0 * warm, 2 * cold], axis=1), rtol=1e-12
    )


def test_groups_of_several(cells):
    grouped = baked(scene(), cells, group_of=lambda name: "lamps" if name in ("warm", "cold") else "rest")
    assert grouped.groups.names == ("lamps", "rest")
    dark = replace(scene(), lamps=(replace(LAMPS[0], strength=(0, 0, 0)), LAMPS[1]))
    assert baked(dark, cells, group_of=lambda name: name).groups.names == ("cold", "panel", "World")


def test_a_scene_without_light_has_no_groups(cells):
    scene = join_meshes([box("room", n=2)], lamps=[Lamp("point", (0.0, 0.0, 0.0))])
    baked = run(bake(scene, Settings(gather_rays=4), cells, group_of=lambda name: name))
    assert baked.groups is None
    assert baked.by_group is None
    assert not baked.light.total.any()
