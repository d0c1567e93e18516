"""Knobs: what each does alone, and what is read from errors and seconds."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest

from cell_radiosity.core.cells import LocalCells
from cell_radiosity.core.knobs import KNOBS, frontier, knob_values, slope, turns

from scenes import Material, Settings, bake, box, join_meshes, run


def glowing(n=2, reflectance=0.6):
    """A closed room that glows, all of it alike."""
    return join_meshes([box("room", n=n)], [Material("glow", (reflectance,) * 3, (1.0,) * 3)])


def test_a_turn_changes_one_knob_and_holds_the_others():
    settings = Settings.for_error(0.01)
    held = asdict(turns(settings, 64)[0].settings) | {"patch_edge": settings.patch_edge}
    assert held["gather_rays"] == 64
    changes = {"patches": {"patch_edge"}, "row rays": {"row_rays"}, "gather rays": {"gather_rays", "pilot_rays"},
               "light samples": {"light_samples"}, "bounces": {"bounces"}}  # fmt: skip
    found = turns(settings, 64)
    assert list(dict.fromkeys(t.knob for t in found)) == list(KNOBS)
    for turn in found:
        changed = {name for name, value in asdict(turn.settings).items() if value != held[name]}
        assert changed
        assert changed <= changes[turn.knob]
        assert turn.value == knob_values(turn.settings, turn.settings.gather_rays)[turn.knob]
    for knob in KNOBS[:4]:  # both ways, so that what was chosen stands between
        values, chosen = [t.value for t in found if t.knob == knob], knob_values(settings, 64)[knob]
        assert min(values) < chosen < max(values)


def test_knobs_that_there_are_not_are_not_turned():
    none = {t.knob for t in turns(Settings(patch_edge=None, rows="analytic", schedule="paper"), 16)}
    assert none == {"gather rays", "light samples"}
    assert all(
        t.settings.gather_rays >= 2 * t.settings.pilot_rays > 0 for t in turns(Settings(), 3) if t.knob == KNOBS[2]
    )


@pytest.mark.parametrize("bounces", [0, 1, 2, 5])
def test_bounces_are_a_geometric_series(bounces):
    """In a closed room that glows all alike, light reflected k times is rho^k of what is emitted; the first-hand light
    stays where it is, however many there are."""
    rho = 0.6
    light = run(bake(glowing(), Settings(bounces=bounces, gather_rays=16), LocalCells())).light
    reflected = np.pi * sum(rho**k for k in range(1, bounces + 1))
    assert np.allclose(light.direct, light.direct.mean(), rtol=1e-6)
    assert np.allclose(light.indirect / light.direct * np.pi, reflected, rtol=1e-3, atol=1e-12)


def test_all_bounces_are_the_limit():
    light, limit = (run(bake(glowing(), Settings(bounces=b, gather_rays=16), LocalCells())).light for b in (40, None))
    assert np.allclose(light.total, limit.total, rtol=1e-3)


def test_light_samples_are_test_rays():
    """More rays toward the lamp where it is partly hidden, and less noise; the rays of points stay as many, and of what is
    traced anew for an error so far off."""
    lamp = box("lamp", (0.3, 0.3, 0.9), (0.7, 0.7, 0.95), 1, False, dict.fromkeys("xXyYzZ", 1))
    block = box("block", (0.25, 0.25, 0.2), (0.5, 0.5, 0.5), 2, False)
    scene = join_meshes(
        [box("room", n=8), block, lamp], [Material("white", (0.2,) * 3), Material("lamp", (0.0,) * 3, (9.0,) * 3)]
    )
    found = [
        run(bake(scene, Settings(error=0.2, light_samples=s, gather_rays=32), LocalCells())) for s in (0.25, 1.0, 8.0)
    ]
    assert found[0].rays < found[1].rays < found[2].rays
    noise = [f.light.variance.sum() for f in found]
    assert noise[0] > noise[1] > noise[2]


def test_frontier_is_what_nothing_else_beats():
    assert frontier([(3.0, 0.1), (1.0, 0.5), (2.0, 0.6), (2.0, 0.3), (4.0, 0.1)]) == [
        (1.0, 0.5),
        (2.0, 0.3),
        (3.0, 0.1),
    ]
    assert frontier([]) == []


def test_slope_is_the_power_of_the_seconds():
    assert slope([(t, 3.0 * t**-0.5) for t in (1.0, 2.0, 7.0)]) == pytest.approx(-0.5)
    assert slope([(1.0, 0.1), (2.0, 0.2), (3.0, 0.3)]) is None  # dearer and worse: one point is left
    assert slope([]) is None
