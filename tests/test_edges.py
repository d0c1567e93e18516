"""Edges of bright light: near them rays read what is there, not the mean of a side that a source lights in part."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

from cell_radiosity.core import anew
from cell_radiosity.core.anew import edge_arrays
from cell_radiosity.core.bake import bake, run
from cell_radiosity.core.cells import LocalCells, make_cells
from cell_radiosity.core.polygons import polygon_factor
from cell_radiosity.core.settings import Settings
from cell_radiosity.core.state import load_state, save_state

from scenes import Lamp, Material, join_meshes, sheet, solve_scene

RHO, SUN = 0.5, 3.0
MATERIALS = (Material("floor", (RHO,) * 3), Material("black", (0.0,) * 3))
EDGE = -0.3  # where the shadow begins


def half_lit(count=1, angle=0.0):
    """A floor of count times count patches, half of it in the shadow of a screen, and a wall at its end, both black
    but for the floor; only the wall's light is asked for."""
    floor = sheet("floor", [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], count, count)
    screen = sheet("screen", [(EDGE, -1, 3), (2, -1, 3), (2, 1, 3), (EDGE, 1, 3)], material=1)
    wall = sheet("wall", [(-1, -1, 0), (-1, 1, 0), (-1, 1, 1), (-1, -1, 1)], 8, 8, material=1)
    scene = join_meshes([floor, screen, wall], MATERIALS, [Lamp("sun", (SUN,) * 3, angle=angle)])
    return replace(scene, written=np.array([False, False, True]))


def settings(**others):
    return Settings(**{"error": 0.04, "patch_edge": None, "gather_rays": 512, "patch_samples": 64, **others})


def error_at_wall(baked):
    """Of the light at the wall's points that lie in no corner, beside Lambert's formula for the part that is lit."""
    points, light = baked.points, baked.light.total[0]
    wall = np.flatnonzero(points.position[:, 2] > 0.05)
    lit = np.array([(-1, -1, 0), (EDGE, -1, 0), (EDGE, 1, 0), (-1, 1, 0)], float)
    exact = RHO * SUN * polygon_factor(points.position[wall], points.normal[wall], lit)
    return np.sqrt(((light[wall] - exact) ** 2).sum() / (exact**2).sum())


def test_beside_an_edge_the_light_is_what_the_closed_form_says(monkeypatch):
    """One patch is all of the floor; its mean would give the wall far too little."""
    baked = run(bake(half_lit(), settings(), LocalCells()))
    assert list(baked.solution.edges.sides) == [0]
    assert baked.solution.edges.mean[0] == pytest.approx(0.35, abs=0.03)
    assert error_at_wall(baked) < 0.02
    monkeypatch.setattr(anew, "NEAR", 0.0)
    assert error_at_wall(run(bake(half_lit(), settings(), LocalCells()))) > 0.2


def test_near_hits_of_a_fine_mesh_go_on(monkeypatch):
    """The same light, when each object is to reach the error: without any edge, all of it from where rays meet the floor."""

    def error(**changed):
        for name, value in changed.items():
            monkeypatch.setattr(anew, name, value)
        return error_at_wall(run(bake(half_lit(), settings(per_object=True), LocalCells())))

    assert error(NEAR=0.0) < 0.03  # from further away than the floor is long, its mean is read
    assert error(FINE=1e-3) > 0.2
    assert error(FINE=0.5, CLOSE=0.0) > 0.2


def half_covered(height, fine=1):
    """A sunlit floor, and a plate that hangs close above half of it."""
    floor = sheet("floor", [(-1, -1, 0), (2, -1, 0), (2, 1, 0), (-1, 1, 0)], 9 * fine, 6 * fine)
    plate = sheet("plate", [(0, -1, height), (0, 1, height), (2, 1, height), (2, -1, height)], 6 * fine, 6 * fine)
    return join_meshes([floor, plate], [Material("white", (0.8,) * 3)], [Lamp("sun", (SUN,) * 3)])


def test_deep_in_a_gap_nobody_reads_the_light_of_its_mouth(monkeypatch):
    """Light falls off within the gap's width. Where each object is to reach the error, what is found there on patches seven
    times as wide is what patches a quarter as wide show."""

    def light(**knobs):
        baked = run(
            bake(half_covered(0.05), settings(per_object=True, gather_rays=256, row_rays=256, **knobs), LocalCells())
        )
        inside = (np.abs(baked.points.position - (1 / 3, 0, 0)) < (0.01, 0.9, 0.01)).all(axis=1)
        assert inside.sum() == 5
        return baked.light.total[0, inside].mean() / SUN

    assert light() == pytest.approx(0.0166, rel=0.15)  # of patches 1.2 cm long
    monkeypatch.setattr(anew, "ACROSS", 2.0)
    assert light() > 0.03


def test_the_estimate_sees_what_is_wrong_in_a_gap(monkeypatch):
    """Where gaps read the light of their mouths, what patches have averaged away is said; less by far with truths
    that read it too."""

    def seen():
        bakes = (Settings.for_error(0.05, gather_rays=256, seed=seed) for seed in range(3))
        return sum(run(bake(half_covered(0.03, 4), knobs, LocalCells())).estimate.averaged for knobs in bakes)

    across = seen()
    monkeypatch.setattr(anew, "NARROW", 0.0)
    assert across > 1.2 * seen()  # a tenth is chance, 1.38 was found


def test_the_nearest_hits_of_the_finest_meshes_go_on_below_3_percent(monkeypatch):
    """The foot of the wall gets what is there, for little time; above it reads the floor's mean."""
    monkeypatch.setattr(anew, "NEAR", 0.0)

    def error(asked):
        return error_at_wall(run(bake(half_lit(), settings(error=asked), LocalCells())))

    assert error(0.02) < 0.08
    assert error(0.04) > 0.2


def test_further_away_the_mean_is_read(monkeypatch):
    """One ray among many that meets a strip of light says less of it than its mean: only near hits are read anew."""

    def light(near):
        monkeypatch.setattr(anew, "NEAR", near)
        return run(bake(half_lit(8), settings(gather_rays=64, patch_samples=16), LocalCells())).light.total

    never, near, always = (light(n) for n in (0.0, 4.0, 1e3))
    assert (near != never).any()
    assert (always != near).any()
    assert np.allclose(near.mean(), always.mean(), rtol=0.02)


def test_only_what_counts_is_an_edge():
    edges = anew.Edges(np.array([1, 4]), np.array([0, 2]), np.array([0.5, 0.2]), np.array([1.0, 6.0]))
    reflectance = np.full((1, 6), 0.5)
    assert edge_arrays(edges, reflectance, 1.0)["edges.source"].tolist() == [-1, -1, -1, -1, 2, -1]
    assert edge_arrays(edges, reflectance, 0.4)["edges.source"].tolist() == [-1, 0, -1, -1, 2, -1]
    assert not len(edge_arrays(edges, reflectance, 9.0)["edges.mean"])
    assert not len(edge_arrays(None, reflectance, 1.0)["edges.mean"])


def test_bits_and_states_are_the_same(tmp_path):
    """Edges are part of a state: without them, further rays would read another light."""
    scene, some = half_lit(6, 0.1), settings(patch_samples=4, gather_rays=16)
    results = []
    for count in (1, 2):
        with make_cells(count) as cells:
            results.append(run(bake(scene, some, cells)))
    one, two = results
    assert len(one.solution.edges.sides)
    assert np.array_equal(one.light.total, two.light.total)

    save_state(one.state(), tmp_path / "state")
    more = replace(some, gather_rays=64)
    on = run(bake(scene, more, LocalCells(), state=load_state(tmp_path / "state")))
    whole = run(bake(scene, more, LocalCells(), state=one.state()))
    assert np.array_equal(on.light.total, whole.light.total)
    assert np.array_equal(on.solution.edges.mean, one.solution.edges.mean)


BEAM = 2 * np.arctan(0.3 / 4)  # as wide as a patch is long, where it meets the floor


@pytest.mark.parametrize("lamp", [
    Lamp("spot", (1.0,) * 3, (0, 0, 4), angle=BEAM, blend=0.5),
    Lamp("spot", (1.0,) * 3, (0, 0, 4), angle=BEAM, blend=0.5, radius=0.02),
    Lamp("area", (1.0,) * 3, (0, 0, 4), size=(0.1, 0.1), spread=BEAM),
], ids=["spot", "soft spot", "narrow area lamp"])  # fmt: skip
def test_patches_on_the_rim_of_a_beam_get_all_of_its_power(lamp):
    """The power of a spot is 2 pi I times the integral of its smooth step over the cosine; an area lamp's does not depend on
    its spread. What the centers of four patches get, around the middle of the beam, says nothing of it."""
    floor = sheet("floor", [(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)])
    screen = sheet("screen", [(-2, -2, 3), (-1, -2, 3), (-1, 2, 3), (-2, 2, 3)])  # something may stand in the way
    scene = join_meshes([floor, screen], [Material("black", (0.0,) * 3)], [lamp])
    solved = solve_scene(scene, LocalCells(), edge=0.4, patch_samples=16)
    whole = 1.0 - np.cos(BEAM / 2)
    power = 2 * np.pi * whole * (1 - 0.5 / 2) if lamp.kind == "spot" else np.pi * 0.1 * 0.1
    landed = (solved.patches.area * solved.solution.direct[0, 0::2]).sum()
    assert landed == pytest.approx(power, rel=0.03)


@pytest.mark.skipif(not hasattr(np, "_set_promotion_state"), reason="numpy 2 knows its own ways alone")
@pytest.mark.parametrize("knobs", [dict(error=0.01), dict(error=0.02, per_object=True)])
def test_numbers_are_as_precise_in_numpy_2(knobs):
    """Where float32 meets a number of numpy's it stays float32 in numpy 1 alone: other rays would go on in other Blenders."""
    np._set_promotion_state("weak_and_warn")
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "result dtype changed")
            warnings.filterwarnings("error", "result dtype changed.*float32 to float64")
            run(bake(half_lit(8), Settings.for_error(**knobs), LocalCells()))
    finally:
        np._set_promotion_state("legacy")
